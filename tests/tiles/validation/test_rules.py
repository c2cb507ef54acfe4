"""The rules GT and their fixtures prove each other."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from gsgen.conformance.fixtures import Fixture
from gsgen.contract import Level, Report, Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.rule import Registry, Rule
from gsgen.tiles.validation.fixtures import tiles_fixtures
from gsgen.tiles.validation.rules import TILESET_RULES, all_rules
from gsgen.tiles.validation.validate import validate

FIXTURES = tiles_fixtures()
VALID_FIXTURES = [fixture for fixture in FIXTURES if not fixture.rule]
BROKEN = [fixture for fixture in FIXTURES if fixture.rule]


def fixture_name(fixture: Fixture) -> str:
    return fixture.name


@pytest.fixture(scope="module")
def judge(tmp_path_factory: pytest.TempPathFactory):
    @cache
    def judged(fixture: Fixture) -> Report:
        return validate(fixture.write(tmp_path_factory.mktemp("t")), fixture.settings)

    return judged


@pytest.mark.parametrize("fixture", BROKEN, ids=fixture_name)
def test_a_broken_tileset_breaks_its_rule_and_no_other(fixture: Fixture, judge) -> None:
    report = judge(fixture)
    message = [(finding.rule, str(finding.where), finding.message) for finding in report.findings]
    assert {finding.rule for finding in report.findings} == {fixture.rule}, message
    warns = all_rules().rules[fixture.rule].severity is Severity.WARNING
    assert report.verdict == ("conforms" if warns else "invalid")


@pytest.mark.parametrize("fixture", VALID_FIXTURES, ids=fixture_name)
def test_a_good_tileset_breaks_nothing(fixture: Fixture, judge) -> None:
    report = judge(replace(fixture, level=Level.RENDER))
    assert report.findings == ()
    assert report.verdict == "conforms"
    statuses = {o.rule.id: o.status for o in report.outcomes if o.rule.family == "GT"}
    assert set(statuses.values()) == {"pass"}
    assert len(statuses) == len(TILESET_RULES) == 25


@pytest.mark.parametrize("fixture", FIXTURES, ids=fixture_name)
def test_no_rule_crashes_or_stays_silent(fixture: Fixture, judge) -> None:
    for outcome in judge(fixture).outcomes:
        assert outcome.status != "crashed", outcome.reason
        settled = outcome.status == "pass" or outcome.rule.id == fixture.rule
        assert settled or outcome.reason


def silent_check(_: object) -> Iterator[Violation]:
    yield from ()


@pytest.mark.parametrize("rule", TILESET_RULES, ids=lambda rule: rule.id)
def test_fixture_fails_when_its_rule_is_silent(rule: Rule, tmp_path: Path) -> None:
    fixture = next(entry for entry in BROKEN if entry.rule == rule.id)
    rules = [
        replace(entry, check=silent_check) if entry.id == rule.id else entry
        for entry in all_rules().rules.values()
    ]
    report = validate(
        fixture.write(tmp_path), fixture.settings, registry=Registry.from_rules(rules)
    )
    assert rule.id not in {finding.rule for finding in report.findings}


def test_ids_and_fixtures_are_complete() -> None:
    assert [rule.id for rule in TILESET_RULES] == [f"GT{number:03}" for number in range(1, 26)]
    assert {rule.id for rule in TILESET_RULES} == {fixture.rule for fixture in BROKEN}


@pytest.mark.parametrize("fixture", FIXTURES, ids=fixture_name)
def test_a_fixture_is_always_the_same(fixture: Fixture, tmp_path: Path) -> None:
    first, second = (
        {
            file.relative_to(folder).as_posix(): file.read_bytes()
            for file in (fixture.write(folder).parent).rglob("*")
            if file.is_file()
        }
        for folder in (tmp_path / "a", tmp_path / "b")
    )
    assert [key.split("/", 1)[1] for key in first] == [key.split("/", 1)[1] for key in second]
    assert list(first.values()) == list(second.values())


def test_the_static_level_does_not_decode(tmp_path: Path) -> None:
    (fixture,) = (entry for entry in BROKEN if entry.rule == "GT012")
    path = fixture.write(tmp_path)
    report = validate(path, replace(fixture.settings, level=Level.STATIC))
    assert report.findings == ()
    outcomes = {outcome.rule.id: outcome for outcome in report.outcomes}
    assert outcomes["GT012"].status == "skipped"
    assert outcomes["GT005"].status == "pass"
