"""The kernels of the renderer: each is a ``.wgsl`` file, its binding, and its NumPy twin."""
