"""Kernels that bring a generator's outputs into the layout of pages, beside their twins."""

import numpy as np
import pytest

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.splat_residency import PAGE_ROWS
from gsgen.runtime.kernels.shared.kernel import Step, run
from references.projection import live_counts_reference, repack_reference
from web_client.browser_kernels import LiveCounts, RepackRows


def submit(device: Device, step: Step) -> None:
    encoder = device.raw.create_command_encoder()
    run(encoder, [step], "test")
    device.submit(encoder)


@pytest.mark.parametrize("rows", [1, 2, 63, 64, 65, 301])
@pytest.mark.parametrize(
    ("columns", "words", "half_source", "half_target"),
    [(10, 10, True, False), (3, 4, False, False), (27, 28, False, False), (3, 2, True, True),
     (12, 8, True, True), (27, 16, True, True)],
)  # fmt: skip
def test_rows_are_repacked(
    device: Device, columns: int, words: int, half_source: bool, half_target: bool, rows: int
) -> None:
    rng = np.random.default_rng(rows * columns)
    numbers = rng.normal(size=(rows, columns)).astype(np.float16 if half_source else np.float32)
    numbers[0, :2] = np.inf, -0.0
    source = device.storage("numbers", numbers.nbytes)
    target = device.storage("words", 4 * words * rows)
    device.write(source, numbers)
    device.write(target, np.full(words * rows, 0xDEAD, np.uint32))
    kernel = RepackRows(device, columns, words, half_source=half_source, half_target=half_target)
    submit(device, kernel.step(source, target, rows))
    actual = device.read(target, np.uint32, words * rows).reshape(rows, words)
    np.testing.assert_array_equal(actual, repack_reference(numbers, words, half_target=half_target))


@pytest.mark.parametrize(
    "total", [-(2**31), -1, 0, 1, PAGE_ROWS - 1, PAGE_ROWS, PAGE_ROWS + 1, 3 * PAGE_ROWS, 2**31 - 1]
)
def test_live_rows_are_divided_among_pages(device: Device, total: int) -> None:
    source, target = device.storage("total", 4), device.storage("live", 16)
    device.write(source, np.array([total], np.int32))
    submit(device, LiveCounts(device).step(source, target))
    np.testing.assert_array_equal(
        device.read(target, np.uint32, 4), live_counts_reference(total, 4)
    )
