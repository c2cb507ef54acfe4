"""How are deforming scenes exported: Deformable-3D-Gaussians and 4DGaussians?"""
