"""Which rewrites keep a model within the limits and defects of runtimes?"""
