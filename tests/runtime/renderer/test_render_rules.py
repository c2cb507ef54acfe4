"""Level ``render``: models that cannot be seen are named, and no others."""

from pathlib import Path

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
RULES = ("GB018", "GB019")


@pytest.fixture(autouse=True)
def _one_device(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(showing, "Renderer", lambda **_: renderer)


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
    assert set(status(report).values()) == {"pass"}
    assert "renderer" in report.environment


def test_cells_are_drawn_as_sums(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[object] = []
    render = Renderer.render

    def watched(self: Renderer, scene: Scene, *args: object) -> Frame:
        seen.append(scene.sets[0].weighted)
        return render(self, scene, *args)

    monkeypatch.setattr(Renderer, "render", watched)
    for name in ("weighted_sum", "still_sh0"):
        ran(validate(find(name).write(tmp_path), RENDER))
    assert {type(one) for one in seen[:-1]} == {WeightedSum}
    assert seen[-1] is None


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
