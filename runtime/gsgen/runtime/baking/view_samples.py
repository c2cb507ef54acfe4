"""Samples a frame of an ONNX generator at several cameras, and averages the Gaussians."""

__all__ = ["ViewSamples", "cameras_around", "sample_views"]

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Float32, Int64

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.spec.layout import DecodedGaussians, decode
from gsgen.contract.spec.spherical_harmonics import basis
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.sources.source import GeneratorSource

_IMAGE_SIZE: Final = 256  # pixels: cameras are square, so that no direction is preferred
_FOV_DEGREES: Final = 50.0
_MAX_UNION_RATIO: Final = 8  # rows of a union this many times larger than a frame do not match


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewSamples:
    """The union of the Gaussians of several cameras, with colours and opacities per camera.

    Attributes:
        union: Means over the cameras: of opacities, and of positions and covariances weighted by
            opacity. Colours are those of the first camera that has the row.
        eye_positions: Camera centres, [V, 3].
        colors: Colours by camera, [V, N, 3]; None if they are the same for all.
        opacity: Opacity by camera, [V, N]; 0 where a camera has no such row.
        rows_change: Whether positions, opacities or covariances change with the camera.
    """

    union: DecodedGaussians
    eye_positions: Float32[np.ndarray, "v 3"]
    colors: Float32[np.ndarray, "v n 3"] | None
    opacity: Float32[np.ndarray, "v n"]
    rows_change: bool


@dataclass(slots=True, eq=False)
class _View:
    """The Gaussians, without padding rows, that an ONNX generator computes for one camera."""

    gaussians: DecodedGaussians
    versions: tuple[int, int, int]  # of rows, appearance, and the live count
    eye: np.ndarray


def cameras_around(source: GeneratorSource, count: int, *, offset: float = 0.5) -> list[Camera]:
    """Return cameras evenly spread on a sphere, from which all Gaussians of a model are in view.

    They are on a Fibonacci lattice, which ``offset`` shifts to other directions.
    """
    center, scene_radius = source.extent()
    radius = scene_radius / np.sin(np.radians(_FOV_DEGREES) / 2)
    number = np.arange(count)
    height = 1 - 2 * (number + 0.5) / count
    azimuth = np.pi * (3 - np.sqrt(5)) * (number + offset)
    level = np.sqrt(1 - height * height)
    lattice = np.stack([level * np.cos(azimuth), height, level * np.sin(azimuth)], axis=1)
    return [
        Camera.look_at(
            (center + radius * direction).tolist(),
            center.tolist(),
            up=source.up,
            width=_IMAGE_SIZE,
            height=_IMAGE_SIZE,
            fov_y=_FOV_DEGREES,
            near=min(0.01, radius / 100),
        )
        for direction in lattice
    ]


def sample_views(
    source: GeneratorSource,
    cameras: Sequence[Camera],
    values: Mapping[str, object],
    number: int,
    step: Callable[[int], None] = lambda view: None,
) -> ViewSamples:
    """Run an ONNX generator once per camera, and match the output rows of all cameras.

    Rows are matched by index, or by the bits of their positions if the live count changes with the
    camera. ``step`` is called before each run with the number of the camera.
    """
    views: list[_View] = []
    for index, camera in enumerate(cameras):
        step(index)
        source.update(camera, values, number)
        data = source.data
        versions = data.rows_version, data.appearance_version, data.count
        if views and views[-1].versions == versions:
            gaussians = views[-1].gaussians
        else:
            gaussians = decode(data.rows[: data.count], data.appearance[: data.count], data.space)
        views.append(_View(gaussians, versions, np.asarray(camera.eye, np.float32)))
    first_array = views[0].versions
    counts_change = any(view.versions[2] != first_array[2] for view in views)
    rows_change = counts_change or any(view.versions[0] != first_array[0] for view in views)
    colors_change = counts_change or any(view.versions[1] != first_array[1] for view in views)
    ids = (
        _match_rows_by_position(views, source.name)
        if counts_change
        else [np.arange(len(view.gaussians)) for view in views]
    )
    opacity = _scatter_rows(ids, [view.gaussians.opacity for view in views])
    colors = None
    if colors_change:
        colors = _scatter_rows(ids, [_colors(view) for view in views])
    union = _mean_gaussians(views, ids, opacity) if rows_change else views[0].gaussians
    eye_positions = np.stack([view.eye for view in views])
    return ViewSamples(
        union=union,
        eye_positions=eye_positions,
        colors=colors,
        opacity=opacity,
        rows_change=rows_change,
    )


def _colors(view: _View) -> np.ndarray:
    """Return the colours of Gaussians that a camera sees, by SH in the viewing directions."""
    gaussians = view.gaussians
    if gaussians.rgb is not None:
        return np.asarray(gaussians.rgb, np.float32)
    assert gaussians.sh is not None
    rays = gaussians.position.astype(np.float64) - view.eye
    length = np.linalg.norm(rays, axis=1, keepdims=True)
    harmonics = basis(rays / np.where(length > 0, length, 1), gaussians.degree or 0)
    color = 0.5 + np.einsum("nk,nkc->nc", harmonics, gaussians.sh)
    return np.asarray(np.maximum(color, 0), np.float32)


def _scatter_rows(ids: Sequence[np.ndarray], arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Scatter each camera's array into the rows of all cameras' Gaussians; missing rows are 0."""
    size = max(int(rows.max(initial=-1)) for rows in ids) + 1
    result = np.zeros((len(arrays), size, *arrays[0].shape[1:]), np.float32)
    for view, (rows, array) in enumerate(zip(ids, arrays, strict=True)):
        result[view, rows] = array
    return result


def _mean_gaussians(
    views: Sequence[_View], ids: Sequence[np.ndarray], opacity: np.ndarray
) -> DecodedGaussians:
    """Return Gaussians averaged over the cameras, weighted by the opacity for each camera."""
    size = opacity.shape[1]
    weight, sums = np.zeros(size), np.zeros((size, 9))
    appearance = views[0].gaussians.rgb if views[0].gaussians.sh is None else views[0].gaussians.sh
    assert appearance is not None
    first_array = np.zeros((size, *appearance.shape[1:]), np.float32)
    is_row_set = np.zeros(size, bool)
    for view, rows in zip(views, ids, strict=True):
        gaussians = view.gaussians
        weights = np.maximum(gaussians.opacity, 1e-6).astype(
            np.float64
        )  # invisible rows count, too
        weight[rows] += weights
        sums[rows, :3] += weights[:, None] * gaussians.position
        sums[rows, 3:] += weights[:, None] * gaussians.covariance
        colors = gaussians.rgb if gaussians.sh is None else gaussians.sh
        assert colors is not None
        is_new_row = ~is_row_set[rows]
        first_array[rows[is_new_row]] = colors[is_new_row]
        is_row_set[rows] = True
    mean = (sums / weight[:, None]).astype(np.float32)
    uses_sh = views[0].gaussians.sh is not None
    return DecodedGaussians(
        position=mean[:, :3],
        opacity=opacity.mean(axis=0, dtype=np.float64).astype(np.float32),
        covariance=mean[:, 3:],
        sh=first_array if uses_sh else None,
        rgb=None if uses_sh else first_array,
    )


def _match_rows_by_position(views: Sequence[_View], model: str) -> list[Int64[np.ndarray, " n"]]:
    """Match Gaussians of several cameras by position; return the row of each in the union."""
    ids: list[np.ndarray] = []
    known_keys = np.empty(0, np.dtype((np.void, 16)))
    largest_count = max((len(view.gaussians) for view in views), default=0)
    for view in views:
        keys = np.concatenate([known_keys, _keys(view.gaussians.position)])
        _, index, inverse = np.unique(keys, return_index=True, return_inverse=True)
        order = np.sort(index)
        rank = np.searchsorted(order, index)
        ids.append(rank[inverse.reshape(-1)[len(known_keys) :]])
        known_keys = keys[order]
        if len(known_keys) > _MAX_UNION_RATIO * max(largest_count, 1):
            raise ConfigInvalid(
                f"the model outputs {len(known_keys):,} different positions over {len(ids)} cameras, but "
                f"at most {largest_count:,} rows per camera, so rows of different cameras cannot be matched",
                where=model,
                hint="Give --camera: the rows that this camera sees are baked.",
            )
    return ids


def _keys(positions: Float32[np.ndarray, "n 3"]) -> np.ndarray:
    """Return a 16-byte key of each Gaussian: position, and number of earlier equal positions."""
    bits = np.ascontiguousarray(positions, np.float32).view(np.uint32)
    _, inverse = np.unique(bits, axis=0, return_inverse=True)
    order = np.argsort(inverse.reshape(-1), kind="stable")
    ordered_keys = inverse.reshape(-1)[order]
    is_run_start = np.diff(ordered_keys, prepend=-1) != 0
    start_indices = np.maximum.accumulate(np.where(is_run_start, np.arange(len(order)), 0))
    occurrence_numbers = np.empty(len(order), np.uint32)
    occurrence_numbers[order] = np.arange(len(order)) - start_indices
    row_keys = np.concatenate([bits, occurrence_numbers[:, None]], axis=1)
    return np.ascontiguousarray(row_keys).view(np.dtype((np.void, 16))).reshape(-1)
