"""How is one session of a model bound: its inputs, buffers and outputs, and its first runs?"""
