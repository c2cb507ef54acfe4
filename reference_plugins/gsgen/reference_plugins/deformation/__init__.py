"""How are deforming scenes exported: Deformable-3D-Gaussians, 4DGaussians, SC-GS?"""
