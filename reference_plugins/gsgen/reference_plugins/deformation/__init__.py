"""Deformed scenes: Deformable 3DGS and HexPlane 4DGS."""
