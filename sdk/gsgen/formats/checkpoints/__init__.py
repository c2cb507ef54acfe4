"""Which files of PyTorch trainings hold plain splats, and how are they read without torch?"""
