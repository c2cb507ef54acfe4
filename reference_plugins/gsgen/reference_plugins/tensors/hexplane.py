"""The order of a hexplane's six planes (Cao and Johnson 2023), as checkpoints number them.

The planes are pairs of the axes x, y, z and time: xy, xz, xt, yz, yt, zt.
"""

__all__ = ["PLANE_COUNT", "SPACE_PLANES", "TIME_PLANES"]

PLANE_COUNT = 6
SPACE_PLANES = {0: (0, 1), 1: (0, 2), 3: (1, 2)}
"""Plane of two axes of space → these axes."""
TIME_PLANES = (2, 4, 5)
"""The planes of time with x, y and z."""
