"""`gsgen bench-render`: what it measures, and how it says so."""

import json
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from gsgen.cli.commands.drawing.bench_render import bench_render
from gsgen.conformance.fixtures import find
from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.errors import CapacityExceeded
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.playback.camera_options import viewpoint
from gsgen.runtime.playback.frame_cost import measure
from gsgen.runtime.playback.frame_sequence import FrameSequence
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.mesh import Mesh, MeshData
from gsgen.runtime.sources.opening import open_source
from support.commands import gsgen_here

STAGES = ["project", "sort", "bin", "group", "blend"]
SMALL_SIZE_ARGS = ("--width", "48", "--height", "32", "--frames", "3")


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(Device.open(), rasteriser="tiles")


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two hundred Gaussians that stand still, and five that move."""
    folder = tmp_path_factory.mktemp("scenes")
    rng = np.random.default_rng(0)
    rows = np.zeros((200, 10), np.float32)
    rows[:, :3] = rng.normal(size=(200, 3))
    rows[:, 3], rows[:, [4, 7, 9]] = 0.8, 0.02
    color = rng.uniform(size=(200, 3)).astype(np.float32)
    np.savez(folder / "still.npz", gaussians=rows, appearance=color)
    return [folder / "still.npz", find("drift").write(folder)]


def test_scenes_that_need_several_passes_are_not_measured(scenes: list[Path]) -> None:
    device = Device.open()
    device.largest_binding = 1 << 15
    small = Renderer(device, rasteriser="tiles", page_rows=64)
    sources = [open_source(scenes[0])] * 12  # 2,400 splats
    film = FrameSequence(sources, viewpoint(None, 32, 24), frames=1, renderer=small)
    with pytest.raises(CapacityExceeded, match="more than 2,048 splats"):
        measure(film, lambda _: None)


@pytest.mark.parametrize("clock", ["timestamps", "cpu"])
def test_bench_measures_the_requested_frames(
    scenes: list[Path], renderer: Renderer, monkeypatch: pytest.MonkeyPatch, clock: str
) -> None:
    if clock == "cpu":
        monkeypatch.setattr(renderer.device, "has_clock", False)
    elif not renderer.device.has_clock:
        pytest.skip("this device has no timestamps")
    sources = [open_source(path) for path in scenes]
    film = FrameSequence(sources, viewpoint(None, 48, 32), frames=4, renderer=renderer)
    message: list[str] = []
    cost = measure(film, message.append)
    drawn = [film.draw(number) for number in range(4)]
    assert (cost.frames, cost.size, cost.gaussians, cost.capacity) == (4, (48, 32), 205, 205)
    assert cost.visible == int(np.median([frame.visible for frame in drawn]))
    assert cost.pairs == int(np.median([frame.pairs for frame in drawn]))
    words = -(-205 * 40 // 16)  # buffers have whole ones
    assert cost.rows_bytes == words * 16 + 205 * 16
    assert cost.plan_bytes > 48 * 32 * 16
    assert (cost.frames_in_flight, cost.growths, cost.redrawn) == (2, 0, 0)
    assert cost.waited > 0
    assert cost.device == renderer.device.name
    assert list(cost.inference) == [str(scenes[1])]
    assert list(cost.stages) == STAGES
    assert cost.clock == clock
    assert sum(cost.stages.values()) > 0
    for span in (cost.wall, cost.cpu, cost.submit, *cost.inference.values()):
        assert 0 < span.p50 <= span.p95
    assert message == ["warming up", "drawing 4 frames", "measuring stages"]
    for source in sources:
        source.close()


def test_rasterised_passes_are_reported_as_stages(scenes: list[Path], renderer: Renderer) -> None:
    if not renderer.device.has_clock:
        pytest.skip("this device has no timestamps")
    source = open_source(scenes[0])
    triangle = MeshData(np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.int32([[0, 1, 2]]))
    source.meshes = (Mesh(triangle),)
    quads = Renderer(renderer.device, rasteriser="quads")
    film = FrameSequence([source], viewpoint(None, 48, 32), frames=2, renderer=quads)
    cost = measure(film)
    assert list(cost.stages) == ["meshes", "project", "sort", "quads"]
    assert min(cost.stages["meshes"], cost.stages["quads"]) > 0


def test_table_lists_stages_percentiles_and_bytes(scenes: list[Path], tmp_path: Path) -> None:
    finished = gsgen_here(
        "bench-render", *scenes, *SMALL_SIZE_ARGS, "-o", tmp_path / "new" / "cost.json"
    )
    assert finished.code == 0, finished.err
    for words in ("wall", "CPU, all threads", "inference, drift.onnx", "blend, ", "p95 ms",
                  "3 frames of 48×32", "205 Gaussians", "56 bytes each",
                  "2 frames in flight; the host waited "):  # fmt: skip
        assert words in finished.out
    read = json.loads((tmp_path / "new" / "cost.json").read_text())
    assert list(read["stages"]) == STAGES
    assert read["scenes"] == [str(path) for path in scenes]
    assert set(read["tools"]) == {"gsgen", "onnxruntime", "wgpu"}


def test_json_report_and_exit_codes_of_invalid_input(scenes: list[Path]) -> None:
    app = typer.Typer()
    app.command()(bench_render)
    words = [str(scenes[0]), *SMALL_SIZE_ARGS, "--json", "--compact"]
    read = json.loads(CliRunner().invoke(app, words).stdout)
    assert read["inference"] == {}
    assert read["rows_bytes"] == 200 * (32 + 8)  # packed, and three colours in float16
    assert read["size"] == [48, 32]
    assert CliRunner().invoke(app, ["nowhere.ply"]).exit_code == 4
    wrong = CliRunner().invoke(app, [str(scenes[1]), "--size", "J=2"]).exception
    assert isinstance(wrong, ConfigInvalid)
    assert "--size: unknown open dimension 'J'" in str(wrong)
    overwrite_result = CliRunner().invoke(app, [str(scenes[1]), "-o", str(scenes[1])]).exception
    assert isinstance(overwrite_result, ConfigInvalid)
    assert "is also an input file" in str(overwrite_result)
