"""Kernels between drawn images and the tensors of networks, beside their twin."""

import numpy as np
import pytest

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared.kernel import THREADS_PER_WORKGROUP, Step, run
from gsgen.runtime.kernels.shared.shader import TILE
from gsgen.runtime.playback.image_tiling import tile_weights
from references.layers import network_reference
from web_client.browser_kernels import IMAGE_TILE, ImageTensors


def submit(device: Device, step: Step) -> None:
    encoder = device.raw.create_command_encoder()
    run(encoder, [step], "test")
    device.submit(encoder)


def pixel_groups(size: tuple[int, int]) -> tuple[int, int, int]:
    return -(-size[0] // TILE), -(-size[1] // TILE), 1


class Canvas:
    """An image on a device, and the image that a network makes of it, tile by tile."""

    def __init__(
        self, device: Device, image: np.ndarray, region: np.ndarray, *, half: bool
    ) -> None:
        self.device, self.region, self.half = device, region.copy(), half
        self.kernels = ImageTensors(device, half=half)
        self.height, self.width = image.shape[:2]
        count = int(region["channels"] * region["tile"].prod())
        self.shape = (1, int(region["channels"]), int(region["tile"][1]), int(region["tile"][0]))
        self.words = -(-count // (2 if half else 1))
        self.buffers = {
            name: device.storage(name, size)
            for name, size in {
                "image": image.nbytes,
                "result": image.nbytes,
                "input": 4 * self.words,
                "output": 4 * self.words,
                "weights": 4 * int(region["tile"].sum()),
                "faults": 4,
            }.items()
        }
        self.uniform = device.uniform("region", IMAGE_TILE.itemsize)
        device.write(self.buffers["image"], image)

    def seen(self, corner: tuple[int, int]) -> np.ndarray:
        """Return the tensor of the tile at a column and a row."""
        self.region["corner"] = corner
        self.device.write(self.uniform, self.region.reshape(1))
        groups = -(-self.words // THREADS_PER_WORKGROUP)
        rows = 2 if groups > 1 else 1  # as for more than a device dispatches along an axis
        bind = self.kernels.fill.bind(self.uniform, self.buffers["image"], self.buffers["input"])
        submit(self.device, Step(self.kernels.fill, (bind,), (-(-groups // rows), rows, 1)))
        words = self.device.read(self.buffers["input"], np.uint32, self.words)
        numbers = words.view(np.float16 if self.half else np.float32)
        return numbers[: np.prod(self.shape)].reshape(self.shape)

    def add(self, tensor: np.ndarray, weights: np.ndarray) -> None:
        numbers = np.zeros(self.words * (2 if self.half else 1), tensor.dtype)
        numbers[: tensor.size] = tensor.ravel()
        self.device.write(self.buffers["output"], numbers.view(np.uint32))
        self.device.write(self.buffers["weights"], weights.astype(np.float32))
        step = Step(self.kernels.add, (self._bind("add"),), pixel_groups(self.shape[:1:-1]))
        submit(self.device, step)

    def finish(self) -> tuple[np.ndarray, int]:
        """Return the image, and how many numbers were not finite."""
        kernel = self.kernels.finish
        binds = self._bind("finish"), kernel.bind(self.buffers["image"], group=1)
        submit(self.device, Step(kernel, binds, pixel_groups((self.width, self.height))))
        numbers = self.device.read(self.buffers["result"], np.float32, 4 * self.width * self.height)
        (faults,) = self.device.read(self.buffers["faults"], np.uint32, 1)
        return numbers.reshape(self.height, self.width, 4), int(faults)

    def _bind(self, entry: str) -> object:
        names = ("result", "output", "weights", "faults")
        resources = [self.buffers[name] for name in names]
        return getattr(self.kernels, entry).bind(self.uniform, *resources)


def region_of(size: tuple[int, int], tile: tuple[int, int], **fields: float) -> np.ndarray:
    region = np.zeros((), IMAGE_TILE)
    for name, value in {"size": size, "tile": tile, **fields}.items():
        region[name] = value
    return region


@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize(
    ("size", "tile"), [((1, 1), (1, 1)), ((19, 7), (19, 7)), ((33, 20), (12, 9)), ((5, 30), (9, 8))]
)
def test_a_network_sees_the_image_and_changes_it(
    device: Device, size: tuple[int, int], tile: tuple[int, int], channels: int, half: bool
) -> None:
    """Whole, in tiles, and smaller than a tile; linear or not; before a background or not."""
    rng = np.random.default_rng(size[0] + channels)
    image = rng.uniform(-0.1, 1.2, (size[1], size[0], 4)).astype(np.float32)
    image[..., 3] = rng.choice([0, 0.3, 1], image.shape[:2])
    region = region_of(
        size,
        tile,
        channels=channels,
        is_linear=half,
        low=-1.0,
        high=1.0,
        background_alpha=0.25 if channels == 4 else 0,
    )
    overlap = (min(tile) - 1) // 2
    dtype = np.float16 if half else np.float32

    def network(part: np.ndarray) -> np.ndarray:
        return (0.5 * part[:, ::-1] + 0.1).astype(dtype)

    seen, expected = network_reference(region, image, network, dtype, overlap)
    canvas = Canvas(device, image, region, half=half)
    padded = max(size[1], tile[1]), max(size[0], tile[0])
    for corner, weights in tile_weights(padded, tile[::-1], overlap):
        actual = canvas.seen((corner.left, corner.top))
        part = seen[..., corner.top : corner.top + tile[1], corner.left : corner.left + tile[0]]
        height, width = part.shape[2:]
        np.testing.assert_allclose(actual[..., :height, :width], part, atol=2e-3 if half else 2e-5)
        # Beyond the image its last pixels go on.
        assert (actual[..., height:, :] == actual[..., height - 1 : height, :]).all()
        # A weight is a product of one of its row and one of its column.
        columns, rows = weights.sum(0) / weights.sum(), weights.sum(1)
        canvas.add(network(actual), np.concatenate([columns, rows]))
    result, faults = canvas.finish()
    assert faults == 0
    np.testing.assert_allclose(result, expected, atol=2e-3 if half else 2e-5)


@pytest.mark.parametrize("half", [False, True])
def test_numbers_that_are_not_finite_are_counted(device: Device, half: bool) -> None:
    region = region_of((6, 5), (6, 5), channels=3, high=1.0)
    canvas = Canvas(device, np.ones((5, 6, 4), np.float32), region, half=half)
    tensor = (
        np.random.default_rng(1).random((1, 3, 5, 6)).astype(np.float16 if half else np.float32)
    )
    largest = np.finfo(tensor.dtype).max
    tensor.ravel()[[0, 7, 20, 31, 32, 89]] = np.nan, np.inf, -np.inf, largest, -largest, np.nan
    assert (canvas.seen((0, 0)) == 1).all()
    canvas.add(tensor, np.ones(11))
    result, faults = canvas.finish()
    assert faults == 4
    assert np.isfinite(result).all()
