"""Which plugins compute Gaussians from pictures, in one pass? Splatter Image and LGM."""
