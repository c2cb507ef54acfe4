"""A stand-in of the package of 3DTopia/LGM, for tests without a checkout: names as in its code."""
