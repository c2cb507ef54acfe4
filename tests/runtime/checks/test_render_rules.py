"""Level ``render``: models that cannot be seen are named, and no others."""

from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.clouds import still
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.spec.manifest import GeneratorManifest, WeightedSum
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.runtime.checks import level as showing
from gsgen.runtime.checks.fixtures import render_fixtures, with_reference
from gsgen.runtime.checks.reference_image import ReferenceUnreadable, read_reference
from gsgen.runtime.errors import DeviceUnavailable
from gsgen.runtime.media.pictures import png_of
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Frame
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData

RENDER = Settings(level=Level.RENDER)
RULES = ("GB018", "GB019", "GB020", "GB021")


@pytest.fixture(autouse=True)
def _one_device(renderer: Renderer, quads: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    both = {"tiles": renderer, "quads": quads}
    monkeypatch.setattr(showing, "Renderer", lambda *_, rasteriser: both[rasteriser])


@pytest.fixture(scope="module")
def quads(renderer: Renderer) -> Renderer:
    if not renderer.device.blends_floats:
        pytest.skip(f"{renderer.device.name} cannot blend 32-bit floats")
    return Renderer(renderer.device, rasteriser="quads")


def ran(report: Report) -> Report:
    """Return the report; that the level cannot run here is a fault of this machine."""
    level = next(level for level in report.levels if level.level is Level.RENDER)
    assert level.ran, level.reason
    return report


def status(report: Report) -> dict[str, str]:
    return {
        outcome.rule.id: outcome.status for outcome in report.outcomes if outcome.rule.id in RULES
    }


@pytest.mark.parametrize("fixture", render_fixtures(), ids=lambda fixture: fixture.name)
def test_an_example_breaks_its_rule_and_no_other(fixture, tmp_path: Path) -> None:
    report = ran(validate(fixture.write(tmp_path), RENDER))
    assert {finding.rule for finding in report.findings} == {fixture.rule}
    assert status(report)[fixture.rule] == "fail"
    assert find(fixture.name) == fixture


@pytest.mark.parametrize(
    "name", ["still_half_sh3", "camera_and_proj", "nothing_live", "weighted_sum"]
)
def test_good_models_are_seen(name: str, tmp_path: Path) -> None:
    report = ran(validate(find(name).write(tmp_path), RENDER))
    empty = {"GV032"} if name == "nothing_live" else set()
    assert {finding.rule for finding in report.findings} == empty
    expected_status = "skipped" if name == "weighted_sum" else "pass"
    assert status(report) == {
        "GB018": "pass",
        "GB019": "pass",
        "GB020": expected_status,
        "GB021": "pass",
    }
    assert "renderer" in report.environment


def test_a_device_without_quads_judges_no_agreement(
    renderer: Renderer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(renderer.device, "blends_floats", False)
    fixture = next(fixture for fixture in render_fixtures() if fixture.rule == "GB020")
    report = ran(validate(fixture.write(tmp_path), RENDER))
    assert not report.findings
    outcome = next(outcome for outcome in report.outcomes if outcome.rule.id == "GB020")
    assert outcome.status == "skipped"
    assert "cannot blend 32-bit floats" in outcome.reason


def drawn_reference(renderer: Renderer) -> bytes:
    """What the model of the fixtures draws at the camera that they declare."""
    weights = still().weights
    data = SplatData(weights["rows"], weights["colors"], "sh")
    view = np.eye(4)
    view[2, 3] = 4
    camera = Camera(view, fx=50, fy=50, cx=32, cy=18, width=64, height=36)
    frame = renderer.render(Scene([data]), camera, background=(0, 0, 0, 1))
    return png_of(frame.srgb8[..., :3])


def compared(spec: ModelSpec, folder: Path, **changes: object) -> showing.ComparedReference:
    """Return what becomes of the picture of a sketch, without judging the model."""
    path = folder / "model.onnx"
    spec.write(path)
    manifest = spec.manifest
    assert isinstance(manifest, GeneratorManifest)
    outputs = {"gaussians": spec.weights["rows"], "color": spec.weights["colors"],
               "num_points": spec.weights["live"]}  # fmt: skip
    trial = Mock(
        plan=Mock(probes=[Mock(label="no inputs")], values=1),
        execution=Mock(runs=[Mock(sample=0)], samples=[Mock(outputs=outputs)]),
    )
    trial.subject.generator, trial.subject.file.path = manifest, path
    return next(iter(showing._compare_references(trial, changes.pop("renderer"))))


def test_a_picture_that_the_model_draws_is_the_same(renderer: Renderer, tmp_path: Path) -> None:
    png = drawn_reference(renderer)
    comparison = compared(with_reference(still(), png), tmp_path, renderer=renderer)
    assert comparison.psnr is not None
    assert comparison.psnr > 55  # bytes of the file round by half a 255th
    other = with_reference(still(), png, center=(34.0, 18.0))
    moved = compared(other, tmp_path, renderer=renderer)
    assert moved.psnr is not None
    assert moved.psnr < 40


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"path": "gone.png"}, "the reference image 'gone.png': no such file"),
        ({"path": "../reference.png"}, "leads out of the model's folder"),
        ({"path": "/etc/hostname"}, "leads out of the model's folder"),
        ({"path": "a\\b.png"}, "no such file"),
        ({"sha256": "0" * 64}, "sha256"),
        ({"inputs": "noon"}, "no probe has the label 'noon'"),
        ({"focal": (0.0, 50.0)}, "fx"),
        ({"view": ((0.0,) * 4,) * 3}, "view"),
        ({"view": ((0.0,) * 4,) * 2}, "the view matrix has 2 rows, expected 3"),
    ],
)
def test_a_picture_that_cannot_be_compared_says_why(
    renderer: Renderer, tmp_path: Path, changes: dict[str, object], problem: str
) -> None:
    spec = with_reference(still(), png_of(np.zeros((36, 64, 3), np.uint8)), **changes)
    comparison = compared(spec, tmp_path, renderer=renderer)
    assert comparison.psnr is None
    assert problem in comparison.problem


def test_files_that_are_no_picture_and_too_large_ones(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (40, 40, 3), np.uint8)
    for content, problem in (
        (b"not a picture", "cannot be read as PNG"),
        (png_of(np.zeros((1, 5000, 3), np.uint8)), "expected at most 4096×4096"),
        (png_of(noise)[:2000], "cannot be read as PNG"),
    ):
        spec = with_reference(still(), content)
        spec.write(tmp_path / "model.onnx")
        with pytest.raises(ReferenceUnreadable, match=problem):
            read_reference(tmp_path / "a.onnx", spec.manifest.reference_images[0])
    with (tmp_path / "reference.png").open("wb") as file:
        file.truncate(33 << 20)
    with pytest.raises(ReferenceUnreadable, match="more than 33,554,432 bytes"):
        read_reference(tmp_path / "a.onnx", spec.manifest.reference_images[0])
    (tmp_path / "reference.png").unlink()
    (tmp_path / "reference.png").symlink_to("/etc/hostname")
    with pytest.raises(ReferenceUnreadable, match="is a link to /etc/hostname"):
        read_reference(tmp_path / "a.onnx", spec.manifest.reference_images[0])


def test_decibels_are_those_of_colours() -> None:
    image = np.zeros((2, 3, 4), np.float32)
    frames = [Mock(rgba=image), Mock(rgba=image + np.float32([0.1, 0.1, 0.1, 7]))]
    assert showing.decibels(*frames) == pytest.approx(20)
    assert showing.decibels(frames[0], frames[0]) == 200


def test_cells_are_drawn_as_sums(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorded: list[object] = []
    render = Renderer.render

    def watched(self: Renderer, scene: Scene, *args: object) -> Frame:
        recorded.append(scene.sets[0].weighted)
        return render(self, scene, *args)

    monkeypatch.setattr(Renderer, "render", watched)
    for name in ("weighted_sum", "still_sh0"):
        ran(validate(find(name).write(tmp_path), RENDER))
    assert {type(entry) for entry in recorded[:-2]} == {WeightedSum}
    assert recorded[-2:] == [None, None]  # by tiles, and by quads


def test_without_an_adapter_the_level_is_skipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(**_: object) -> Renderer:
        raise DeviceUnavailable("no graphics adapter", hint="Install one.")

    monkeypatch.setattr(showing, "Renderer", none)
    report = validate(find("still_sh0").write(tmp_path), RENDER)
    level = next(level for level in report.levels if level.level is Level.RENDER)
    assert (level.ran, level.reason) == (False, "no graphics adapter: Install one.")
    assert status(report) == dict.fromkeys(RULES, "skipped")
