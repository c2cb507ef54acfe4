"""Anchor-decoded scenes: Scaffold-GS, Octree-GS, Duplex-GS."""
