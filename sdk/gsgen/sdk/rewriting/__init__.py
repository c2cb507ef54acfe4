"""How is a model's graph rewritten for a target, and proven to compute the same outputs?"""
