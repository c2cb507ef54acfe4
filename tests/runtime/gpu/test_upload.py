"""Rows come into buffers as they are expected, whether the device maps its memory or not."""

import numpy as np
import pytest

from gsgen.runtime.errors import DeviceLost
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.upload import Target, upload

ROW_CAPACITY = 80_000  # rows: more than are made at a time, and enough to be mapped


@pytest.mark.parametrize("maps", [True, False])
@pytest.mark.parametrize("ordered", [True, False])
@pytest.mark.parametrize("result", [True, False])
def test_uploaded_rows_are_at_their_offsets(
    device: Device, monkeypatch: pytest.MonkeyPatch, maps: bool, ordered: bool, result: bool
) -> None:
    if maps and not device.maps_buffers:
        pytest.skip("a card, whose memory is its own")
    monkeypatch.setattr(device, "maps_buffers", maps)
    rng = np.random.default_rng(0)
    array = rng.normal(size=(15_000, 4)).astype(np.float16 if result else np.float32)
    buffer = device.dynamic_storage("rows", 16 * ROW_CAPACITY)
    before = np.full((ROW_CAPACITY, 4), 7, np.float32)
    upload(device, Target(buffer, 0, 16), before)
    order = rng.permutation(15_000)[:12_345].astype(np.uint32) if ordered else None
    assert device.can_map(buffer) is maps
    target = Target(buffer, 1234, 16, (lambda rows: rows.astype(np.float32)) if result else None)
    upload(device, target, array, order)
    ordered_rows = array if order is None else array[order]
    before[1234 : 1234 + len(ordered_rows)] = ordered_rows
    read = device.read(buffer, np.float32, 4 * ROW_CAPACITY).reshape(-1, 4)
    np.testing.assert_array_equal(read, before)


def test_lost_device_is_reported() -> None:
    device = Device.open()
    buffer = device.dynamic_storage("rows", 16 * ROW_CAPACITY)
    device.raw.destroy()
    with pytest.raises(DeviceLost, match="was lost"), device.translate_errors():
        upload(device, Target(buffer, 0, 16), np.ones((1, 4), np.float32))


def test_failed_upload_leaves_the_buffer_usable(device: Device) -> None:
    buffer = device.dynamic_storage("rows", 16 * ROW_CAPACITY)

    def fail(rows: np.ndarray) -> np.ndarray:
        raise ValueError(rows.shape)

    with pytest.raises(ValueError, match="1, 4"):
        upload(device, Target(buffer, 0, 16, fail), np.ones((1, 4), np.float32))
    upload(device, Target(buffer, 0, 16), np.ones((1, 4), np.float32))
    assert device.read(buffer, np.float32, 4).tolist() == [1, 1, 1, 1]
