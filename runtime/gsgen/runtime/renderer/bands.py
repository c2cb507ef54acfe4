"""Divides an image too large for one GPU buffer binding into bands of rows, drawn one by one."""

__all__ = [
    "Band",
    "BandImages",
    "CountsAndImages",
    "DrawnImage",
    "PairsExceeded",
    "band_rows",
    "draw_bands",
    "side_by_side",
]

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from gsgen.runtime.errors import CapacityExceeded
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.kernel import VEC4
from gsgen.runtime.kernels.shared.shader import LARGE_TILE
from gsgen.runtime.scene.camera import Camera

_ROW_ALIGNMENT: Final = 256  # bytes; rows of an image of quads are padded to it
_COUNTER_BYTES: Final = 1024  # bytes of a frame's counters in the buffer that is read back

CountsAndImages = tuple[np.ndarray, dict[str, np.ndarray]]
"""The counters of a frame, and its images as [rows, width, 4] words."""


class PairsExceeded(CapacityExceeded):
    """Raised if the splat-tile pairs of an image, or of a band of it, exceed a GPU binding."""

    @classmethod
    def of(cls, pairs: int, max_pairs: int, device: Device) -> "PairsExceeded":
        """Return the error of an image that needs more pairs than a device holds."""
        return cls(
            f"the image needs {pairs:,} pairs of a splat and a tile; "
            f"{device.name} holds at most {max_pairs:,}",
            where="scene",
            hint="Draw a smaller image, or step back from the largest Gaussians.",
        )


@final
@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """A band of an image: consecutive rows, which are drawn together.

    Attributes:
        full_camera: Camera of the whole image.
        first: Index of the first row.
        rows: Number of rows.
    """

    full_camera: Camera
    first: int
    rows: int

    @classmethod
    def of(cls, camera: Camera) -> "Band":
        """Return a single band that covers the whole image of a camera."""
        return cls(camera, 0, camera.height)

    @property
    def camera(self) -> Camera:
        """The camera that sees just this band of rows of the whole image."""
        if self.rows == self.full_camera.height:
            return self.full_camera
        return replace(self.full_camera, cy=self.full_camera.cy - self.first, height=self.rows)


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DrawnImage:
    """A rendered image that stays in GPU memory, to be shown from there.

    Attributes:
        image: Buffer of four 32-bit words per pixel, as the kernels blend them.
        row: Pixels from the start of one row to the next.
        visible: Number of drawn Gaussians.
        pairs: Number of pairs of a tile and a splat that touches it.
        first: First row, if the image is a band of a larger one.
    """

    image: Buffer
    row: int
    visible: int
    pairs: int
    first: int = 0

    @classmethod
    def of(cls, image: Buffer, band: Band, counts: np.ndarray) -> "DrawnImage":
        """Return the image of a band, with the GPU counters of its frame."""
        return cls(
            image=image,
            row=image.size // band.rows // VEC4,
            visible=int(counts[Counts.VISIBLE]),
            pairs=int(counts[Counts.PAIRS]),
            first=band.first,
        )


def side_by_side(left: CountsAndImages, right: CountsAndImages) -> CountsAndImages:
    """Return the larger of the counts of two eyes, and their images side by side."""
    images = {name: np.concatenate([image, right[1][name]], 1) for name, image in left[1].items()}
    return np.maximum(left[0], right[0]), images


@final
class BandImages:
    """GPU buffers that hold the bands of an image while its next bands are drawn.

    Args:
        device: Device of the buffers.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._images: list[Buffer] = []

    def copy(self, number: int, image: Buffer) -> Buffer:
        """Copy the image of band ``number`` (from 0) to that band's own buffer, and return it."""
        if number == len(self._images) or self._images[number].size != image.size:
            self._images[number:] = [self._device.storage("band of the image", image.size)]
        encoder = self._device.raw.create_command_encoder(label="band")
        encoder.copy_buffer_to_buffer(image, 0, self._images[number], 0, image.size)
        self._device.submit(encoder)
        return self._images[number]

    def clear(self) -> None:
        """Free the GPU buffers of all copied bands of the image."""
        self._images.clear()


def band_rows(device: Device, camera: Camera, images: int, layers: int) -> int:
    """Return the most image rows that fit the GPU's buffers: all, or whole rows of tiles.

    Args:
        device: The device.
        camera: Camera of the whole image.
        images: Number of images that are read back together.
        layers: Number of image layers in one buffer.
    """
    row = -(-VEC4 * camera.width // _ROW_ALIGNMENT) * _ROW_ALIGNMENT
    most = min(
        device.largest_binding // (row * max(1, layers)),
        (device.largest_buffer - _COUNTER_BYTES) // (row * images),
    )
    return camera.height if most >= camera.height else _round_to_tiles(most)


def _round_to_tiles(rows: int) -> int:
    """Round a number of image rows down to whole image tiles of the largest size, at least one."""
    return max(rows // LARGE_TILE, 1) * LARGE_TILE


def draw_bands(
    camera: Camera,
    rows: int,
    draw: Callable[[Band], CountsAndImages],
    count: Callable[[], int | None],
) -> CountsAndImages:
    """Draw an image in bands of rows; return the summed GPU counters, and the whole images.

    A band with more pairs of a splat and a tile than a binding holds is halved.

    Args:
        camera: Camera of the whole image.
        rows: Most rows of a band.
        draw: Draws one band.
        count: Counts the splats of the whole image; where it returns None, a splat counts in each
            band that it touches.

    Raises:
        CapacityExceeded: One row of tiles needs more than the device's buffers hold.
    """
    first, total = 0, np.zeros(0, np.uint32)
    images: dict[str, np.ndarray] = {}
    while first < camera.height:
        band = Band(camera, first, min(rows, camera.height - first))
        try:
            counts, parts = draw(band)
        except PairsExceeded:
            if band.rows <= LARGE_TILE:
                raise
            rows = _round_to_tiles(band.rows // 2)
            continue
        if band.rows == camera.height:
            return counts, parts
        for name, part in parts.items():
            if name not in images:
                images[name] = np.empty((camera.height, *part.shape[1:]), np.uint32)
            images[name][first : first + band.rows] = part
        if first > 0:
            counts[[Counts.VISIBLE, Counts.PAIRS]] += total[[Counts.VISIBLE, Counts.PAIRS]]
        first, total = first + band.rows, counts
    visible = count()
    if visible is not None:
        total[Counts.VISIBLE] = visible
    return total, images
