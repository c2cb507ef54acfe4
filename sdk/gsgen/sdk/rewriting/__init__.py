"""How is a model rewritten for a target, and proven to compute the same?"""
