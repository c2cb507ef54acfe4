"""What do all kernels share: pipelines, shader assembly, counts, common WGSL?"""
