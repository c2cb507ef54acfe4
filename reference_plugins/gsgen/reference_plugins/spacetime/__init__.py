"""Exports Gaussians that store their own motion: SpacetimeGaussians, rotor 4DGS and Ex4DGS."""
