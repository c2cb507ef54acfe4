"""The guide "Write a viewer": what follows the specification alone draws what gsgen draws."""

import importlib.util
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import onnxruntime as ort
import pytest

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.arrays import i32
from gsgen.runtime import Camera, Scene, SplatData, SplatSet
from gsgen.runtime.oracle import render as oracle
from gsgen.sdk.binding import FrameSession
from support.reports.pages import DOCS, blocks

GUIDE = DOCS / "guides" / "write-a-viewer.md"
SIZE = (48, 36)
FOV = 0.9
FAR_EYE = (0.5, -1.0, -4.0)
INNER_EYE = (0.1, 0.05, -0.3)  # some Gaussians are beside the picture, some behind the camera
MODELS = [
    ("still_sh3", FAR_EYE),
    ("still_half_rgb4", INNER_EYE),
    ("padded_half", FAR_EYE),
    ("fade_row", FAR_EYE),
    ("camera_and_proj", INNER_EYE),
    ("viewport", FAR_EYE),
    ("flat_disks", INNER_EYE),
    ("opacity_at_its_ends", FAR_EYE),
    ("bright_sh", INNER_EYE),
    ("nan_color", FAR_EYE),
    ("nan_row", FAR_EYE),
    ("indefinite_covariance", FAR_EYE),
    ("axes_without_variance", FAR_EYE),
    ("count_above_capacity", FAR_EYE),
    ("shape_differs_at_run", FAR_EYE),
]
OFF_CENTER = (0.0, 31.0)  # the principal point, at the left and near the lower edge
DEFAULTS = [
    "avatar",
    "slider",
    "quaternion_avatar",
    "drift_in_seconds",
    "body_shape",
    "frame_table",
]


@pytest.fixture(scope="module")
def viewer(tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    """The guide's own file, imported."""
    (text,) = (block.text for block in blocks(GUIDE) if block.mark == "viewer.py")
    path = tmp_path_factory.mktemp("viewer") / "viewer.py"
    path.write_text(text, "utf-8")
    spec = importlib.util.spec_from_file_location("guide_viewer", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def fed(viewer: ModuleType, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the viewer gave the model."""
    recorded: dict[str, Any] = {}
    feed = viewer.feed

    def watched(*words: Any) -> dict[str, np.ndarray]:
        result: dict[str, np.ndarray] = feed(*words)
        recorded.update(result)
        return result

    monkeypatch.setattr(viewer, "feed", watched)
    return recorded


@pytest.mark.parametrize(("name", "eye"), MODELS)
@pytest.mark.parametrize("center", [None, OFF_CENTER], ids=["centred", "off-centre"])
def test_the_picture_is_that_of_the_oracle(
    name: str,
    eye: tuple[float, float, float],
    center: tuple[float, float] | None,
    viewer: ModuleType,
    fed: dict[str, Any],
    tmp_path: Path,
) -> None:
    path = find(name).write(tmp_path)
    lens = viewer.look_at(eye, (0, 0, 0), size=SIZE, fov=FOV)
    if center is not None:
        lens |= dict(zip(("cx", "cy"), center, strict=True))
    picture = viewer.frame(str(path), lens)
    session = ort.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    manifest = viewer.read_manifest(session)
    outputs = manifest["outputs"]
    names = [outputs[array]["name"] for array in ("gaussians", "appearance", "count")]
    rows, appearances, count = session.run(names, fed)
    space = outputs["appearance"]["space"]
    live = min(int(count[0]), len(rows))
    data = SplatData(rows, appearances, space, count=live)
    scene = Scene([SplatSet(data, antialias=manifest.get("antialias", "classic"))])
    frame = oracle.render(scene, Camera(**lens))
    assert frame.visible > 0
    apart = np.abs(picture - frame.rgba)[~frame.fragile]
    # The oracle finishes pixels that have 1e-4 of the light left, as the specification allows.
    assert apart.max() <= 2e-4 * max(1, frame.rgba.max())


def test_both_memory_orders_give_one_picture(viewer: ModuleType, tmp_path: Path) -> None:
    first, other = (
        viewer.frame(str(find(name).write(tmp_path)), viewer.look_at(FAR_EYE, (0, 0, 0), size=SIZE))
        for name in ("fade_row", "fade_column")
    )
    assert first[..., 3].max() > 0.1
    np.testing.assert_array_equal(first, other)


@pytest.mark.parametrize("name", DEFAULTS)
def test_missing_inputs_are_fed_as_gsgen_feeds_them(
    name: str, viewer: ModuleType, fed: dict[str, Any], tmp_path: Path
) -> None:
    path = find(name).write(tmp_path)
    viewer.frame(str(path), viewer.look_at(FAR_EYE, (0, 0, 0), size=SIZE))
    with FrameSession(path) as session:
        assert fed.keys() == session.inputs.keys()
        outputs = session.run(copy=True)
        again = session.run(fed, copy=True)
        for output in session.outputs:
            np.testing.assert_array_equal(again[output], outputs[output])


def with_edited_manifest(name: str, path: Path, edit: Callable[[dict[str, Any]], object]) -> Path:
    """Write a fixture with an edited manifest to ``path``."""
    find(name).draw().edit_manifest(edit).write(path)
    return path


def test_a_count_below_zero_counts_as_zero(viewer: ModuleType, tmp_path: Path) -> None:
    path = tmp_path / "negative.onnx"
    spec = find("still_sh0").draw()
    lens = viewer.look_at(FAR_EYE, (0, 0, 0), size=SIZE)
    spec.write(path)
    assert viewer.frame(str(path), lens).max() > 0.1
    spec.with_weights(live=i32(-1)).write(path)
    assert viewer.frame(str(path), lens).max() == 0


def test_the_fourth_channel_of_rgb_may_be_nan(viewer: ModuleType, tmp_path: Path) -> None:
    path = tmp_path / "fourth.onnx"
    spec = find("still_half_rgb4").draw()
    lens = viewer.look_at(FAR_EYE, (0, 0, 0), size=SIZE)
    spec.write(path)
    right = viewer.frame(str(path), lens)
    spec.with_weight_values("colors", np.s_[:, 3], np.nan).write(path)
    np.testing.assert_array_equal(viewer.frame(str(path), lens), right)


def test_a_required_extension_is_refused_by_its_name(viewer: ModuleType, tmp_path: Path) -> None:
    path = find("extension_unregistered").write(tmp_path)
    with pytest.raises(SystemExit, match="x-studio-relight"):
        viewer.frame(str(path), viewer.look_at(FAR_EYE, (0, 0, 0), size=SIZE))


@pytest.mark.parametrize("version", ["2.0", "1", "1.x", "", None])
def test_other_versions_are_refused(
    version: str | None, viewer: ModuleType, tmp_path: Path
) -> None:
    path = with_edited_manifest(
        "still_sh0", tmp_path / "m.onnx", lambda m: m.update(contract=version)
    )
    with pytest.raises(SystemExit, match=r"expected a generator of 1\.x"):
        viewer.frame(str(path), viewer.look_at(FAR_EYE, (0, 0, 0), size=SIZE))


def test_a_newer_minor_version_is_drawn_with_a_note(
    viewer: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = with_edited_manifest(
        "still_sh0", tmp_path / "m.onnx", lambda m: m.update(contract="1.9")
    )
    picture = viewer.frame(str(path), viewer.look_at(FAR_EYE, (0, 0, 0), size=SIZE))
    assert picture.max() > 0.1
    assert "1.9 is newer" in capsys.readouterr().err


def test_other_kinds_are_refused(viewer: ModuleType, tmp_path: Path) -> None:
    path = find("trajectory").write(tmp_path)
    with pytest.raises(SystemExit, match="trajectory-predictor"):
        viewer.frame(str(path), viewer.look_at(FAR_EYE, (0, 0, 0), size=SIZE))
