"""Reference renderer in float64 NumPy: which picture should the GPU kernels draw?"""
