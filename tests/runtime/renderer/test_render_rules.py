"""Level ``render``: models that cannot be seen are named, and no others."""

from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from gsgen.conformance.fixtures import find
from gsgen.contract.config import Settings
from gsgen.contract.engine import validate
from gsgen.contract.finding import Level
from gsgen.contract.manifest import WeightedSum
from gsgen.contract.report import Report
from gsgen.runtime import showing
from gsgen.runtime.errors import DeviceUnavailable
from gsgen.runtime.frame import Frame
from gsgen.runtime.render_fixtures import render_fixtures
from gsgen.runtime.renderer import Renderer
from gsgen.runtime.scene import Scene

RENDER = Settings(level=Level.RENDER)
RULES = ("GB018", "GB019", "GB020")


@pytest.fixture(autouse=True)
def _one_device(
    renderer: Renderer, quads: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    both = {"tiles": renderer, "quads": quads}
    monkeypatch.setattr(showing, "Renderer", lambda *_, rasteriser: both[rasteriser])


@pytest.fixture(scope="module")
def quads(renderer: Renderer) -> Renderer:
    if not renderer.device.blends_floats:
        pytest.skip(f"{renderer.device.name} cannot blend 32-bit floats")
    return Renderer(renderer.device, rasteriser="quads")


def ran(report: Report) -> Report:
    """Return the report; that the level cannot run here is a fault of this machine."""
    level = next(one for one in report.levels if one.level is Level.RENDER)
    assert level.ran, level.reason
    return report


def status(report: Report) -> dict[str, str]:
    return {one.rule.id: one.status for one in report.outcomes if one.rule.id in RULES}


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
    assert not report.findings
    alike = "skipped" if name == "weighted_sum" else "pass"
    assert status(report) == {"GB018": "pass", "GB019": "pass", "GB020": alike}
    assert "renderer" in report.environment


def test_a_device_without_quads_judges_no_agreement(
    renderer: Renderer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(renderer.device, "blends_floats", False)
    fixture = next(one for one in render_fixtures() if one.rule == "GB020")
    report = ran(validate(fixture.write(tmp_path), RENDER))
    assert not report.findings
    outcome = next(one for one in report.outcomes if one.rule.id == "GB020")
    assert outcome.status == "skipped"
    assert "cannot blend 32-bit floats" in outcome.reason


def test_decibels_are_those_of_colours() -> None:
    made = np.zeros((2, 3, 4), np.float32)
    frames = [Mock(rgba=made), Mock(rgba=made + np.float32([0.1, 0.1, 0.1, 7]))]
    assert showing.decibels(*frames) == pytest.approx(20)
    assert showing.decibels(frames[0], frames[0]) == 200


def test_cells_are_drawn_as_sums(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[object] = []
    render = Renderer.render

    def watched(self: Renderer, scene: Scene, *args: object) -> Frame:
        seen.append(scene.sets[0].weighted)
        return render(self, scene, *args)

    monkeypatch.setattr(Renderer, "render", watched)
    for name in ("weighted_sum", "still_sh0"):
        ran(validate(find(name).write(tmp_path), RENDER))
    assert {type(one) for one in seen[:-2]} == {WeightedSum}
    assert seen[-2:] == [None, None]  # by tiles, and by quads


def test_without_an_adapter_the_level_is_skipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(**_: object) -> Renderer:
        raise DeviceUnavailable("no graphics adapter", mend="Install one.")

    monkeypatch.setattr(showing, "Renderer", none)
    report = validate(find("still_sh0").write(tmp_path), RENDER)
    level = next(one for one in report.levels if one.level is Level.RENDER)
    assert (level.ran, level.reason) == (False, "no graphics adapter: Install one.")
    assert status(report) == dict.fromkeys(RULES, "skipped")
