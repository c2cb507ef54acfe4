"""A room whose walls, floor and furniture are covered by small flat Gaussians, for benches."""

__all__ = ["room_parts"]

import numpy as np


def room_parts(n: int) -> dict[str, np.ndarray]:
    """Return the parts of ``n`` Gaussians: ``center``, ``scale``, ``turn``, ``opacity``, ``color``.

    ``turn`` is a quaternion that is not normalised, ``color`` harmonics of degree 3 as [n, 48].
    """
    rng = np.random.default_rng(0)
    center = rng.uniform(-1, 1, (n, 3)) * (4, 2, 4)
    wall = rng.integers(0, 3, n)
    side = np.where(rng.random(n) < 0.5, -1.0, 1.0)
    center[np.arange(n), wall] = side * np.array([4, 2, 4])[wall]
    is_furniture = rng.random(n) < 0.4
    around = rng.normal(size=(n, 3))
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    piece = rng.integers(0, 12, n)
    middles = np.random.default_rng(1).uniform(-1, 1, (12, 3)) * (3, 1.5, 3)
    center[is_furniture] = (middles[piece] + 0.5 * around)[is_furniture]
    scale = 0.008 * np.exp(0.6 * rng.normal(size=(n, 3)))
    scale[:, 2] *= 0.2
    return {
        "center": center,
        "scale": scale,
        "opacity": np.clip(rng.beta(1.2, 0.8, n), 1e-3, 1 - 1e-3),
        "turn": rng.normal(size=(n, 4)),
        "color": (0.15 * rng.standard_normal((n, 48))).astype(np.float32),
    }
