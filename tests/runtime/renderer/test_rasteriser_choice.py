"""Which rasteriser is chosen, by what, and for how long that is remembered."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.sort.sort import sort_config_for
from gsgen.runtime.renderer import rasteriser_choice
from gsgen.runtime.renderer.kernel_set import Kernels
from gsgen.runtime.renderer.rasteriser_choice import (
    Timings,
    choose,
    chosen_sort_config,
    measure_options,
)
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene
from support.rendering.splat_scenes import SCENES


class Stopwatch:
    """Measures nothing, and says what it is told to."""

    def __init__(self, tiles: float, quads: float, small_tiles: float = 5.0) -> None:
        self.timings, self.asked = Timings(tiles, quads, small_tiles), 0

    def __call__(self, device: Device, kernels: Kernels) -> Timings:
        self.asked += 1
        return self.timings


@pytest.fixture
def choices_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where measurements are kept: nothing is there, and the process knows of none."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("GSGEN_NO_CACHE", raising=False)
    forget(monkeypatch)
    return tmp_path / "gsgen" / "rasterisers.json"


def forget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rasteriser_choice, "_timings_by_device", {})


@pytest.fixture(scope="module")
def kernels(device: Device) -> Kernels:
    return Kernels(device)


@pytest.fixture
def gpu(device: Device) -> Device:
    """This device, taken for one that is worth measuring."""
    other = Device(device.raw)
    other.software, other.blends_floats = False, True
    return other


def test_rasteriser_choice_is_explained(gpu: Device, kernels: Kernels, choices_file: Path) -> None:
    choose(gpu, kernels, Stopwatch(0.0021, 0.0034, 0.0025))
    text = rasteriser_choice.describe_choice(gpu)
    assert text.startswith("kernels for GPUs; tiles of 32 pixels, 8 bits a sort pass; ")
    assert text.endswith("tiles: tiles of 32 2.10 ms, of 16 2.50 ms, quads 3.40 ms")
    gpu.blends_floats = False
    assert rasteriser_choice.describe_choice(gpu).endswith(
        "tiles: the device cannot blend 32-bit floats"
    )


def test_the_faster_tiles_are_used(
    gpu: Device, kernels: Kernels, renderer: Renderer, choices_file: Path
) -> None:
    assert chosen_sort_config(gpu) == sort_config_for(gpu)  # nothing was measured
    assert choose(gpu, kernels, Stopwatch(2.0, 0.9, 1.0)) == "tiles"
    assert chosen_sort_config(gpu) == replace(sort_config_for(gpu), tile=16)
    assert "tiles of 16 pixels" in rasteriser_choice.describe_choice(gpu)
    scene, camera = SCENES["many"]()
    small = Renderer(gpu)
    assert small._kernels.sort_config.tile == 16
    assert Renderer(gpu, rasteriser="tiles")._kernels.sort_config.tile == 32
    actual, expected = small.render(scene, camera), renderer.render(scene, camera)
    assert np.abs(actual.rgba - expected.rgba).max() <= 1e-6
    gpu.software = True
    assert chosen_sort_config(gpu) == sort_config_for(gpu)


@pytest.mark.parametrize(
    ("tiles", "quads", "expected"),
    [(2.0, 1.0, "quads"), (1.0, 2.0, "tiles"), (1.0, 0.79, "quads"), (1.0, 0.81, "tiles")],
)
def test_quads_must_be_clearly_faster(
    gpu: Device, kernels: Kernels, choices_file: Path, tiles: float, quads: float, expected: str
) -> None:
    assert choose(gpu, kernels, Stopwatch(tiles, quads)) == expected


def test_software_and_devices_that_cannot_blend_are_not_measured(
    gpu: Device, kernels: Kernels, choices_file: Path
) -> None:
    watch = Stopwatch(2.0, 1.0)
    gpu.blends_floats = False
    assert choose(gpu, kernels, watch) == "tiles"
    gpu.blends_floats, gpu.software = True, True
    assert choose(gpu, kernels, watch) == "tiles"
    assert watch.asked == 0
    assert not choices_file.exists()


def test_a_device_is_measured_once(
    gpu: Device, kernels: Kernels, choices_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    watch = Stopwatch(2.0, 1.0)
    assert [choose(gpu, kernels, watch) for _ in range(2)] == ["quads"] * 2
    assert watch.asked == 1
    forget(monkeypatch)  # as another process
    assert choose(gpu, kernels, watch) == "quads"
    assert watch.asked == 1
    document = json.loads(choices_file.read_text(encoding="utf-8"))
    assert list(document.values()) == [{"tiles": 2.0, "quads": 1.0, "small_tiles": 5.0}]
    assert gpu.name in next(iter(document))
    assert [path.name for path in choices_file.parent.iterdir()] == [choices_file.name]


def test_other_adapters_are_kept_beside_it(
    gpu: Device, kernels: Kernels, choices_file: Path
) -> None:
    choices_file.parent.mkdir()
    other_adapter = {"tiles": 1.0, "quads": 3.0, "small_tiles": 2.0}
    choices_file.write_text(json.dumps({"another": other_adapter}), encoding="utf-8")
    assert choose(gpu, kernels, Stopwatch(2.0, 1.0)) == "quads"
    assert json.loads(choices_file.read_text(encoding="utf-8"))["another"] == other_adapter


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[1, 2]",
        "{",
        '{"KEY": 3}',
        '{"KEY": {"tiles": 1.0}}',
        '{"KEY": {"tiles": 1.0, "quads": 2.0}}',
        '{"KEY": {"tiles": "a", "quads": 1.0, "small_tiles": 1.0}}',
        '{"KEY": {"tiles": NaN, "quads": 1.0, "small_tiles": 1.0}}',
        '{"KEY": {"tiles": -1.0, "quads": 1.0, "small_tiles": 1.0}}',
        "x" * (1 << 17),
    ],
)
def test_a_file_that_is_damaged_is_written_anew(
    gpu: Device, kernels: Kernels, choices_file: Path, text: str
) -> None:
    choices_file.parent.mkdir()
    choices_file.write_text(
        text.replace("KEY", rasteriser_choice._device_key(gpu)), encoding="utf-8"
    )
    watch = Stopwatch(2.0, 1.0)
    assert choose(gpu, kernels, watch) == "quads"
    assert watch.asked == 1
    assert list(json.loads(choices_file.read_text(encoding="utf-8")).values()) == [
        {"tiles": 2.0, "quads": 1.0, "small_tiles": 5.0}
    ]


def test_where_nothing_can_be_written_it_is_measured_again(
    gpu: Device, kernels: Kernels, choices_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    choices_file.parent.write_text("a file where the folder would be")
    watch = Stopwatch(2.0, 1.0)
    assert choose(gpu, kernels, watch) == "quads"
    choices_file.parent.unlink()
    monkeypatch.setenv("GSGEN_NO_CACHE", "1")
    forget(monkeypatch)
    assert choose(gpu, kernels, watch) == "quads"
    assert watch.asked == 2
    assert not choices_file.parent.exists()


@pytest.mark.parametrize("clock", [True, False], ids=["timestamps", "wall"])
def test_probe_draws_with_both_rasterisers(device: Device, kernels: Kernels, clock: bool) -> None:
    if not device.blends_floats:
        pytest.skip(f"{device.name} cannot blend 32-bit floats")
    other = Device(device.raw)
    other.has_clock = clock and device.has_clock
    timings = measure_options(other, kernels, gaussians=9000, size=(160, 96))
    seconds = timings.tiles, timings.quads, timings.small_tiles
    assert min(seconds) > 0
    assert max(seconds) < 60


def test_probed_scenes_are_crowded(device: Device) -> None:
    width, height = rasteriser_choice._IMAGE_SIZE
    camera = Camera(
        np.eye(4), fx=width, fy=width, cx=width / 2, cy=height / 2, width=width, height=height
    )
    data = rasteriser_choice._random_splats(
        rasteriser_choice._SAMPLE_GAUSSIAN_COUNT, height / width
    )
    own = Renderer(device, rasteriser="tiles")  # it keeps the room that it has made
    frame = own.render(Scene([data]), camera)
    assert frame.visible > 0.95 * len(data)
    assert 2 < frame.pairs / frame.visible < 12
    assert frame.alpha.mean() > 0.8


def test_software_drivers_have_tiles(device: Device) -> None:
    other = Device(device.raw)
    other.software = True
    assert Renderer(other).rasteriser == "tiles"


def test_quads_are_taken_for_colours_alone(
    device: Device, renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not device.blends_floats:
        pytest.skip(f"{device.name} cannot blend 32-bit floats")
    monkeypatch.setattr("gsgen.runtime.renderer.renderer.choose", lambda *_: "quads")
    chosen = Renderer(device, rasteriser="auto")
    assert chosen.rasteriser == "quads"
    scene, camera = SCENES["many"]()
    chosen.render(scene, camera)
    assert "blend" not in chosen._plan.stages
    both = chosen.render(scene, camera, outputs=("color", "depth"))
    tiles = renderer.render(scene, camera, outputs=("color", "depth"))
    np.testing.assert_array_equal(both.rgba, tiles.rgba)
