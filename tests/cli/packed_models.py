"""Small models that hold packed rows."""

from pathlib import Path

import numpy as np

from gsgen.formats import PackedRows
from gsgen.reference_plugins.static.static import from_content
from support.models.static_scenes import write_scene


def rows(n: int = 40, dtype: type = np.float32) -> np.ndarray:
    rng = np.random.default_rng(5)
    result = np.zeros((n, 10), dtype)
    result[:, :3] = rng.normal(size=(n, 3))
    result[:, 3] = rng.uniform(0.2, 0.9, n)
    result[:, [4, 7, 9]] = rng.uniform(0.01, 0.1, (n, 3))
    return result


def write_rows(path: Path, packed: np.ndarray, color: np.ndarray | None = None) -> Path:
    if color is None:
        color = np.full((len(packed), 4), 0.5, packed.dtype)
    write_scene(from_content(PackedRows(packed, color)), path)
    return path
