"""Adds GaussianAvatars' teeth to FLAME, which has none: two rows, and the triangles between them.

The published code builds them of the lips' vertices (ShenhanQian/GaussianAvatars,
``flame_model/flame.py``). Each row has 15 columns, along 15 vertices of either lip.
"""

__all__ = ["SHAPES", "TEETH", "add_teeth"]

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Int

from gsgen.reference_plugins.bodies.body_models import Body
from gsgen.reference_plugins.loading.array_pickles import read_array_pickle
from gsgen.reference_plugins.loading.errors import CheckpointInvalid

SHAPES = 300
"""Shape coefficients of FLAME; those of expressions follow."""
TEETH = 120
"""Number of added vertices."""

_COLUMNS = 15
_MASKS = ("lip_outside_ring_upper", "lip_outside_ring_lower")
# The rings of FLAME's lips, from the right to the left corner of the mouth.
_UPPER = (1713, 1715, 1716, 1735, 1696, 1694, 1657, 3543, 2774, 2811, 2813, 2850, 2833, 2832, 2830)
_LOWER = (1576, 1577, 1773, 1774, 1795, 1802, 1865, 3503, 2948, 2905, 2898, 2881, 2880, 2713, 2712)
_NECK, _JAW = 1, 2
# Order of the added rows; B is the back of a row.
_ROWS = ("ur", "lr", "ue", "le", "urB", "ueB", "lrB", "leB")
_MIDDLE = 7  # the column at which diagonals change their direction

_Index = Int[np.ndarray, " c"]
# Corners of the two triangles between columns i and i + 1 of rows a and b: (row, step) each,
# before the middle and behind it.
_Corners = tuple[tuple[tuple[int, int], ...], ...]
_OUTWARD: tuple[_Corners, _Corners] = (
    (((0, 0), (1, 1), (1, 0)), ((0, 0), (0, 1), (1, 1))),
    (((0, 0), (0, 1), (1, 0)), ((0, 1), (1, 1), (1, 0))),
)
_INWARD: tuple[_Corners, _Corners] = (
    (((0, 0), (1, 0), (1, 1)), ((0, 0), (1, 1), (0, 1))),
    (((0, 0), (1, 0), (0, 1)), ((0, 1), (1, 0), (1, 1))),
)
_TOP: tuple[_Corners, _Corners] = (
    (((0, 0), (1, 0), (0, 1)), ((0, 1), (1, 0), (1, 1))),
    (((0, 0), (1, 0), (1, 1)), ((0, 0), (1, 1), (0, 1))),
)
_BOTTOM: tuple[_Corners, _Corners] = (
    (((0, 0), (0, 1), (1, 0)), ((0, 1), (1, 1), (1, 0))),
    (((0, 0), (1, 1), (1, 0)), ((0, 0), (0, 1), (1, 1))),
)
_STRIPS = (
    ("ur", "ue", _OUTWARD), ("urB", "ueB", _INWARD), ("ueB", "ue", _TOP),
    ("le", "lr", _BOTTOM), ("lrB", "leB", _OUTWARD), ("leB", "le", _BOTTOM),
)  # fmt: skip


def add_teeth(body: Body) -> Body:
    """Return FLAME with the vertices and triangles of teeth."""
    upper, lower = _lips(body)
    u, l = body.template[upper], body.template[lower]  # noqa: E741
    size = float(np.linalg.norm(u - l, axis=1).mean())
    middle = (u + l) / 2
    middle[:, 1] = middle[:, 1].mean()
    middle[:, 2] -= 1.5 * size
    y, z = size * np.eye(3)[1], size * np.eye(3)[2]
    upper_edge, lower_edge = middle + 0.1 * y, middle - 0.1 * y - 0.4 * z
    rows = {"ue": upper_edge, "ur": upper_edge + 2 * y, "le": lower_edge, "lr": lower_edge - 2 * y}
    rows |= {f"{name}B": row - z for name, row in rows.items()}
    template = np.concatenate([rows[name] for name in _ROWS])
    shape_dirs = np.zeros((TEETH, *body.shape_dirs.shape[1:]))
    between = (body.shape_dirs[upper] + body.shape_dirs[lower])[:, :, :SHAPES] / 2
    shape_dirs[:, :, :SHAPES] = np.tile(between, (len(_ROWS), 1, 1))
    weights = np.zeros((TEETH, body.joints))
    for index, name in enumerate(_ROWS):
        part = slice(index * _COLUMNS, (index + 1) * _COLUMNS)
        weights[part, _NECK if name.startswith("u") else _JAW] = 1
    start = len(body.template)
    indices = {name: start + _COLUMNS * i + np.arange(_COLUMNS) for i, name in enumerate(_ROWS)}
    strips = [_strip(indices[a], indices[b], corners) for a, b, corners in _STRIPS]
    none = np.zeros((TEETH, *body.pose_dirs.shape[1:]))
    return replace(
        body,
        template=np.concatenate([body.template, template]),
        shape_dirs=np.concatenate([body.shape_dirs, shape_dirs]),
        pose_dirs=np.concatenate([body.pose_dirs, none]),
        weights=np.concatenate([body.weights, weights]),
        regressor=np.concatenate([body.regressor, np.zeros((body.joints, TEETH))], axis=1),
        faces=np.concatenate([body.faces, *strips]),
    )


def _strip(a: _Index, b: _Index, corners: tuple[_Corners, _Corners]) -> Int[np.ndarray, "f 3"]:
    """Return the triangles between two rows of vertices."""
    rows = (a, b)
    return np.array(
        [
            [rows[row][column + step] for row, step in triangle]
            for column in range(_COLUMNS - 1)
            for triangle in corners[column >= _MIDDLE]
        ]
    )


def _lips(body: Body) -> tuple[_Index, _Index]:
    """Return FLAME's lip vertices, from ``FLAME_masks.pkl`` beside the model if it exists."""
    path: Path = body.path.with_name("FLAME_masks.pkl")
    masks = read_array_pickle(path, _MASKS) if path.is_file() else {}
    named: Sequence[object] = [masks.get(name) for name in _MASKS]
    default: Callable[[Sequence[int]], _Index] = np.array
    upper, lower = (
        default(ring) if mask is None else np.asarray(mask)
        for mask, ring in zip(named, (_UPPER, _LOWER), strict=True)
    )
    for name, ring in zip(_MASKS, (upper, lower), strict=True):
        is_valid = ring.shape == (_COLUMNS,) and ring.dtype.kind in "iu"
        if not is_valid or not ((ring >= 0) & (ring < len(body.template))).all():
            message = f"{name} is not {_COLUMNS} of the {len(body.template)} vertices"
            raise CheckpointInvalid(message, where=str(path if path.is_file() else body.path))
    return upper, lower
