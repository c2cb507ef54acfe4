"""Which graph rewrites adapt a model to the limits and defects of runtimes?"""
