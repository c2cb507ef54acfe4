"""The viewer kit: our renderer passes it, and each wrong viewer fails the right cases alone."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.viewer_kit.check_viewer import check_viewer, read_index
from gsgen.conformance.viewer_kit.faults import VIEWER_FAULTS
from gsgen.conformance.viewer_kit.picture_files import encode_png
from gsgen.conformance.viewer_kit.write import kit_cases, write_kit
from gsgen.runtime import Camera, Renderer, Scene
from gsgen.runtime.checks.viewer_kit import draw_frames
from gsgen.runtime.gpu.device import Device
from runtime.checks.wrong_viewers import WRONG_VIEWERS, Render, Viewer

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def kit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_kit(tmp_path_factory.mktemp("kit") / "kit", draw_frames).parent


@pytest.fixture(scope="module", params=["tiles", "quads"])
def drawn(request: pytest.FixtureRequest, device: Device) -> Render:
    return _drawn_by(Renderer(device, rasteriser=request.param))


@pytest.fixture(scope="module")
def tiles(renderer: Renderer) -> Render:
    """Return a function that draws each scene once: most faults change few of them."""
    draw = _drawn_by(renderer)
    drawn: dict[bytes, np.ndarray] = {}

    def draw_once(scene: Scene, camera: Camera) -> np.ndarray:
        key = pickle.dumps((scene, camera))
        if key not in drawn:
            drawn[key] = draw(scene, camera)
            drawn[key].flags.writeable = False
        return drawn[key]

    return draw_once


def _drawn_by(renderer: Renderer) -> Render:
    def draw(scene: Scene, camera: Camera) -> np.ndarray:
        rgba = renderer.render(scene, camera).rgba
        assert rgba is not None
        return np.asarray(rgba, np.float64)

    return draw


def _failed(kit: Path, viewer: Viewer, render: Render, folder: Path) -> dict[str, set[str]]:
    for case in kit_cases():
        viewer.draw(kit / "models" / f"{case.name}.onnx", case, render, folder)
    return _failed_and_suspected(kit, folder)


def _failed_and_suspected(kit: Path, folder: Path) -> dict[str, set[str]]:
    result = check_viewer(kit, folder)
    return {
        "cases": {case["name"] for case in result["cases"] if case["verdict"] == "failed"},
        "faults": {fault["id"] for fault in result["faults"]},
    }


def test_our_renderer_passes_with_both_rasterisers(
    kit: Path, drawn: Render, tmp_path: Path
) -> None:
    assert _failed(kit, Viewer(), drawn, tmp_path) == {"cases": set(), "faults": set()}


@pytest.mark.parametrize("fault", VIEWER_FAULTS)
def test_a_wrong_viewer_fails_the_right_cases_and_its_fault_is_named_also_with_8_bits(
    fault: str, kit: Path, tiles: Render, tmp_path: Path
) -> None:
    floats = _failed(kit, WRONG_VIEWERS[fault], tiles, tmp_path)
    (entry,) = (entry for entry in read_index(kit)["faults"] if entry["id"] == fault)
    assert entry["cases"]
    for path in tmp_path.glob("*.npy"):
        rounded_down = np.floor(np.load(path).astype(np.float64) * 255) / 255
        path.with_suffix(".png").write_bytes(encode_png(rounded_down))
        path.unlink()
    for failed in (floats, _failed_and_suspected(kit, tmp_path)):
        # A case that a fault spoils slightly is near the tolerance, on whichever side.
        assert failed["cases"] - set(entry.get("slight", [])) == set(entry["cases"])
        assert fault in failed["faults"]
