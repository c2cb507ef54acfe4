"""`gsgen references`, and what `gsgen validate --level render` makes of what it wrote."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from PIL import Image

from gsgen.conformance.fixtures import find
from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.model.model_file import MANIFEST_KEY, open_model
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.contract.spec.manifest_io import loads
from gsgen.contract.spec.severity import Level
from gsgen.contract.tools.recording import RecordingRefused
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.runtime.checks import level as showing
from gsgen.runtime.checks import reference_recording
from gsgen.runtime.checks.reference_recording import record_references
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.distortion import Distortion
from support.commands import gsgen_here

RENDER = Settings(level=Level.RENDER)
WIDTH = 96


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(Device.open(), rasteriser="tiles")


@pytest.fixture(scope="module")
def quads(renderer: Renderer) -> Renderer | None:
    offset = renderer.device.blends_floats
    return Renderer(renderer.device, rasteriser="quads") if offset else None


@pytest.fixture(autouse=True)
def _one_device(
    renderer: Renderer, quads: Renderer | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kernels are compiled once, and not for every command."""
    both = {"tiles": renderer, "quads": quads}
    for module in (showing, reference_recording):
        monkeypatch.setattr(module, "Renderer", lambda *_, rasteriser: both[rasteriser])


def declared(path: Path) -> GeneratorManifest:
    text = open_model(path).manifest_text
    assert text is not None
    manifest = loads(text)
    assert isinstance(manifest, GeneratorManifest)
    return manifest


def rule_outcome(path: Path) -> tuple[str, list[str]]:
    """Return what became of the rule, and what it found."""
    report = validate(path, RENDER)
    result = [entry.message for entry in report.findings if entry.rule == "GB021"]
    return report.outcome("GB021").status, result


def test_pictures_are_drawn_again_until_a_weight_changes(tmp_path: Path) -> None:
    source = find("drift").write(tmp_path)
    before = source.read_bytes()
    copy = tmp_path / "promised" / "drift.onnx"
    completed = gsgen_here("references", source, "-o", copy, "--width", str(WIDTH))
    assert completed.code == 0, completed.err
    assert f"gsgen validate {copy} --level render" in completed.out
    assert source.read_bytes() == before
    folder = copy.with_name("drift-references")
    assert sorted(entry.name for entry in folder.iterdir()) == ["0.png", "1.png", "2.png"]
    images = declared(copy).reference_images
    assert len({entry.inputs for entry in images}) == 3
    for entry in images:
        with Image.open(copy.parent / entry.path) as picture:
            assert (picture.width, picture.mode) == (WIDTH, "RGB")
            assert np.asarray(picture).max() > 40
    assert rule_outcome(copy) == ("pass", [])

    model = onnx.load(copy)
    (weight,) = (entry for entry in model.graph.initializer if entry.name == "center")
    result = onnx.numpy_helper.to_array(weight) + np.float32(0.05)
    weight.CopyFrom(onnx.numpy_helper.from_array(result, "center"))
    onnx.save(model, copy)
    words = ("validate", copy, "--level", "render", "--fail-on", "warning")
    completed = gsgen_here(*words)
    assert completed.code == 1
    assert "GB021" in completed.out
    assert "dB" in completed.out

    # What was meant to change is recorded anew, in place.
    second_run = ("references", copy, "-o", copy, "--width", str(WIDTH), "--count", "1")
    refused = gsgen_here(*second_run)
    assert refused.code == 2
    assert "the folder already holds 0.png" in refused.err
    completed = gsgen_here(*second_run, "--force", "--json")
    assert completed.code == 0, completed.err
    assert len(json.loads(completed.out)["reference_images"]) == 1
    assert [entry.name for entry in folder.iterdir()] == ["0.png"]


@pytest.mark.parametrize("name", ["camera_and_proj", "weighted_sum", "nothing_live"])
def test_models_of_all_kinds_keep_their_promise(
    name: str, renderer: Renderer, tmp_path: Path
) -> None:
    source, copy = find(name).write(tmp_path), tmp_path / "copy.onnx"
    result = record_references(source, copy, count=1, width=WIDTH, renderer=renderer)
    assert result.images == declared(copy).reference_images
    assert bool(result.empty) is (name == "nothing_live")
    assert rule_outcome(copy) == ("pass", [])


def test_recording_in_a_manifest_of_1_2_writes_contract_1_0(
    renderer: Renderer, tmp_path: Path
) -> None:
    source = find("still_sh3").write(tmp_path)
    model = onnx.load(source)
    (entry,) = (entry for entry in model.metadata_props if entry.key == MANIFEST_KEY)
    document = json.loads(entry.value) | {"contract": "1.2"}
    entry.value = json.dumps(document)
    onnx.save(model, source)
    copy = tmp_path / "copy.onnx"
    record_references(source, copy, width=WIDTH, psnr=33.0, renderer=renderer)
    assert declared(copy).contract == "1.0"
    assert declared(copy).reference_images[0].psnr == 33


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("no_manifest", "has no manifest"),
        ("count_is_int64", "breaks GO011"),
        ("post_process", "is not a gaussian-generator"),
    ],
)
def test_unreproducible_references_are_refused_without_output(
    name: str, message: str, renderer: Renderer, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    with pytest.raises(RecordingRefused, match=message):
        record_references(find(name).write(tmp_path), out / "m.onnx", renderer=renderer)
    assert not out.exists()


def test_count_out_of_range_is_refused_and_the_maximum_is_valid(
    renderer: Renderer, tmp_path: Path
) -> None:
    source = find("drift").write(tmp_path)
    with pytest.raises(ConfigInvalid, match="--count: is 17, expected from 1 to 8"):
        record_references(source, tmp_path / "a.onnx", count=17, renderer=renderer)
    few_settings = replace(RENDER, seed=3)
    result = record_references(
        source, tmp_path / "a.onnx", count=8, width=16, settings=few_settings, renderer=renderer
    )
    assert len(result.images) == 8
    report = validate(result.model, few_settings)
    assert report.outcome("GB021").status == "pass"
    for words in (("--count", "0"), ("--width", "5000"), ("--psnr", "0")):
        assert gsgen_here("references", source, "-o", tmp_path / "b.onnx", *words).code == 2


def test_recorded_cameras_match_the_requested_ones(renderer: Renderer, tmp_path: Path) -> None:
    source, copy = find("drift").write(tmp_path), tmp_path / "copy.onnx"
    near = record_references(
        source, copy, camera="look-at:0,0,-3,0,0,0", count=2, width=WIDTH, renderer=renderer
    )
    for entry in near.images:
        np.testing.assert_allclose(np.array(entry.view)[:, 3], [0, 0, 3], atol=1e-12)
        assert entry.center == (WIDTH / 2, 27)
    (tmp_path / "round.json").write_text(
        Camera.panorama((0, 0, 0), (0, 0, 1), width=64, height=32).to_json()
    )
    barrel = Camera.look_at((0, 0, -3), (0, 0, 0), width=64, height=36)
    lens = Distortion.of({"k1": -0.1})
    (tmp_path / "barrel.json").write_text(replace(barrel, distortion=lens).to_json())
    for name, words in (("round", "is panorama"), ("barrel", "is pinhole with lens distortion")):
        with pytest.raises(SceneInvalid, match=f"{words}, expected a pinhole"):
            record_references(
                source,
                tmp_path / "b.onnx",
                camera=str(tmp_path / f"{name}.json"),
                renderer=renderer,
            )
    assert not (tmp_path / "b.onnx").exists()
