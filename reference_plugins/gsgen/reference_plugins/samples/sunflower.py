"""An ONNX generator made without torch: a sunflower that sways with time and bends by a pose.

Its Gaussians follow three joints by linear blend skinning: stem, neck and head.
"""

__all__ = ["JOINTS", "sunflower_model", "write_nods"]

from pathlib import Path
from typing import Final

import numpy as np
import onnx

from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.spec.geometry import rotation_matrix
from gsgen.contract.spec.manifest import (
    AppearanceOutput,
    Bounds,
    CountOutput,
    GaussiansOutput,
    GeneratorManifest,
    GeneratorOutputs,
    Input,
    Joint,
    Space,
)
from gsgen.formats import Splats
from gsgen.formats.shared.quantities import SH_C0
from gsgen.reference_plugins.samples.garden import apply_lighting
from gsgen.reference_plugins.samples.surfaces import Cloud, join, on_disc, on_ellipsoid, on_lathe

JOINTS: Final = (
    Joint("stem", None, (0.0, 0.0, 0.0)),
    Joint("neck", "stem", (0.0, -0.75, 0.0)),
    Joint("head", "neck", (0.0, -1.25, 0.0)),
)
_SWAY_PHASE: Final = (0.0, -0.6, -1.2)  # of each joint's sway, in radians
_SWAY_ANGLES: Final = (
    (0.03, 0.0, 0.06),
    (0.05, 0.0, 0.1),
    (0.08, 0.05, 0.12),
)  # axis-angles, radians
_SKEW_MATRICES = np.zeros((3, 9))  # axis-angle → its cross-product matrix, row by row
for _axis, _positive_face, _negative_face in ((0, 7, 5), (1, 2, 6), (2, 3, 1)):
    _SKEW_MATRICES[_axis, [_positive_face, _negative_face]] = 1, -1
_UPPER_TRIANGLE = np.zeros((9, 6))  # a symmetric matrix, row by row → xx xy xz yy yz zz
_UPPER_TRIANGLE[[0, 1, 2, 4, 5, 8], range(6)] = 1

_PLUGIN_TEXT = """
    angle = Mul (time, full_turn) shifted = Add (angle, phase) wave = Sin (shifted)
    swaying = Mul (wave, sway) vector = Add (pose, swaying)
    squares = Mul (vector, vector) sum_of_squares = ReduceSum (squares, last_axis)
    square = Add (sum_of_squares, tiny) theta = Sqrt (square)
    sine = Sin (theta) sine_share = Div (sine, theta) cosine = Cos (theta)
    rest_of_cosine = Sub (one, cosine) cosine_share = Div (rest_of_cosine, square)
    flat_skew = MatMul (vector, skew) cross = Reshape (flat_skew, three_matrices)
    sine_factor = Reshape (sine_share, three_factors)
    cosine_factor = Reshape (cosine_share, three_factors)
    twice = MatMul (cross, cross) first = Mul (sine_factor, cross)
    second = Mul (cosine_factor, twice) turned = Add (identity, first)
    local = Add (turned, second)
    stem, neck, head = Split <axis = 0, num_outputs = 3> (local)
    stem_neck = MatMul (stem, neck) whole = MatMul (stem_neck, head)
    neck_at = MatMul (stem, neck_bone) head_from_neck = MatMul (stem_neck, head_bone)
    head_at = Add (neck_at, head_from_neck)
    stem_pivot = MatMul (stem, stem_rest) neck_pivot = MatMul (stem_neck, neck_rest)
    head_pivot = MatMul (whole, head_rest)
    stem_shift = Neg (stem_pivot) neck_shift = Sub (neck_at, neck_pivot)
    head_shift = Sub (head_at, head_pivot)
    rotations = Concat <axis = 0> (stem, stem_neck, whole)
    shifts = Concat <axis = 0> (stem_shift, neck_shift, head_shift)
    flat_rotations = Reshape (rotations, three_rows) flat_shifts = Reshape (shifts, three_vectors)
    blended = MatMul (skin, flat_rotations) blended_shift = MatMul (skin, flat_shifts)
    matrix = Reshape (blended, matrices)
    carried = MatMul (matrix, center) flat = Reshape (carried, vectors)
    position = Add (flat, blended_shift)
    transposed = Transpose <perm = [0, 2, 1]> (matrix)
    left = MatMul (matrix, spread) covariance = MatMul (left, transposed)
    flat_covariance = Reshape (covariance, nines) upper = MatMul (flat_covariance, pick_upper)
    gaussians = Concat <axis = 1> (position, opacity, upper)
    color = Identity (colors) num_points = Identity (live)
"""


def sunflower_model(count: int = 4000, *, seed: int = 0) -> onnx.ModelProto:
    """Return an ONNX generator of about ``count`` Gaussians with inputs ``time`` and ``pose``."""
    splats, skin = _sunflower(count, seed)
    n = len(splats)
    rotation_matrices = rotation_matrix(splats.rotation.astype(np.float64))
    axes = rotation_matrices * np.exp(splats.log_scale.astype(np.float64))[:, None]
    bones = np.asarray([joint.rest for joint in JOINTS], np.float64)
    columns = [bone[None, :, None] for bone in bones]
    floats = {
        "full_turn": [2 * np.pi], "phase": np.asarray(_SWAY_PHASE)[:, None], "sway": _SWAY_ANGLES,
        "tiny": [1e-12], "one": [1.0], "skew": _SKEW_MATRICES, "identity": np.eye(3)[None],
        "stem_rest": columns[0], "neck_rest": columns[1], "head_rest": columns[2],
        "neck_bone": columns[1] - columns[0], "head_bone": columns[2] - columns[1],
        "skin": skin, "center": splats.position[:, :, None], "pick_upper": _UPPER_TRIANGLE,
        "opacity": 1 / (1 + np.exp(-splats.logit_opacity))[:, None],
        "spread": axes @ axes.transpose(0, 2, 1),
        "colors": np.clip(0.5 + SH_C0 * splats.sh[:, 0], 0, 1),
    }  # fmt: skip
    sizes = {
        "last_axis": [1], "three_matrices": [3, 3, 3], "three_factors": [3, 1, 1],
        "three_rows": [3, 9], "three_vectors": [3, 3], "matrices": [n, 3, 3], "vectors": [n, 3],
        "nines": [n, 9],
    }  # fmt: skip
    weights = {name: np.asarray(values, np.float32) for name, values in floats.items()}
    weights |= {name: np.asarray(shape, np.int64) for name, shape in sizes.items()}
    return ModelSpec(
        inputs="float[1] time, float[3,3] pose",
        outputs=f"float[{n},10] gaussians, float[{n},3] color, int32[1] num_points",
        body=_PLUGIN_TEXT,
        weights=weights | {"live": np.asarray([n], np.int32)},
        manifest=_manifest(n),
    ).build()


def _manifest(count: int) -> GeneratorManifest:
    return GeneratorManifest(
        name="sunflower",
        inputs=(
            Input(
                name="time",
                role="time",
                range=(0.0, 1.0),
                default=0.0,
                loop=True,
                frames=48,
                fps=24.0,
            ),
            Input(
                name="pose",
                role="pose",
                shape=(3, 3),
                range=(-1.0, 1.0),
                default="zeros",
                convention="axis-angle",
                joints=JOINTS,
            ),
        ),
        outputs=GeneratorOutputs(
            GaussiansOutput("gaussians", count),
            AppearanceOutput("color", "rgb"),
            CountOutput("num_points"),
        ),
        space=Space(),
        bounds=Bounds((-2.0, -2.0, -2.0), (2.0, 2.0, 2.0)),
    )


def _sunflower(count: int, seed: int) -> tuple[Splats, np.ndarray]:
    """Return a sunflower's splats at rest, y down, and their skinning weights, [n, 3]."""
    rng = np.random.default_rng(seed)
    stem = on_lathe(int(0.22 * count), [(0.035, 0.0), (0.025, 1.25)], np.array([0.2, 0.42, 0.1]))
    leaf = on_ellipsoid(
        int(0.07 * count), (0.2, 0.02, 0.1), np.array([0.16, 0.4, 0.08]), rng, size=0.014
    )
    flower_center = on_disc(int(0.26 * count), 0.15, np.array([0.24, 0.12, 0.05]))
    ring_radius = (
        np.hypot(flower_center.position[:, 0], flower_center.position[:, 2])[:, None] / 0.15
    )
    seeds = Cloud(
        position=flower_center.position + np.array([0.0, 0.05, 0.0]) * (1 - ring_radius**2),
        normal=flower_center.normal,
        along=flower_center.along,
        scale=flower_center.scale,
        color=flower_center.color
        * (0.6 + 0.9 * ring_radius)
        * np.exp(0.25 * rng.normal(size=ring_radius.shape)),
        translucency=flower_center.translucency,
    )
    flower_back_points = on_lathe(
        int(0.1 * count), [(0.02, -0.06), (0.15, -0.015)], np.array([0.2, 0.38, 0.1])
    )
    face = _tilt_cloud(
        join([seeds, flower_back_points, *_petal_clouds(int(0.35 * count), rng)]), 62.0
    )
    plant = join([
        stem, leaf.moved((0.2, 0.45, 0.0)), leaf.moved((-0.19, 0.68, 0.03)),
        face.moved((0.0, 1.28, 0.03)),
    ])  # fmt: skip
    height = plant.position[:, 1]
    stem_bend_weight = np.clip((height - 0.55) / 0.4, 0, 1)
    nod_share = np.clip((height - 1.1) / 0.15, 0, 1)
    nod_share[-len(face) :], stem_bend_weight[-len(face) :] = 1.0, 1.0  # the head is rigid
    return apply_lighting(plant, shadows=False), np.stack(
        [1 - stem_bend_weight, stem_bend_weight - nod_share, nod_share], axis=1
    )


def _petal_clouds(count: int, rng: np.random.Generator) -> list[Cloud]:
    """Return two rings of petals around +y; each petal is a row of Gaussians."""
    number = max(8, count // 12)
    petals = []
    for index in range(number):
        angle = 2 * np.pi * (index + 0.5 * (index % 2)) / number
        petal_axis = np.array([np.cos(angle), 0.0, np.sin(angle)])
        petal_width_axis = np.array([-np.sin(angle), 0.0, np.cos(angle)])
        petal_distance = np.linspace(0.15, 0.35 + 0.03 * rng.random(), 12)[:, None]
        petal_height = (0.12 if index % 2 else 0.04) * (petal_distance - 0.15) / 0.2
        width = 0.026 * np.sin(np.pi * np.clip((petal_distance - 0.1) / 0.28, 0.05, 0.97))
        normal = np.cross(petal_width_axis, petal_axis)
        petals.append(
            Cloud(
                position=petal_distance * petal_axis + petal_height * np.array([0.0, 1.0, 0.0]),
                normal=np.tile(normal, (12, 1)),
                along=np.tile(petal_axis, (12, 1)),
                scale=np.concatenate([np.full((12, 1), 0.016), width, np.full((12, 1), 0.004)], 1),
                color=np.array([0.98, 0.62, 0.05])
                * rng.uniform(0.8, 1.08)
                * (0.75 + 0.9 * petal_distance),
                translucency=np.full(12, 0.6),
            )
        )
    return petals


def _tilt_cloud(cloud: Cloud, degrees: float) -> Cloud:
    """Return Gaussians rotated about x, so that the upward direction becomes +z."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[1, 0, 0], [0, c, s], [0, -s, c]])  # of rows
    return Cloud(
        position=cloud.position @ turn,
        normal=cloud.normal @ turn,
        along=cloud.along @ turn,
        scale=cloud.scale,
        color=cloud.color,
        translucency=cloud.translucency,
    )


def write_nods(path: Path, *, frames: int = 48) -> Path:
    """Write a motion of the sunflower, axis-angles of [frames, 3, 3]: it nods and looks around."""
    along = 2 * np.pi * np.arange(frames) / frames
    poses = np.zeros((frames, 3, 3), np.float32)
    poses[:, 0, 2] = 0.12 * np.sin(along)
    poses[:, 1, 0] = 0.25 * np.sin(2 * along)
    poses[:, 2, 1] = 0.6 * np.sin(along)
    np.save(path, poses)
    return path
