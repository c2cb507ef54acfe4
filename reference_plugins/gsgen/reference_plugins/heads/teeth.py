"""Adds GaussianAvatars' teeth to FLAME, which has none: two rows, and the triangles between them.

The published code builds them of the lips' vertices (ShenhanQian/GaussianAvatars,
``flame_model/flame.py``). Each row has 15 columns, along 15 vertices of either lip.
"""

__all__ = ["SHAPE_COUNT", "TEETH_VERTEX_COUNT", "add_teeth"]

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Int

from gsgen.reference_plugins.bodies.body_models import Body
from gsgen.reference_plugins.loading.array_pickles import read_array_pickle
from gsgen.reference_plugins.loading.errors import CheckpointInvalid

SHAPE_COUNT = 300
"""Shape coefficients of FLAME; those of expressions follow."""
TEETH_VERTEX_COUNT = 120
"""Number of added vertices."""

_COLUMN_COUNT = 15
_MASK_NAMES = ("lip_outside_ring_upper", "lip_outside_ring_lower")
# The rings of FLAME's lips, from the right to the left corner of the mouth.
_UPPER_LIP = (
    1713,
    1715,
    1716,
    1735,
    1696,
    1694,
    1657,
    3543,
    2774,
    2811,
    2813,
    2850,
    2833,
    2832,
    2830,
)
_LOWER_LIP = (
    1576,
    1577,
    1773,
    1774,
    1795,
    1802,
    1865,
    3503,
    2948,
    2905,
    2898,
    2881,
    2880,
    2713,
    2712,
)
_NECK_JOINT, _JAW_JOINT = 1, 2
# Order of the added rows; B is the back of a row.
_ROW_NAMES = ("ur", "lr", "ue", "le", "urB", "ueB", "lrB", "leB")
_MIDDLE_COLUMN = 7  # the column at which diagonals change their direction

_VertexIndices = Int[np.ndarray, " c"]
# Corners of the two triangles between columns i and i + 1 of rows a and b: (row, step) each,
# before the middle and behind it.
_Corners = tuple[tuple[tuple[int, int], ...], ...]
_OUTWARD_CORNERS: tuple[_Corners, _Corners] = (
    (((0, 0), (1, 1), (1, 0)), ((0, 0), (0, 1), (1, 1))),
    (((0, 0), (0, 1), (1, 0)), ((0, 1), (1, 1), (1, 0))),
)
_INWARD_CORNERS: tuple[_Corners, _Corners] = (
    (((0, 0), (1, 0), (1, 1)), ((0, 0), (1, 1), (0, 1))),
    (((0, 0), (1, 0), (0, 1)), ((0, 1), (1, 0), (1, 1))),
)
_TOP_CORNERS: tuple[_Corners, _Corners] = (
    (((0, 0), (1, 0), (0, 1)), ((0, 1), (1, 0), (1, 1))),
    (((0, 0), (1, 0), (1, 1)), ((0, 0), (1, 1), (0, 1))),
)
_BOTTOM_CORNERS: tuple[_Corners, _Corners] = (
    (((0, 0), (0, 1), (1, 0)), ((0, 1), (1, 1), (1, 0))),
    (((0, 0), (1, 1), (1, 0)), ((0, 0), (0, 1), (1, 1))),
)
_STRIP_FACE_TABLE = (
    ("ur", "ue", _OUTWARD_CORNERS), ("urB", "ueB", _INWARD_CORNERS), ("ueB", "ue", _TOP_CORNERS),
    ("le", "lr", _BOTTOM_CORNERS), ("lrB", "leB", _OUTWARD_CORNERS), ("leB", "le", _BOTTOM_CORNERS),
)  # fmt: skip


def add_teeth(body: Body) -> Body:
    """Return FLAME with the vertices and triangles of teeth."""
    upper_lip, lower_lip = _lip_vertex_indices(body)
    upper_points, lower_points = body.template[upper_lip], body.template[lower_lip]
    size = float(np.linalg.norm(upper_points - lower_points, axis=1).mean())
    lip_center = (upper_points + lower_points) / 2
    lip_center[:, 1] = lip_center[:, 1].mean()
    lip_center[:, 2] -= 1.5 * size
    y, z = size * np.eye(3)[1], size * np.eye(3)[2]
    upper_edge, lower_edge = lip_center + 0.1 * y, lip_center - 0.1 * y - 0.4 * z
    rows = {"ue": upper_edge, "ur": upper_edge + 2 * y, "le": lower_edge, "lr": lower_edge - 2 * y}
    rows |= {f"{name}B": row - z for name, row in rows.items()}
    template = np.concatenate([rows[name] for name in _ROW_NAMES])
    shape_dirs = np.zeros((TEETH_VERTEX_COUNT, *body.shape_dirs.shape[1:]))
    lip_shape_dirs = (body.shape_dirs[upper_lip] + body.shape_dirs[lower_lip])[
        :, :, :SHAPE_COUNT
    ] / 2
    shape_dirs[:, :, :SHAPE_COUNT] = np.tile(lip_shape_dirs, (len(_ROW_NAMES), 1, 1))
    weights = np.zeros((TEETH_VERTEX_COUNT, body.joints))
    for index, name in enumerate(_ROW_NAMES):
        part = slice(index * _COLUMN_COUNT, (index + 1) * _COLUMN_COUNT)
        weights[part, _NECK_JOINT if name.startswith("u") else _JAW_JOINT] = 1
    start = len(body.template)
    indices = {
        name: start + _COLUMN_COUNT * i + np.arange(_COLUMN_COUNT)
        for i, name in enumerate(_ROW_NAMES)
    }
    face_strips = [
        _strip_faces(indices[a], indices[b], corners) for a, b, corners in _STRIP_FACE_TABLE
    ]
    zero_pose_dirs = np.zeros((TEETH_VERTEX_COUNT, *body.pose_dirs.shape[1:]))
    return replace(
        body,
        template=np.concatenate([body.template, template]),
        shape_dirs=np.concatenate([body.shape_dirs, shape_dirs]),
        pose_dirs=np.concatenate([body.pose_dirs, zero_pose_dirs]),
        weights=np.concatenate([body.weights, weights]),
        regressor=np.concatenate(
            [body.regressor, np.zeros((body.joints, TEETH_VERTEX_COUNT))], axis=1
        ),
        faces=np.concatenate([body.faces, *face_strips]),
    )


def _strip_faces(
    a: _VertexIndices, b: _VertexIndices, corners: tuple[_Corners, _Corners]
) -> Int[np.ndarray, "f 3"]:
    """Return the triangles between two rows of vertices."""
    rows = (a, b)
    return np.array(
        [
            [rows[row][column + step] for row, step in triangle]
            for column in range(_COLUMN_COUNT - 1)
            for triangle in corners[column >= _MIDDLE_COLUMN]
        ]
    )


def _lip_vertex_indices(body: Body) -> tuple[_VertexIndices, _VertexIndices]:
    """Return FLAME's lip vertices, from ``FLAME_masks.pkl`` beside the model if it exists."""
    path: Path = body.path.with_name("FLAME_masks.pkl")
    masks = read_array_pickle(path, _MASK_NAMES) if path.is_file() else {}
    lip_masks: Sequence[object] = [masks.get(name) for name in _MASK_NAMES]
    default: Callable[[Sequence[int]], _VertexIndices] = np.array
    upper_lip, lower_lip = (
        default(ring_vertices) if mask is None else np.asarray(mask)
        for mask, ring_vertices in zip(lip_masks, (_UPPER_LIP, _LOWER_LIP), strict=True)
    )
    for name, ring_vertices in zip(_MASK_NAMES, (upper_lip, lower_lip), strict=True):
        is_valid = ring_vertices.shape == (_COLUMN_COUNT,) and ring_vertices.dtype.kind in "iu"
        if not is_valid or not ((ring_vertices >= 0) & (ring_vertices < len(body.template))).all():
            message = f"{name} is not {_COLUMN_COUNT} of the {len(body.template)} vertices"
            raise CheckpointInvalid(message, where=str(path if path.is_file() else body.path))
    return upper_lip, lower_lip
