"""How is a model's graph rewritten for a target runtime, and proven to compute the same?"""
