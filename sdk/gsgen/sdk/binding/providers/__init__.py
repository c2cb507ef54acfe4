"""Which execution provider runs a model, and on which device do its nodes run?"""
