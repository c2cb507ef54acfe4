"""How are glTF binaries with Gaussians read and written?"""
