"""Whatever happened to a scene before, a renderer draws it as one that never saw it."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from gsgen.runtime.errors import MemoryFull
from gsgen.runtime.gpu import device as devices
from gsgen.runtime.gpu import spatial_order, splat_residency
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.renderer.placed_pages import scene_pages
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Frame
from gsgen.runtime.scene.mesh import Mesh
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from support.rendering.failing_devices import memory_of
from support.rendering.mesh_scenes import ball, moved
from support.rendering.splat_scenes import camera, cloud, turned
from support.rendering.weighted_scenes import celled, summed

STEPS = 30
MOST_SETS = 4
OUTPUTS = ("color", "depth", "normal")
KINDS: tuple[dict[str, object], ...] = (
    {"rasteriser": "tiles"},
    {"rasteriser": "tiles", "page_rows": 100},
    {"rasteriser": "tiles", "compact": True},
    {"rasteriser": "quads", "compact": True, "page_rows": 128},
)


@pytest.fixture(params=[True, False], ids=["mapped", "copied"])
def eager(
    device: Device, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> Device:
    """A device where few rows are arranged and few bytes mapped."""
    if request.param and not device.maps_buffers:
        pytest.skip("a card, whose memory is its own")
    monkeypatch.setattr(device, "maps_buffers", request.param)
    monkeypatch.setattr(devices, "MIN_MAPPED_BYTES", 256)
    monkeypatch.setattr(splat_residency, "MIN_ORDERED_ROWS", 64)
    monkeypatch.setattr(spatial_order, "_CHECK_INTERVAL", 3)
    return device


class Changing:
    """A scene to which random things happen."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.sets: list[SplatSet] = []
        self.meshes: list[Mesh] = []
        self.camera = camera()
        self.outputs = OUTPUTS[:1]
        self.add()
        self.add()

    @property
    def scene(self) -> Scene:
        return Scene(self.sets, meshes=self.meshes)

    def change(self) -> None:
        changes: list[Callable[[], None]] = [self.add, self.drop, self.share, self.mix]
        changes += 2 * [self.move, self.move_and_count, self.count, self.color]
        changes += [self.overwrite, self.look, self.ask, self.build]
        changes[self.rng.integers(len(changes))]()

    def _some(self) -> Iterator[SplatData]:
        """Yield the data of one set, if there is any."""
        if self.sets:
            yield self.sets[self.rng.integers(len(self.sets))].data

    def add(self) -> None:
        n, dtype = int(self.rng.choice([0, 1, 63, 64, 200, 400])), self._dtype()
        if self.rng.random() < 0.15:
            self.sets.append(summed(celled(20, seed=n)))
        elif self.rng.random() < 0.3:
            colors = self.rng.uniform(size=(n, 3)).astype(dtype)
            self._place(SplatData(self._rows(n, self._dtype()), colors, "rgb"))
        else:
            width = 3 * (int(self.rng.integers(4)) + 1) ** 2
            colors = (0.3 * self.rng.normal(size=(n, width))).astype(dtype)
            self._place(SplatData(self._rows(n, self._dtype()), colors, "sh"))
        del self.sets[:-MOST_SETS]

    def _place(self, data: SplatData) -> None:
        tilt = turned(float(self.rng.choice([1e-7, 2e-5, 0.3])), (1, 2, 0.5))
        self.sets.append(SplatSet(data, tilt))

    def _dtype(self) -> type:
        return (np.float16, np.float32)[self.rng.integers(2)]

    def _rows(self, n: int, dtype: object) -> np.ndarray:
        """In a cloud, a plane, a leaning one, at one point, or partly nowhere."""
        rows, kind = cloud(n, int(self.rng.integers(1 << 30))).rows, self.rng.integers(5)
        if kind == 1:
            rows[:, 2] = 4
        elif kind == 2:
            rows[:, 2] = 4 + 1e-6 * rows[:, 0]
        elif kind == 3:
            rows[:, :3] = 0.1, 0.2, 3
        elif kind == 4:
            rows[::3, self.rng.integers(10)] = self.rng.choice([np.nan, np.inf, -np.inf])
        return rows.astype(dtype)

    def drop(self) -> None:
        for data in self._some():
            self.sets = [splat_set for splat_set in self.sets if splat_set.data is not data]

    def share(self) -> None:
        for data in self._some():
            if data.cells is None and len(self.sets) < MOST_SETS:
                self._place(data)

    def mix(self) -> None:
        self.sets = [self.sets[location] for location in self.rng.permutation(len(self.sets))]

    def move(self) -> None:
        for data in self._some():
            data.update(rows=self._rows(len(data), data.rows.dtype), count=data.count)

    def move_and_count(self) -> None:
        for data in self._some():
            live = int(self.rng.integers(len(data) + 1))
            data.update(rows=self._rows(len(data), data.rows.dtype), count=live)

    def count(self) -> None:
        for data in self._some():
            live = self.rng.choice([0, len(data), self.rng.integers(len(data) + 1)])
            data.update(count=int(live))

    def color(self) -> None:
        for data in self._some():
            colors = self.rng.uniform(-1, 1, data.appearance.shape)
            data.update(appearance=colors.astype(data.appearance.dtype), count=data.count)

    def overwrite(self) -> None:
        """Use one array for every frame, as generators do."""
        for data in self._some():
            data.rows[...] = self._rows(len(data), data.rows.dtype)
            data.update(rows=data.rows, count=data.count)

    def look(self) -> None:
        here = camera(*(int(side) for side in self.rng.choice([17, 32, 61], 2)))
        leaning = turned(float(self.rng.choice([1e-7, 2e-5, 0.1])), (1, -1, 0))
        around = Camera.panorama((0, 0, 0), width=48)
        cameras = [here, replace(here, view=leaning), here.flattened(6.0), around]
        self.camera = cameras[self.rng.integers(len(cameras))]

    def ask(self) -> None:
        self.outputs = OUTPUTS[self.rng.integers(3) :]

    def build(self) -> None:
        if self.meshes:
            self.meshes.pop()
        else:
            self.meshes.append(Mesh(ball(), moved(0, 0, int(self.rng.integers(3, 7)))))


def render_from_scratch(changing: Changing, renderer: Renderer, kind: dict[str, object]) -> Frame:
    """Draw copies of what ``renderer`` drew, by a new one of its kind."""
    fresh = Renderer(renderer.device, **kind)  # type: ignore[arg-type]
    copies = {}
    for data in dict.fromkeys(splat_set.data for splat_set in changing.sets):
        copies[data] = SplatData(
            data.rows.copy(),
            data.appearance.copy(),
            data.space,
            count=data.count,
            cells=data.cells,
            per_cell=data.per_cell,
        )
    sets = [replace(splat_set, data=copies[splat_set.data]) for splat_set in changing.sets]
    scene = Scene(sets, meshes=changing.meshes)
    if kind.get("compact"):  # rows that changed once are not packed any more
        fresh.render(scene, changing.camera)
        for data, copy in copies.items():
            if any(not page.packed for page in renderer._residency.pages(data)):
                copy.update(rows=copy.rows, count=copy.count)
    return fresh.render(scene, changing.camera, outputs=changing.outputs)


def differing_fields(frame: Frame, two: Frame) -> list[str]:
    """Return what of two frames is not the same, bit for bit."""
    fields = ("rgba", "alpha", "depth", "median_depth", "ids", "normal", "visible", "pairs")
    pairs = {name: (getattr(frame, name), getattr(two, name)) for name in fields}
    return [name for name, values in pairs.items() if not np.array_equal(*values)]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("seed", [4, 5, 12])
def test_earlier_frames_do_not_affect_a_frame(eager: Device, seed: int) -> None:
    """Several draw at once on one device, some without being waited for, or in vain."""
    changing, deep, arranged = Changing(seed), 0, 0
    long_lived_renderers = [Renderer(eager, **kind) for kind in KINDS]  # type: ignore[arg-type]
    for step in range(STEPS):
        for _ in range(changing.rng.integers(1, 4)):
            changing.change()
        for other in long_lived_renderers:
            if changing.rng.random() < 0.3:
                other.draw(changing.scene, changing.camera, output=changing.outputs[0])
        number = changing.rng.integers(len(KINDS))
        entry, kind = long_lived_renderers[number], KINDS[number]
        if changing.rng.random() < 0.1:
            with memory_of(100), pytest.raises(MemoryFull):
                entry.render(changing.scene, camera(9 + step, 7))
        frame = entry.render(changing.scene, changing.camera, outputs=changing.outputs)
        deep += entry._has_deep_tiles
        pages = scene_pages(changing.scene, entry._residency)
        arranged += any(page.rows_of is not None for _, page in pages)
        assert differing_fields(frame, render_from_scratch(changing, entry, kind)) == [], (
            step,
            kind,
        )
    assert arranged > 0
    assert deep > 0 or seed == 5
