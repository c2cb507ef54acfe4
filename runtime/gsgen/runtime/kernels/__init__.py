"""The renderer's GPU kernels: each is a ``.wgsl`` file, a binding and a NumPy reference."""
