"""Right models whose numbers look like a mistake at first sight."""

from collections.abc import Callable
from functools import partial

import numpy as np

from contract.adversarial.case import Draft, right_model
from contract.adversarial.drafts import static
from contract.adversarial.scenes import C0, Array, Scene, rows, scene, sh_columns, upper_triangle

TOOL = "raw protos"

Parts = tuple[Array, Array]


def _unusual(kind: str, change: Callable[[Array, Array, Scene], Parts], degree: int) -> Draft:
    """A static model of changed rows and harmonics."""
    source = scene(kind, seed=110)
    packed, color = change(rows(source), sh_columns(source, degree), source)
    bounds = (packed[:, :3].min(0), packed[:, :3].max(0))
    return static(source, packed=packed, color=color, degree=degree, bounds=bounds)


def _voxels(packed: Array, color: Array, source: Scene) -> Parts:
    """Round Gaussians on a grid of 4³: whole coordinates, no off-diagonals."""
    grid = np.stack(np.meshgrid(*[np.arange(4.0)] * 3), -1).reshape(-1, 3)
    packed[:, :3] = grid
    packed[:, 4:] = [0.16, 0, 0, 0.16, 0, 0.16]
    return packed, color


def _boxes(packed: Array, color: Array, source: Scene) -> Parts:
    """Discs that lie on the walls of an upright room: no off-diagonals, thin along one axis."""
    half = np.array([2.0, 1.3, 2.5])
    wall = np.argmax(np.abs(source.position) / half, axis=1)
    variances = np.full((len(packed), 3), 0.09)
    variances[np.arange(len(packed)), wall] = 0.0004
    packed[:, 4:] = 0
    packed[:, [4, 7, 9]] = variances
    return packed, color


def _bright(packed: Array, color: Array, source: Scene) -> Parts:
    """A white object: no colour is darker than grey."""
    color[:, :3] = (0.78 + 0.05 * color[:, :3] - 0.5) / C0
    return packed, color


def _dark(packed: Array, color: Array, source: Scene) -> Parts:
    """A night scene: no colour is brighter than a fifth."""
    color[:, :3] = (0.1 + 0.02 * color[:, :3] - 0.5) / C0
    return packed, color


def _foggy(packed: Array, color: Array, source: Scene) -> Parts:
    """A bright, grey day: hardly any contrast."""
    color[:, :3] = 0.3 * color[:, :3] + 0.7
    return packed, color


def _one_color(packed: Array, color: Array, source: Scene) -> Parts:
    """An unpainted statue of clay."""
    color[:] = 0
    color[:, :3] = [0.9, 0.4, -0.1]
    return packed, color


def _matte(packed: Array, color: Array, source: Scene) -> Parts:
    """Degree 3 that no view-dependent coefficient uses."""
    color[:, 3:] = 0
    return packed, color


def _shiny(packed: Array, color: Array, source: Scene) -> Parts:
    """Strong highlights: the first degree is as large as the colour."""
    random = np.random.default_rng(7)
    color[:, 3:12] = 0.4 * np.repeat(random.normal(size=(len(packed), 3)), 3, axis=1)
    return packed, color


def _translucent(packed: Array, color: Array, source: Scene) -> Parts:
    """A veil: opacities between 0.35 and 0.65."""
    packed[:, 3] = 0.35 + 0.3 * packed[:, 3]
    return packed, color


def _smoke(packed: Array, color: Array, source: Scene) -> Parts:
    """Large, thin Gaussians that overlap many neighbours."""
    packed[:, 3] *= 0.08
    packed[:, 4:] *= 12
    return packed, color


def _sparse(packed: Array, color: Array, source: Scene) -> Parts:
    """Stars: tiny Gaussians far apart."""
    packed[:, :3] *= 10
    packed[:, 4:] *= 0.05
    packed[:, 3] = 0.95
    return packed, color


def _with_a_sky(packed: Array, color: Array, source: Scene) -> Parts:
    """Eight large Gaussians far away behind small ones."""
    random = np.random.default_rng(9)
    away = random.normal(size=(8, 3))
    packed[:8, :3] = 25 * away / np.linalg.norm(away, axis=1, keepdims=True)
    packed[:8, 4:] = upper_triangle(np.full((8, 3), 6.0), source.rotation[:8])
    return packed, color


def _georeferenced(packed: Array, color: Array, source: Scene) -> Parts:
    """A city some kilometres from the origin whose Gaussians are metres large."""
    packed[:, :3] = 100 * packed[:, :3] + [4000, -50, 2500]
    packed[:, 4:] *= 1e4
    return packed, color


def _small(packed: Array, color: Array, source: Scene) -> Parts:
    """A ring of a few millimetres in metres."""
    packed[:, :3] *= 0.004
    packed[:, 4:] *= 0.004**2
    return packed, color


def _opaque(packed: Array, color: Array, source: Scene) -> Parts:
    """A mesh that was turned into discs: every opacity is 1."""
    packed[:, 3] = 1
    return packed, color


def _mirrored(packed: Array, color: Array, source: Scene) -> Parts:
    """A scene mirrored as a whole, positions and covariances."""
    packed[:, 0] *= -1
    packed[:, [5, 6]] *= -1
    return packed, color


def _saturated(packed: Array, color: Array, source: Scene) -> Parts:
    """Toys of pure colours: many channels are clipped at black."""
    primary = np.eye(3)[np.arange(len(packed)) % 3]
    color[:, :3] = (primary - 0.5) / C0 * 1.05
    return packed, color


UNUSUAL: list[tuple[str, str, Callable[[Array, Array, Scene], Parts], int]] = [
    ("voxel_grid", "cloud", _voxels, 0),
    ("upright_room", "room", _boxes, 1),
    ("white_object", "surface", _bright, 0),
    ("night", "room", _dark, 0),
    ("grey_day", "room", _foggy, 0),
    ("clay_statue", "avatar", _one_color, 0),
    ("matte_surface", "surface", _matte, 3),
    ("shiny_surface", "surface", _shiny, 3),
    ("veil", "surface", _translucent, 1),
    ("smoke", "cloud", _smoke, 0),
    ("stars", "cloud", _sparse, 0),
    ("sky_behind_an_object", "surface", _with_a_sky, 2),
    ("city", "room", _georeferenced, 1),
    ("jewel", "surface", _small, 2),
    ("discs_of_a_mesh", "surface", _opaque, 0),
    ("mirrored_hair", "hair", _mirrored, 1),
    ("toys", "surface", _saturated, 0),
]
for name, kind, change, degree in UNUSUAL:
    right_model(
        f"unusual_{name}",
        TOOL,
        kind,
        "synthetic" if kind == "cloud" else "trained",
        build=partial(_unusual, kind, change, degree),
    )


def _one_row() -> Draft:
    return static(scene("surface", n=1), degree=0)


right_model("unusual_single_row", TOOL, "surface", "synthetic", build=_one_row)
