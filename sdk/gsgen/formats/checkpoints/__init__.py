"""Which PyTorch checkpoints hold plain Gaussian splats, and how are they read without torch?"""
