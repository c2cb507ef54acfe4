"""Projection: where in the image is each Gaussian, and which colour does it have?"""
