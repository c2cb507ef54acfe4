"""Exports Gaussians that store their own motion: SpacetimeGaussians and rotor 4DGS."""
