"""`gsgen validate` on tilesets: kinds of file, formats of reports, exit codes."""

import json
from pathlib import Path

import pytest

from gsgen.conformance.fixtures import find
from gsgen.contract import Level, Settings
from gsgen.contract.process.limits import Limits
from gsgen.contract.validation.waivers import Waiver
from gsgen.tiles.stores.zip_store import write_archive
from gsgen.tiles.validation.sketches import explicit_sketch
from gsgen.tiles.validation.validate import validate
from support.commands import gsgen_here
from support.tiles.serving import served


@pytest.fixture
def good(tmp_path: Path) -> Path:
    return find("tiles_good").write(tmp_path)


def test_files_folders_archives_and_contents_are_validated(good: Path, tmp_path: Path) -> None:
    archive = tmp_path / "good.3tz"
    write_archive(good.parent, archive)
    content = next((good.parent / "t").rglob("*.glb"))
    completed = gsgen_here("validate", good, good.parent, archive, content, "--json")
    assert completed.code == 0, completed.err
    kinds = [entry["subject"]["kind"] for entry in json.loads(completed.out)["reports"]]
    assert kinds == ["tileset", "tileset", "tileset", "tile-content"]


@pytest.mark.parametrize(
    ("name", "code"), [("tiles_good", 0), ("tiles_child_outside", 1), ("tiles_draft_names", 0)]
)
def test_exit_codes_are_those_of_models(name: str, code: int, tmp_path: Path) -> None:
    path = find(name).write(tmp_path)
    assert gsgen_here("validate", path).code == code


def test_fail_on_and_severity_turn_a_warning_into_failure(tmp_path: Path) -> None:
    path = find("tiles_draft_names").write(tmp_path)
    assert gsgen_here("validate", path, "--fail-on", "warning").code == 1
    assert gsgen_here("validate", path, "--severity", "GT019=error").code == 1
    words = ("validate", path, "--fail-on", "warning", "--ignore", "draft-names")
    assert gsgen_here(*words).code == 0


@pytest.mark.parametrize(
    ("name", "data"),
    [("none.json", None), ("text.json", b"hello"), ("none.3tz", None), ("bad.3tz", b"PK")],
)
def test_unreadable_input_exits_with_four(name: str, data, tmp_path: Path) -> None:
    path = tmp_path / name
    if data is not None:
        path.write_bytes(data)
    completed = gsgen_here("validate", path)
    assert completed.code == 4
    assert name in completed.err
    assert "Traceback" not in completed.err


def test_an_address_is_named_as_it_was_typed(good: Path) -> None:
    with served(good.parent) as address:
        completed = gsgen_here("validate", f"{address}tileset.json")
    assert completed.code == 0, completed.out
    assert f"{address}tileset.json: tileset" in completed.out


@pytest.mark.parametrize("format", ["text", "json", "sarif", "junit", "markdown", "github"])
def test_every_format_names_the_rule_and_the_place(format: str, tmp_path: Path) -> None:
    path = find("tiles_counts_differ").write(tmp_path)
    completed = gsgen_here("validate", path, "--format", format)
    assert completed.code == 1
    assert "GT006" in completed.out
    assert "children" in completed.out


def test_explain_and_rules_know_the_family() -> None:
    assert "splats-in-box" in gsgen_here("explain", "GT003").out
    assert "GT020" in gsgen_here("rules").out


def test_a_baseline_and_a_waiver_hold(tmp_path: Path) -> None:
    path = find("tiles_counts_differ").write(tmp_path)
    first = tmp_path / "first.json"
    gsgen_here("validate", path, "--json", "-o", first)
    assert gsgen_here("validate", path, "--baseline", first).code == 0
    waiver = Waiver(rule="GT006", reason="known to be off by one")
    report = validate(path, Settings(waivers=(waiver,)))
    assert report.verdict == "conforms"
    assert report.findings[0].waiver


def test_report_lists_the_levels_that_ran(good: Path) -> None:
    static = validate(good, Settings(level=Level.STATIC))
    assert [level.level for level in static.levels] == [Level.STATIC]
    render = validate(good, Settings(level=Level.RENDER))
    completed = {level.level: level.ran for level in render.levels}
    assert completed == {Level.STATIC: True, Level.VALUES: True, Level.RENDER: True}
    assert {render.outcome(rule).status for rule in ("GT021", "GT022")} == {"pass"}
    values = validate(good, Settings(level=Level.VALUES))
    assert values.outcome("GT021").status == "skipped"


def test_rules_over_values_are_skipped_when_time_is_up(tmp_path: Path) -> None:
    """Rules over values that saw only a part of the contents are not reported as passed."""
    explicit_sketch().write(tmp_path / "tileset.json")
    report = validate(tmp_path, Settings(limits=Limits(seconds=1e-9)))
    assert report.outcome("GT005").status == "pass"
    assert report.outcome("GT012").status == "skipped"
    reason = report.outcome("GT012").reason
    assert "3 of 3 contents were not decoded" in reason
    assert "the first is t/0/" in reason
    assert "--timeout" in reason
    for rule in ("GT003", "GT008"):
        assert report.outcome(rule).status != "pass"
