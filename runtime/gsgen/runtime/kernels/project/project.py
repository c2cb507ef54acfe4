"""Project: turn Gaussians into splats, and say how far away each is."""

__all__ = [
    "FRAME",
    "NO_HARMONICS",
    "PAGE",
    "ProjectKernel",
    "depth_reference",
    "frame_uniform",
    "page_uniform",
    "page_uniforms",
]

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from jaxtyping import Bool, Float, Shaped, UInt32

from gsgen.contract.spec import layout
from gsgen.contract.spec.geometry import symmetric
from gsgen.contract.spec.spherical_harmonics import basis
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared.kernel import Kernel, Step
from gsgen.runtime.kernels.shared.shader import (
    DILATION,
    JACOBIAN_MARGIN,
    PANORAMA_CONSTANTS,
    POLE,
    TILE,
)
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import SplatSet
from gsgen.runtime.scene.splat_data import SplatData

NO_HARMONICS: Final = 0xFF
"""The degree of raw colours."""

_THREADS = 64


def _bytes(size: int, fields: dict[str, tuple[str, int]]) -> np.dtype[np.void]:
    """Return the dtype of a WGSL struct: for each field its format and its offset."""
    formats, offsets = zip(*fields.values(), strict=True)
    return np.dtype(
        {
            "names": list(fields),
            "formats": list(formats),
            "offsets": list(offsets),
            "itemsize": size,
        }
    )


FRAME: Final = _bytes(
    80,
    {
        "focal": ("2f4", 0),
        "center": ("2f4", 8),
        "slope_low": ("2f4", 16),
        "slope_high": ("2f4", 24),
        "origin": ("2f4", 32),
        "near": ("f4", 40),
        "period": ("f4", 44),
        "size": ("2u4", 48),
        "tiles": ("2u4", 56),
        "background": ("4f4", 64),
    },
)
"""The bytes of ``struct Frame`` in frame.wgsl."""

PAGE: Final = _bytes(
    512,  # two steps that every device can bind at
    {
        "linear": ("(3,4)f4", 0),
        "local_to_sh": ("(3,4)f4", 48),
        "eye": ("3f4", 96),
        "opacity_scale": ("f4", 108),
        "eye_rest": ("3f4", 112),
        "base": ("u4", 124),
        "clip_low": ("3f4", 128),
        "count": ("u4", 140),
        "clip_high": ("3f4", 144),
        "degree": ("u4", 156),
        "mip": ("u4", 160),
        "capacity": ("u4", 164),
        "forward": ("3f4", 176),
        "per_cell": ("u4", 188),
        "first_row": ("u4", 192),
        "first_gaussian": ("u4", 196),
        "inverse_range": ("f4", 200),
        "inverse_divisor": ("f4", 204),
        "behind": ("f4", 208),
        "linear_rest": ("(3,4)f4", 224),
        "eye_at": ("3f4", 272),
        "zero": ("u4", 284),
        "eye_at_rest": ("3f4", 288),
    },
)
"""The bytes of ``struct Page`` in page.wgsl."""


def tiles_of(camera: Camera) -> tuple[int, int]:
    """Return how many tiles an image has across and down."""
    return -(-camera.width // TILE), -(-camera.height // TILE)


def frame_uniform(
    camera: Camera, background: Float[np.ndarray, "3"]
) -> Shaped[np.ndarray, ""]:
    """Return what all Gaussians of a frame share.

    Args:
        camera: Whose image it is.
        background: Red, green, blue behind it all, multiplied by their alpha.
    """
    made = np.zeros((), FRAME)
    focal = np.array([camera.fx, camera.fy])
    center = np.array([camera.cx, camera.cy])
    size = np.array([camera.width, camera.height])
    margin = JACOBIAN_MARGIN * size / 2
    origin = np.clip(np.floor(center), 0, size)
    made["focal"], made["center"], made["origin"] = focal, center - origin, origin
    made["slope_low"] = -(center + margin) / focal
    made["slope_high"] = (size - center + margin) / focal
    made["near"], made["size"], made["tiles"] = camera.near, size, tiles_of(camera)
    made["period"] = camera.period
    made["background"][:3] = background
    return made


def page_uniform(
    placed: SplatSet, camera: Camera, base: int, capacity: int, count: int
) -> Shaped[np.ndarray, ""]:
    """Return what all Gaussians of a page share; see :func:`page_uniforms`.

    Args:
        placed: The set that the page is of.
        camera: Who looks at it.
        base: Index of the page's first Gaussian in the frame.
        capacity: Gaussians of the page.
        count: How many of them are live.
    """
    return np.asarray(page_uniforms([(placed, base, capacity, count)], camera)[0])


def page_uniforms(
    pages: Sequence[tuple[SplatSet, int, int, int]], camera: Camera
) -> Shaped[np.ndarray, " n"]:
    """Return what all Gaussians of each page share, worked out in float64.

    All at once, because numpy takes as long for one matrix as for thirty.

    Args:
        pages: The set of each page, the index of the page's first Gaussian in the frame, how many
            Gaussians it has, and how many of them are live.
        camera: Who looks at them.
    """
    made = np.zeros(len(pages), PAGE)
    if not pages:
        return made
    sets, made["base"], made["capacity"], made["count"] = zip(*pages, strict=True)
    places = np.stack([one.transform for one in sets])
    linear, offset = places[:, :3, :3], places[:, :3, 3]
    turned = camera.view[:3, :3] @ linear
    made["linear"][:, :, :3] = turned.transpose(0, 2, 1)  # WGSL matrices are columns
    # The polar decomposition A = Q S: directions of the harmonics are Qᵀ(A d) = S d.
    _, stretch, axes = np.linalg.svd(linear)
    share = (stretch / stretch[:, :1])[:, :, None]
    made["local_to_sh"][:, :, :3] = axes.transpose(0, 2, 1) @ (share * axes)
    eye = np.linalg.solve(linear, (camera.eye - offset)[:, :, None])[:, :, 0]
    if camera.kind == "orthographic":
        made["forward"] = np.linalg.solve(linear, camera.view[2, :3][:, None])[:, :, 0]
    made["eye"] = eye
    eye_rest = eye - made["eye"].astype(np.float64)
    made["eye_rest"] = eye_rest
    columns = turned.transpose(0, 2, 1)
    made["linear_rest"][:, :, :3] = columns - made["linear"][:, :, :3].astype(np.float64)
    eye_at = -(turned @ eye_rest[:, :, None])[:, :, 0]
    made["eye_at"] = eye_at
    made["eye_at_rest"] = eye_at - made["eye_at"].astype(np.float64)
    clips = [one.clip for one in sets]
    made["clip_low"] = [(-np.inf,) * 3 if one is None else one.low for one in clips]
    made["clip_high"] = [(np.inf,) * 3 if one is None else one.high for one in clips]
    made["opacity_scale"] = [one.opacity_scale for one in sets]
    made["mip"] = [one.antialias == "mip" for one in sets]
    made["degree"] = [_degree(one) for one in sets]
    return made


def _degree(one: SplatSet) -> int:
    degree = one.data.degree
    if degree is None:
        return NO_HARMONICS
    return degree if one.degree is None else min(degree, one.degree)


@final
class ProjectKernel:
    """``project.wgsl`` for an appearance of a given type.

    Args:
        device: Where it runs.
        half: Whether the appearance is float16.
        stride: Of its rows, in words of 16 bytes; 0 where two rows share one.
        panorama: Whether the image is one.
        weighted: Whether its Gaussians are blended by weighted sums.
        packed: Whether rows are, as packing.py says.
    """

    def __init__(
        self,
        device: Device,
        half: bool,
        stride: int,
        panorama: bool = False,
        weighted: bool = False,
        packed: bool = False,
    ) -> None:
        self.kernel = Kernel(
            device,
            "project_weighted" if weighted else "project",
            "project",
            ("uwwww", "urrr") if weighted else ("uwwwww", "urr"),
            THREADS=_THREADS,
            HALF_APPEARANCE=half,
            STRIDE=stride,
            NO_HARMONICS=NO_HARMONICS,
            WEIGHTED=weighted,
            PACKED=packed,
            **(PANORAMA_CONSTANTS if panorama else {}),
        )

    def step(
        self, outputs: tuple[Any, ...], uniform: Any, slot: int, page: Any, *cells: Any
    ) -> Step:
        """Return the step for a page.

        Args:
            outputs: What group 0 of ``project.wgsl`` binds, in its order.
            uniform: Uniforms of all pages.
            slot: Which of them is this page's.
            page: Has ``rows``, ``appearance`` and ``capacity``.
            cells: Where the kernel is for weighted sums, the cells of the page's set.
        """
        own = (uniform, slot * PAGE.itemsize, PAGE.itemsize)
        binds = (
            self.kernel.bind(*outputs),
            self.kernel.bind(own, page.rows, page.appearance, *cells, group=1),
        )
        return Step(self.kernel, binds, (-(-page.capacity // _THREADS), 1, 1))


@final
@dataclass(frozen=True, slots=True, eq=False)
class Projected:
    """Splats in float64.

    Attributes:
        drawn: Which Gaussians are; of the others nothing else holds.
        mean: Pixels, relative to the frame's origin.
        conic: Inverse 2D covariance: xx, xy, yy.
        strength: Logarithm of the opacity over CULL_OPACITY.
        depth: Along the camera's +z; in a panorama from its centre.
        color: Red, green, blue.
    """

    drawn: Bool[np.ndarray, " n"]
    mean: Float[np.ndarray, "n 2"]
    conic: Float[np.ndarray, "n 3"]
    strength: Float[np.ndarray, " n"]
    depth: Float[np.ndarray, " n"]
    color: Float[np.ndarray, "n 3"]


def project_reference(
    data: SplatData, frame: Shaped[np.ndarray, ""], page: Shaped[np.ndarray, ""]
) -> Projected:
    """What ``project.wgsl`` must make of ``data`` and the two uniforms."""
    rows = data.rows.astype(np.float64)
    linear, rest, to_sh = (
        np.asarray(page[name], np.float64)[:, :3].T
        for name in ("linear", "linear_rest", "local_to_sh")
    )
    linear = linear + rest
    offset = rows[:, :3] - np.float64(page["eye"]) - np.float64(page["eye_rest"])
    with np.errstate(all="ignore"):
        at = offset @ linear.T
        flat = bool(np.any(page["forward"]))
        depth, place, jacobian = (
            _unrolled(at, linear) if frame["period"] else _straight(at, linear, flat, frame)
        )
        jacobian = frame["focal"][:, None] * jacobian
        plain = (
            jacobian @ symmetric(rows[:, layout.COVARIANCE]) @ jacobian.transpose(0, 2, 1)
        )
        wide = plain + DILATION * np.eye(2)
        opacity = rows[:, layout.OPACITY] * page["opacity_scale"]
        if data.cells is not None and page["per_cell"]:
            cell = (page["first_row"] + np.arange(len(rows))) // page["per_cell"]
            seen = data.cells[cell, layout.VISIBILITY].astype(np.float64)
            opacity = opacity * seen * (1 - depth * page["inverse_range"])
        opacity = np.minimum(opacity, 1)
        if page["mip"]:
            share = np.linalg.det(plain) / np.linalg.det(wide)
            opacity = opacity * np.sqrt(np.maximum(share, 0))
        color = data.appearance[:, :3].astype(np.float64)
        if page["degree"] != NO_HARMONICS:
            toward = (np.tile(page["forward"], (len(at), 1)) if flat else offset) @ to_sh.T
            weights = basis(
                toward / np.linalg.norm(toward, axis=1, keepdims=True), int(page["degree"])
            )
            sh = data.appearance.reshape(len(rows), -1, 3)[:, : weights.shape[1]]
            color = 0.5 + np.einsum("nk,nkc->nc", weights, sh.astype(np.float64))
        drawn = (depth > frame["near"]) & (opacity >= layout.CULL_OPACITY)
        drawn &= np.isfinite(rows).all(axis=1) & np.isfinite(color).all(axis=1)
        drawn &= (rows[:, :3] >= page["clip_low"]).all(axis=1)
        drawn &= (rows[:, :3] <= page["clip_high"]).all(axis=1)
        drawn &= (np.linalg.det(wide) > 0) & (wide[:, 0, 0] > 0) & (wide[:, 1, 1] > 0)
        drawn &= np.arange(len(rows)) < page["count"]
        strength = np.log(opacity / layout.CULL_OPACITY)
        conic = np.full((len(rows), 3), np.nan)
        conic[drawn] = np.linalg.inv(wide[drawn])[:, [0, 0, 1], [0, 1, 1]]
        mean = frame["focal"] * place + frame["center"]
        if frame["period"]:
            middle = frame["size"][0] / 2 - frame["origin"][0]
            turns = np.round((mean[:, 0] - middle) / frame["period"])
            mean[:, 0] -= turns * frame["period"]
    return Projected(drawn, mean, conic, strength, depth, np.maximum(color, 0))


def depth_reference(
    depth: Float[np.ndarray, " n"],
) -> tuple[UInt32[np.ndarray, " n"], UInt32[np.ndarray, " n"]]:
    """What ``exact_depth.wgsl`` must make of depths: keys, and the bits of what they leave."""
    high = depth.astype(np.float32)
    low = (depth - high.astype(np.float64)).astype(np.float32)
    bits = low.view(np.uint32)
    ordered = np.where(low < 0, ~bits, bits ^ np.uint32(0x80000000))
    return high.view(np.uint32), np.where(low == 0, np.uint32(0x80000000), ordered)


def _straight(
    at: np.ndarray, linear: np.ndarray, flat: bool, frame: Shaped[np.ndarray, ""]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return depths, places in units of the focal length, and how those move."""
    away = np.ones((len(at), 1)) if flat else at[:, 2:]
    slope = at[:, :2] / away
    bent = np.clip(slope, frame["slope_low"], frame["slope_high"]) * (not flat)
    moved = (linear[:2] - bent[:, :, None] * linear[2]) / away[:, :, None]
    return at[:, 2], slope, moved


def _unrolled(
    at: np.ndarray, linear: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return distances, longitudes and latitudes, and how those move."""
    distance, level = np.linalg.norm(at, axis=1), np.hypot(at[:, 0], at[:, 2])
    angles = np.stack([np.arctan2(at[:, 0], at[:, 2]), np.arctan2(at[:, 1], level)], 1)
    sin, cos = np.sin(angles[:, 0]), np.cos(angles[:, 0])
    zero = np.zeros(len(at))
    wide = np.maximum(level / distance, POLE)
    high = at[:, 1] / distance
    across = np.stack([cos / wide, zero, -sin / wide], 1)
    down = np.stack([-sin * high, level / distance, -cos * high], 1)
    return distance, angles, np.stack([across, down], 1) @ linear / distance[:, None, None]
