"""How do the GPU kernels draw one frame of a scene?"""
