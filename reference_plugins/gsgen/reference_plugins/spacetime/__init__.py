"""How are Gaussians exported that store their own motion: SpacetimeGaussians and rotor 4DGS?"""
