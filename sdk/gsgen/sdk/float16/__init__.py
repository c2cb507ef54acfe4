"""How is a model converted to float16 where the rounding stays below the tolerance?"""
