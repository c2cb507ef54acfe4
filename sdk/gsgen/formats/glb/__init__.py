"""How are glTF binaries with Gaussian splats read and written?"""
