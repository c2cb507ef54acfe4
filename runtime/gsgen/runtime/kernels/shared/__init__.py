"""What do all GPU kernels share: pipelines, shader assembly, counts, common WGSL?"""
