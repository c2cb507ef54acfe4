"""Only what changed goes to the GPU: rows, appearance, or rows that were not live before."""

from collections.abc import Iterable
from weakref import ref

import numpy as np
import pytest

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.splat_residency import Residency
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.scene.splat_pool import SplatPool
from support.rendering.splat_scenes import camera, cloud

ROW, COLOR = 40, 16  # bytes; RGB in float32 is filled up to a word


@pytest.fixture
def written(device: Device, monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int, int]]:
    """Whatever is written to a buffer: its label, from which byte on, how many bytes."""
    recorded: list[tuple[str, int, int]] = []
    write_mapped, write = Device.write_mapped, Device.write

    def filled(self: Device, buffer: object, blocks: Iterable[np.ndarray], offset: int) -> None:
        copied = list(blocks)
        recorded.append((buffer.label, offset, sum(block.nbytes for block in copied)))
        write_mapped(self, buffer, copied, offset)

    def written(self: Device, buffer: object, data: np.ndarray, offset: int = 0) -> None:
        recorded.append((buffer.label, offset, data.nbytes))
        write(self, buffer, data, offset)

    monkeypatch.setattr(Device, "write_mapped", filled)  # of large buffers, if the device maps them
    monkeypatch.setattr(Device, "write", written)
    return recorded


def test_unchanged_rows_are_not_written(device: Device, written: list) -> None:
    data, other = cloud(100, 1), cloud(100, 2)
    residency = Residency(device)

    def uploaded() -> list:
        written.clear()
        residency.pages(data)
        return list(written)

    all_writes = [("rows", 0, 100 * ROW), ("appearance", 0, 100 * COLOR)]
    assert uploaded() == all_writes
    assert uploaded() == []
    data.update(rows=other.rows)
    assert uploaded() == all_writes[:1]
    data.update(appearance=other.appearance)
    assert uploaded() == all_writes[1:]
    data.update(data.rows, data.appearance)
    assert uploaded() == all_writes
    data.update(count=30)
    assert uploaded() == []
    data.update(rows=other.rows, count=30)
    assert uploaded() == [("rows", 0, 30 * ROW)]
    data.update(count=40)
    assert uploaded() == [("rows", 30 * ROW, 10 * ROW)]
    data.update(count=100)
    assert uploaded() == [("rows", 40 * ROW, 60 * ROW)]
    data.update(count=0)
    assert uploaded() == []


def test_rows_that_become_live_are_written_page_by_page(device: Device, written: list) -> None:
    data = cloud(300, 3, degree=1)
    data.update(count=70)
    residency = Residency(device, page_rows=64)
    residency.pages(data)
    assert [entry for entry in written if entry[0] == "rows"] == [
        ("rows", 0, 64 * ROW),
        ("rows", 0, 6 * ROW),
    ]
    written.clear()
    data.update(count=200)
    residency.pages(data)
    assert [entry for entry in written if entry[0] == "rows"] == [
        ("rows", 6 * ROW, 58 * ROW),
        ("rows", 0, 64 * ROW),
        ("rows", 0, 8 * ROW),
    ]


def test_a_count_that_grows_shows_the_same_as_at_once(device: Device, renderer: Renderer) -> None:
    small = Renderer(device, rasteriser="tiles", page_rows=64)
    data = cloud(300, 6, degree=3)
    for count in (0, 70, 65, 300):
        data.update(count=count)
        shown = small.render(Scene([data]), camera())
        fresh = SplatData(data.rows, data.appearance, "sh", count=count)
        assert np.array_equal(shown.rgba, renderer.render(Scene([fresh]), camera()).rgba)
        assert (shown.visible > 0) == (count > 0)


def test_memory_is_released_with_its_splats(device: Device) -> None:
    residency, data, pool = Residency(device), cloud(100, 1), SplatPool(100, 3)
    buffers = [ref(pages[0].rows) for pages in (residency.pages(data), residency.pool_pages(pool))]
    assert None not in [buffer() for buffer in buffers]
    del data, pool
    assert [buffer() for buffer in buffers] == [None, None]
