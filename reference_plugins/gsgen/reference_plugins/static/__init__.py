"""Splats and point clouds that do not move."""
