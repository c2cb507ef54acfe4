"""Tile rasterisation: which splats touch each tile, and to which colour do they blend?"""
