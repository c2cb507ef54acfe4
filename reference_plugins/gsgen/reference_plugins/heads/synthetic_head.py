"""Writes a synthetic checkpoint of GaussianAvatars, with a face model of FLAME's layout.

The head is an ellipsoid of our own making, with eyes, lips and a jaw that opens; nothing of FLAME
is in it.
"""

__all__ = ["write_gaussian_avatar"]

import pickle
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from gsgen.formats.shared.quantities import SH_C0
from gsgen.reference_plugins.heads.teeth import SHAPE_COUNT
from gsgen.reference_plugins.writing.run_files import write_cfg_args, write_columns

_ITERATION_NUMBER = 600_000
_HEAD_HALF_AXES = np.array([0.09, 0.13, 0.11])  # half axes, in metres


def write_gaussian_avatar(
    folder: Path,
    *,
    count: int = 80,
    rings: int = 12,
    expressions: int = 10,
    teeth: bool = True,
    seed: int = 0,
) -> Path:
    """Write a synthetic checkpoint of GaussianAvatars, and return the folder.

    ``assets`` of the folder has the face model, of ``rings`` × 2 ``rings`` vertices. ``teeth``
    gives the vertices of the teeth their offsets, with which the published code adds them.
    """
    rng = np.random.default_rng(seed)
    vertices, faces = _ellipsoid_mesh(rings)
    _write_face_model(folder / "assets", vertices, faces, expressions, rng)
    files = folder / f"point_cloud/iteration_{_ITERATION_NUMBER}"
    files.mkdir(parents=True, exist_ok=True)
    total = len(vertices) + (120 if teeth else 0)
    frames = 3
    np.savez(
        files / "flame_param.npz",
        shape=rng.normal(0, 0.5, SHAPE_COUNT).astype(np.float32),
        expr=rng.normal(size=(frames, expressions)).astype(np.float32),
        rotation=np.zeros((frames, 3), np.float32),
        neck_pose=np.zeros((frames, 3), np.float32),
        jaw_pose=np.zeros((frames, 3), np.float32),
        eyes_pose=np.zeros((frames, 6), np.float32),
        translation=np.zeros((frames, 3), np.float32),
        static_offset=rng.normal(0, 2e-4, (1, total, 3)).astype(np.float32),
        dynamic_offset=np.zeros((frames, total, 3), np.float32),
    )
    triangles = len(faces) + (168 if teeth else 0)
    binding = rng.integers(0, triangles, count)
    direction = np.zeros((count, 3))
    face = binding < len(faces)
    direction[face] = (vertices[faces[binding[face]]].mean(axis=1)) / _HEAD_HALF_AXES
    color = np.where(face[:, None], _skin_color(direction), [0.9, 0.88, 0.82])
    columns = dict(zip("xyz", rng.normal(0, 0.3, (3, count)), strict=True))
    columns |= dict.fromkeys(("nx", "ny", "nz"), np.zeros(count))
    tables = {
        "f_dc": (color - 0.5) / SH_C0,
        "f_rest": np.zeros((count, 45)),
        "scale": np.log(0.35) + 0.2 * rng.normal(size=(count, 3)),
        "rot": rng.normal(size=(count, 4)),
    }
    for name, table in tables.items():
        columns |= {f"{name}_{index}": column for index, column in enumerate(table.T)}
    columns |= {"opacity": rng.normal(3, 0.5, count), "binding_0": binding.astype(np.float64)}
    write_columns(files / "point_cloud.ply", columns)
    write_cfg_args(folder, {"bind_to_mesh": True, "sh_degree": 3})
    return folder


def _ellipsoid_mesh(rings: int) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Return vertices and triangles of an ellipsoid, which looks along +z with y up."""
    columns = 2 * rings
    height = np.cos(np.pi * (np.arange(rings) + 0.5) / rings)
    angles = 2 * np.pi * np.arange(columns) / columns
    radius = np.sqrt(1 - height**2)
    unit = np.stack(
        [
            radius[:, None] * np.sin(angles),
            np.broadcast_to(height[:, None], (rings, columns)),
            radius[:, None] * np.cos(angles),
        ],
        axis=2,
    ).reshape(-1, 3)
    index = np.arange(rings * columns).reshape(rings, columns)
    a, b = index[:-1], np.roll(index, -1, axis=1)[:-1]
    c, d = index[1:], np.roll(index, -1, axis=1)[1:]
    faces = np.concatenate(
        [np.stack([a, c, b], axis=2).reshape(-1, 3), np.stack([b, c, d], axis=2).reshape(-1, 3)]
    )
    return unit * _HEAD_HALF_AXES, faces


def _write_face_model(
    folder: Path,
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    expressions: int,
    rng: np.random.Generator,
) -> None:
    count, unit = len(vertices), vertices / _HEAD_HALF_AXES
    # Coefficients are smooth fields over the head.
    wave_vectors = rng.normal(size=(3, SHAPE_COUNT + expressions))
    wave_field = np.sin(2 * unit @ wave_vectors)[:, None] * rng.normal(
        0, 2e-3, (1, 3, SHAPE_COUNT + expressions)
    )
    wave_field[:, :, :SHAPE_COUNT] *= 0.1
    jaw_skinning_weights = 1 / (1 + np.exp(12 * (unit[:, 1] + 0.35))) * (unit[:, 2] > 0)
    neck_weights = 1 - jaw_skinning_weights
    joints = np.array(
        [[0, -0.15, 0], [0, -0.1, 0], [0, 0, 0.02], [0.03, 0.03, 0.07], [-0.03, 0.03, 0.07]]
    )
    # A joint is the mean of the vertices, weighted by their distance.
    distance = np.linalg.norm(vertices[None] - joints[:, None], axis=2)
    regressor = np.exp(-distance / 0.05)
    regressor /= regressor.sum(axis=1, keepdims=True)
    # Both lips are arcs of 15 vertices around the middle of the face.
    rings = round((count / 2) ** 0.5)
    arc_indices = np.arange(-7, 8) % (2 * rings)
    upper_ring = 2 * rings * round(0.6 * rings) + arc_indices
    lower_ring = upper_ring + 2 * rings * max(1, round(0.06 * rings))
    model = {
        "v_template": vertices,
        "f": faces.astype(np.uint32),
        "shapedirs": wave_field,
        "posedirs": rng.normal(0, 1e-3, (count, 3, 36)),
        "J_regressor": regressor,
        "weights": np.stack(
            [
                0 * neck_weights,
                neck_weights,
                jaw_skinning_weights,
                0 * neck_weights,
                0 * neck_weights,
            ],
            axis=1,
        ),
        "kintree_table": np.array([[2**32 - 1, 0, 1, 1, 1], range(5)], np.uint32),
    }
    masks = {"lip_outside_ring_upper": upper_ring, "lip_outside_ring_lower": lower_ring}
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in (("flame2023.pkl", model), ("FLAME_masks.pkl", masks)):
        (folder / name).write_bytes(pickle.dumps(content, protocol=2))


def _skin_color(direction: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Return the colour of hair, skin, eyes or lips for each direction from the head's centre."""
    x, y, z = direction.T
    color = np.tile([0.85, 0.66, 0.55], (len(direction), 1))
    color[(y > 0.5) | (z < -0.1)] = [0.25, 0.16, 0.1]
    is_eye = (z > 0) & ((np.abs(x) - 0.35) ** 2 + (y - 0.2) ** 2 < 0.02)
    color[is_eye] = [0.15, 0.35, 0.6]
    color[(z > 0) & (np.abs(x) < 0.4) & (np.abs(y + 0.35) < 0.08)] = [0.75, 0.25, 0.28]
    return color
