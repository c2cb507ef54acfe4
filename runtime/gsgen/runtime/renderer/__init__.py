"""How do the kernels make one frame?"""
