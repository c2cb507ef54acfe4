"""How are glTF binary files (GLB) with Gaussian splats read and written?"""
