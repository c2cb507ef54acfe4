"""Reference renderer: what should the renderer draw, in float64 NumPy without its kernels?"""
