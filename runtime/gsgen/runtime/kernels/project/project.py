"""Projects Gaussians into the image: splats with 2D covariances, colours and depths."""

__all__ = [
    "FRAME",
    "NO_HARMONICS",
    "PAGE",
    "SPLAT_RADIUS_SIGMAS",
    "Eyes",
    "ProjectKernel",
    "frame_uniform",
    "page_uniform",
    "page_uniforms",
]

from collections.abc import Sequence
from typing import Final, Literal, final

import numpy as np
from jaxtyping import Float, Shaped

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.splat_residency import PAGE_SLOTS, Page
from gsgen.runtime.kernels.project.projections import Projection, projection_constants
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.first_digits import FirstDigits
from gsgen.runtime.kernels.shared.kernel import THREADS_PER_WORKGROUP, Kernel, Step
from gsgen.runtime.kernels.shared.shader import JACOBIAN_MARGIN, TILE
from gsgen.runtime.scene.camera import DEFAULT_DILATION, Camera
from gsgen.runtime.scene.scene import SplatSet

SPLAT_RADIUS_SIGMAS: Final = 3.0
"""Radius of a splat in a weighted sum, in standard deviations (Liu et al. 2025, their code)."""

Eyes = Literal[1, 2]
"""Whether splats are those of one camera, or of a left and a right eye that look the same way."""

NO_HARMONICS: Final = 0xFF
"""The SH degree that stands for RGB colours in the uniforms of pages (GPU buffers)."""


def _uniform_dtype(size: int, fields: dict[str, tuple[str, int]]) -> np.dtype[np.void]:
    """Return the NumPy dtype of a WGSL struct, from format and offset of each field."""
    formats, offsets = zip(*fields.values(), strict=True)
    return np.dtype(
        {
            "names": list(fields),
            "formats": list(formats),
            "offsets": list(offsets),
            "itemsize": size,
        }
    )


FRAME: Final = _uniform_dtype(
    144,
    {
        "focal": ("2f4", 0),
        "center": ("2f4", 8),
        "slope_low": ("2f4", 16),
        "slope_high": ("2f4", 24),
        "origin": ("2f4", 32),
        "near": ("f4", 40),
        "period": ("f4", 44),
        "size": ("2u4", 48),
        "resumes": ("u4", 56),
        "continues": ("u4", 60),
        "background": ("4f4", 64),
        "extra_dilation": ("f4", 80),
        "rank": ("u4", 84),
        "tied_key": ("u4", 88),
        "tied_low": ("u4", 92),
        "radial": ("4f4", 96),
        "divisor": ("3f4", 112),
        "ray_limit": ("f4", 124),
        "tangential": ("2f4", 128),
        "prism": ("2f4", 136),
    },
)
"""The bytes of ``struct Frame`` in frame.wgsl."""

PAGE: Final = _uniform_dtype(
    512,  # a multiple of 256, at which every device can bind
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
        "per_slot": ("u4", 212),
        "first_cell": ("u4", 216),
        "live_cells": ("u4", 220),
        "linear_rest": ("(3,4)f4", 224),
        "eye_at": ("3f4", 272),
        "zero": ("u4", 284),
        "eye_at_rest": ("3f4", 288),
        "eye_distance": ("f4", 300),
        "to_right_eye": ("3f4", 304),
    },
)
"""The bytes of ``struct Page`` in page.wgsl."""


def frame_uniform(
    camera: Camera,
    background: Float[np.ndarray, "3"],
    *,
    first_row: int = 0,
    rows: int | None = None,
) -> Shaped[np.ndarray, ""]:
    """Return the uniform data (WGSL struct ``Frame``) of a camera, or of some rows of its image.

    Splats have the same numbers in both, since rows count from the origin of the whole image.

    Args:
        camera: Camera of the whole image.
        background: Red, green, blue, multiplied by alpha.
        first_row: First row to draw.
        rows: Number of rows; all if None.
    """
    uniform = np.zeros((), FRAME)
    focal = np.array([camera.fx, camera.fy])
    center = np.array([camera.cx, camera.cy])
    size = np.array([camera.width, camera.height])
    frame_margin = JACOBIAN_MARGIN * size / 2
    origin = np.clip(np.floor(center), 0, size)
    uniform["focal"], uniform["center"], uniform["origin"] = focal, center - origin, origin
    uniform["slope_low"] = -(center + frame_margin) / focal
    uniform["slope_high"] = (size - center + frame_margin) / focal
    if camera.kind == "fisheye" or camera.distortion is not None:
        low, high = camera.plane_bounds()
        margin = JACOBIAN_MARGIN * (high - low) / 2
        uniform["slope_low"] = np.minimum(low - margin, 0)  # the axis is always within
        uniform["slope_high"] = np.maximum(high + margin, 0)
        uniform["ray_limit"] = camera.ray_limit
    if camera.distortion is not None:
        for name, values in camera.distortion.to_dict().items():
            uniform[name] = values
    uniform["near"], uniform["size"] = camera.near, size
    uniform["period"] = camera.period
    uniform["origin"][1] -= first_row
    uniform["size"][1] = camera.height if rows is None else rows
    uniform["extra_dilation"] = camera.dilation - DEFAULT_DILATION
    uniform["background"][:3] = background
    return uniform


def page_uniform(
    placed: SplatSet, camera: Camera, first_index: int, capacity: int, count: int
) -> Shaped[np.ndarray, ""]:
    """Return the uniform data of one GPU page of Gaussians (WGSL struct ``Page``), from float64."""
    return np.asarray(page_uniforms([(placed, first_index, capacity, count)], camera)[0])


def page_uniforms(
    pages: Sequence[tuple[SplatSet, int, int, int]], camera: Camera, right: Camera | None = None
) -> Shaped[np.ndarray, " n"]:
    """Return the uniform data of GPU pages of Gaussians (WGSL struct ``Page``), from float64.

    They are computed together, because numpy takes as long for one matrix as for thirty.

    Args:
        pages: For each page its set, the index of its first Gaussian in the frame, its capacity
            and its number of live Gaussians.
        camera: Camera of the frame.
        right: Camera of the right eye, if ``camera`` is that of the left one.
    """
    uniforms = np.zeros(len(pages), PAGE)
    if not pages:
        return uniforms
    sets, uniforms["base"], uniforms["capacity"], uniforms["count"] = zip(*pages, strict=True)
    transforms = np.stack([splat_set.rows_to_world for splat_set in sets])
    linear, offset = transforms[:, :3, :3], transforms[:, :3, 3]
    camera_from_model = camera.view[:3, :3] @ linear
    uniforms["linear"][:, :, :3] = camera_from_model.transpose(0, 2, 1)  # WGSL matrices are columns
    # The polar decomposition A = Q S: directions of the harmonics are Qᵀ(A d) = S d.
    _, scales, axes = np.linalg.svd(linear)
    scale_ratios = (scales / scales[:, :1])[:, :, None]
    uniforms["local_to_sh"][:, :, :3] = axes.transpose(0, 2, 1) @ (scale_ratios * axes)
    eye = np.linalg.solve(linear, (camera.eye - offset)[:, :, None])[:, :, 0]
    if camera.kind == "orthographic":
        uniforms["forward"] = np.linalg.solve(linear, camera.view[2, :3][:, None])[:, :, 0]
    uniforms["eye"] = eye
    eye_remainder = eye - uniforms["eye"].astype(np.float64)
    uniforms["eye_rest"] = eye_remainder
    columns = camera_from_model.transpose(0, 2, 1)
    uniforms["linear_rest"][:, :, :3] = columns - uniforms["linear"][:, :, :3].astype(np.float64)
    eye_in_camera = -(camera_from_model @ eye_remainder[:, :, None])[:, :, 0]
    uniforms["eye_at"] = eye_in_camera
    uniforms["eye_at_rest"] = eye_in_camera - uniforms["eye_at"].astype(np.float64)
    if right is not None:
        to_right = np.linalg.solve(linear, (right.eye - camera.eye)[:, None])[:, :, 0]
        uniforms["to_right_eye"] = to_right
        uniforms["eye_distance"] = camera.view[0, :3] @ (right.eye - camera.eye)
    clip_boxes = [splat_set.rows_clip for splat_set in sets]
    uniforms["clip_low"] = [(-np.inf,) * 3 if clip is None else clip.low for clip in clip_boxes]
    uniforms["clip_high"] = [(np.inf,) * 3 if clip is None else clip.high for clip in clip_boxes]
    uniforms["opacity_scale"] = [splat_set.opacity_scale for splat_set in sets]
    uniforms["mip"] = [splat_set.antialias == "mip" for splat_set in sets]
    uniforms["degree"] = [_sh_degree(splat_set) for splat_set in sets]
    return uniforms


def _sh_degree(splat_set: SplatSet) -> int:
    degree = splat_set.data.degree
    if degree is None:
        return NO_HARMONICS
    return degree if splat_set.degree is None else min(degree, splat_set.degree)


@final
class ProjectKernel:
    """The projection kernel: ``project.wgsl``, ``project_pooled.wgsl``, ``project_weighted.wgsl``.

    Args:
        device: Device of the kernel.
        appearance_stride: Length of an appearance row, in vectors of 16 bytes; 0 if two rows share one.
        is_half: Whether the appearance is float16.
        projection: Where Gaussians are projected to.
        weighted: Whether Gaussians are blended by weighted sums.
        packed: Whether rows are packed by compact_rows.py.
        slot_rows: Rows of a slot, for pages of a pool; 0 for others.
        tile: Edge of the tiles that are counted, in pixels.
        records: Whether each splat is one record.
        slab: "keys" computes nothing but the keys of a page; "splats" projects Gaussians that are
            in a slab, to the indices of ``place_splats.wgsl``. With ``weighted``, the frame's counts
            then take the place of keys.
        windows: Whether tiles are told by a word of ``tile_window.wgsl`` instead of their number,
            in whose place colours are followed by variances.
        digits: How the first digits of the keys are counted, into one more output; None if they are
            not. Only for sets that are neither weighted nor drawn in slabs.
    """

    def __init__(
        self,
        device: Device,
        appearance_stride: int,
        *,
        is_half: bool,
        projection: Projection = "plane",
        weighted: bool = False,
        packed: bool = False,
        slot_rows: int = 0,
        tile: int = TILE,
        records: bool = False,
        slab: Literal["keys", "splats"] | None = None,
        windows: bool = False,
        digits: FirstDigits | None = None,
        eyes: Eyes = 1,
    ) -> None:
        name = "project_weighted" if weighted else "project_pooled" if slot_rows else "project"
        if slab == "splats":
            name = "project_placed_pooled" if slot_rows else "project_placed"
            name = "project_weighted_placed" if weighted else name
        page_bindings = "urruu" if slot_rows else "urr"
        if slab == "splats":
            page_bindings = "urrur" if slot_rows else "urrr"
        outputs = "uwwwww" if digits is None else "uwwwwww"
        self.kernel = Kernel(
            device,
            name if digits is None else f"{name}_counted",
            "project_pooled" if name == "project_pooled" else "project",
            ("uwwww", "urrr" + "r" * (slab == "splats")) if weighted else (outputs, page_bindings),
            THREADS=THREADS_PER_WORKGROUP,
            TILE=tile,
            RECORDS=records,
            KEYS_ONLY=slab == "keys",
            SLOT_ROWS=slot_rows,
            PAGE_SLOTS=PAGE_SLOTS,
            HALF_APPEARANCE=is_half,
            STRIDE=appearance_stride,
            NO_HARMONICS=NO_HARMONICS,
            WEIGHTED=weighted,
            PACKED=packed,
            SPLAT_REACH=SPLAT_RADIUS_SIGMAS,
            WINDOWS=windows,
            EYES=eyes,
            **projection_constants(projection),
            **({"DRAWN": int(Counts.DRAWN)} if weighted else {}),
            **(digits.constants if digits else {}),
        )

    def step(
        self,
        outputs: tuple[Buffer, ...],
        uniform: Buffer,
        slot: int,
        page: Page,
        *extra_inputs: Buffer,
    ) -> Step:
        """Return the dispatch that projects the Gaussians of a page (GPU buffers).

        Args:
            outputs: Resources of bind group 0 of the shader, in order.
            uniform: Buffer with the uniforms of all pages.
            slot: Index of this page's uniform.
            page: The page.
            extra_inputs: Buffer of the set's cells, for weighted sums, and of the rows' places in a slab.
        """
        page_binding = (uniform, slot * PAGE.itemsize, PAGE.itemsize)
        slots = page.slots
        # Splats of a slab are not drawn by the list of seen slots: others are the rows' places.
        extra_buffers = extra_inputs
        if slots is not None:
            extra_buffers = (slots.table, *(extra_inputs or (slots.seen,)))
        bind_groups = (
            self.kernel.bind(*outputs),
            self.kernel.bind(page_binding, page.rows, page.appearance, *extra_buffers, group=1),
        )
        if slots is not None and not extra_inputs:
            return Step(self.kernel, bind_groups, (slots.dispatch, 0))
        return Step(self.kernel, bind_groups, (-(-page.capacity // THREADS_PER_WORKGROUP), 1, 1))
