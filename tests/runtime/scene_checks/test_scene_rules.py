"""The rules GC of scene files and their fixtures prove each other."""

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import gsgen
from gsgen.conformance.fixtures import Fixture
from gsgen.contract import Level, Report, Severity
from gsgen.contract.spec.layout import OPACITY
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.rule import Registry, Rule
from gsgen.contract.validation.settings import Settings
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.scene_checks import inspected_scene
from gsgen.runtime.scene_checks.fixtures import scene_fixtures
from gsgen.runtime.scene_checks.rules import SCENE_RULES
from gsgen.runtime.scene_checks.validate import validate_scene
from gsgen.tiles.validation.rules import all_rules

FIXTURES = scene_fixtures()
BROKEN = [fixture for fixture in FIXTURES if fixture.rule]


@pytest.fixture(scope="module")
def judge(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Fixture], Report]:
    @cache
    def judged(fixture: Fixture) -> Report:
        return validate_scene(fixture.write(tmp_path_factory.mktemp("s")), fixture.settings)

    return judged


@pytest.mark.parametrize("fixture", FIXTURES, ids=lambda fixture: fixture.name)
def test_a_scene_breaks_its_rule_and_no_other(
    fixture: Fixture, judge: Callable[[Fixture], Report]
) -> None:
    report = judge(fixture)
    message = [(finding.rule, str(finding.where), finding.message) for finding in report.findings]
    assert {finding.rule for finding in report.findings} == {fixture.rule} - {""}, message
    is_error = bool(fixture.rule) and all_rules().rules[fixture.rule].severity is Severity.ERROR
    assert report.verdict == ("invalid" if is_error else "conforms")
    for outcome in report.outcomes:
        assert outcome.status != "crashed", outcome.reason
        assert outcome.status == "pass" or outcome.rule.id == fixture.rule or outcome.reason
    if not fixture.rule:
        assert {outcome.status for outcome in report.outcomes} == {"pass"}


@pytest.mark.parametrize(
    ("path", "sound", "named"),
    [
        ("/nowhere/a.ply", {"path": "a.ply"}, "/nowhere/a.ply"),
        ("../a.onnx", {"path": "a.ply"}, "../a.onnx"),
        ("a.ply", {"path": "folder"}, "folder"),
        ("a.ply", {"path": "https://a.b/c.wav"}, "https:/a.b/c.wav"),
        ("a.ply", {"path": "a.ply", "captions": "folder"}, "folder"),
    ],
)
def test_missing_files_are_named_wherever_they_should_be(
    tmp_path: Path, path: str, sound: dict[str, str], named: str
) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "a.ply").touch()
    file = tmp_path / "scene.json"
    file.write_text(json.dumps({"models": [{"path": path}], "sound": sound}))
    report = validate_scene(file, Settings(level=Level.STATIC))
    assert [str(finding.where) for finding in report.findings] == [f"file {named}"]


def test_programs_validate_scene_files_as_the_command_does(tmp_path: Path) -> None:
    file = scene_fixtures()[0].write(tmp_path)
    report = gsgen.validate(file, level="static")
    assert (report.kind, report.verdict) == ("scene", "conforms")


def test_statistics_do_not_depend_on_the_parts_that_are_added(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    generator = np.random.default_rng(0)
    rows, colors = generator.random((100, 10)), generator.random((100, 3))
    data = SplatData(rows.astype(np.float32), colors.astype(np.float32), "sh", count=90)
    whole = inspected_scene._statistics_around(data)(data)
    weight = data.rows[:90, OPACITY, None] * np.insert(data.appearance[:90], 0, 1, axis=1)
    assert (abs(whole).max(axis=1) <= weight.sum(axis=0)).all()
    monkeypatch.setattr(inspected_scene, "_ROWS_AT_ONCE", 7)
    np.testing.assert_allclose(inspected_scene._statistics_around(data)(data), whole)


def silent_check(_: object) -> Iterator[Violation]:
    yield from ()


@pytest.mark.parametrize("rule", SCENE_RULES, ids=lambda rule: rule.id)
def test_a_fixture_fails_by_its_rule_alone(rule: Rule, tmp_path: Path) -> None:
    fixture = next(entry for entry in BROKEN if entry.rule == rule.id)
    rules = [
        replace(entry, check=silent_check) if entry.id == rule.id else entry
        for entry in SCENE_RULES
    ]
    level = Level.STATIC if rule.level is Level.STATIC else Level.VALUES
    report = validate_scene(
        fixture.write(tmp_path),
        replace(fixture.settings, level=level),
        registry=Registry.from_rules(rules),
    )
    assert (report.verdict, list(report.findings)) == ("conforms", [])


def test_ids_and_fixtures_are_complete() -> None:
    assert [rule.id for rule in SCENE_RULES] == [f"GC{number:03}" for number in range(1, 8)]
    assert {rule.id for rule in SCENE_RULES} == {fixture.rule for fixture in BROKEN}
