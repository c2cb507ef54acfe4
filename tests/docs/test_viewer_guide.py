"""The guide "Write a viewer": what follows the specification alone draws what gsgen draws."""

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import onnxruntime as ort
import pytest

from gsgen.conformance.fixtures import find
from gsgen.runtime import Camera, Scene, SplatData, SplatSet
from gsgen.runtime.oracle import render as oracle
from gsgen.sdk.binding import FrameSession
from support.reports.pages import DOCS, blocks

GUIDE = DOCS / "guides" / "write-a-viewer.md"
SIZE = (48, 36)
FOV = 0.9
FAR = (0.5, -1.0, -4.0)
AMONG = (0.1, 0.05, -0.3)  # some Gaussians are beside the picture, some behind the camera
MODELS = [
    ("still_sh3", FAR),
    ("still_half_rgb4", AMONG),
    ("padded_half", FAR),
    ("fade_row", FAR),
    ("camera_and_proj", AMONG),
    ("viewport", FAR),
    ("flat_disks", AMONG),
    ("opacity_at_its_ends", FAR),
    ("bright_sh", AMONG),
]
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
    seen: dict[str, Any] = {}
    feed = viewer.feed

    def watched(*words: Any) -> dict[str, np.ndarray]:
        made: dict[str, np.ndarray] = feed(*words)
        seen.update(made)
        return made

    monkeypatch.setattr(viewer, "feed", watched)
    return seen


@pytest.mark.parametrize(("name", "eye"), MODELS)
def test_the_picture_is_that_of_the_oracle(
    name: str,
    eye: tuple[float, float, float],
    viewer: ModuleType,
    fed: dict[str, Any],
    tmp_path: Path,
) -> None:
    path = find(name).write(tmp_path)
    lens = viewer.look_at(eye, (0, 0, 0), size=SIZE, fov=FOV)
    picture = viewer.frame(str(path), lens)
    session = ort.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    manifest = viewer.read_manifest(session)
    outputs = manifest["outputs"]
    names = [outputs[one]["name"] for one in ("gaussians", "appearance", "count")]
    rows, looks, count = session.run(names, fed)
    space = outputs["appearance"]["space"]
    data = SplatData(rows, looks, space, count=int(count[0]))
    scene = Scene([SplatSet(data, antialias=manifest.get("antialias", "classic"))])
    wanted = oracle.render(scene, Camera(**lens))
    assert wanted.visible > 0
    apart = np.abs(picture - wanted.rgba)[~wanted.fragile]
    # The oracle finishes pixels that have 1e-4 of the light left, as the specification allows.
    assert apart.max() <= 2e-4 * max(1, wanted.rgba.max())


def test_both_memory_orders_give_one_picture(viewer: ModuleType, tmp_path: Path) -> None:
    one, other = (
        viewer.frame(str(find(name).write(tmp_path)), viewer.look_at(FAR, (0, 0, 0), size=SIZE))
        for name in ("fade_row", "fade_column")
    )
    assert one[..., 3].max() > 0.1
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", DEFAULTS)
def test_missing_inputs_are_fed_as_gsgen_feeds_them(
    name: str, viewer: ModuleType, fed: dict[str, Any], tmp_path: Path
) -> None:
    path = find(name).write(tmp_path)
    viewer.frame(str(path), viewer.look_at(FAR, (0, 0, 0), size=SIZE))
    with FrameSession(path) as session:
        assert fed.keys() == session.inputs.keys()
        wanted = session.run(copy=True)
        again = session.run(fed, copy=True)
        for output in session.outputs:
            np.testing.assert_array_equal(again[output], wanted[output])
