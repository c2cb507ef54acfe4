"""The formats of `gsgen validate`, as a user gets them."""

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest

from gsgen.contract.reporters.json_report import to_dict
from gsgen.contract.validator import validate
from support.commands import gsgen, gsgen_here


def test_command_and_library_report_equal_findings(nan: Path, dim: Path) -> None:
    completed = gsgen_here("validate", nan, dim, "--format", "json")
    for document, path in zip(json.loads(completed.out)["reports"], (nan, dim), strict=True):
        result = to_dict(validate(path))
        assert document["findings"] == result["findings"]
        for part in ("tool", "subject", "verdict", "counts", "causes", "tolerances"):
            assert document[part] == result[part]


def test_code_scanning_reads_sarif(nan: Path) -> None:
    completed = gsgen_here("validate", nan, "--format", "sarif")
    assert completed.code == 1
    (run,) = json.loads(completed.out)["runs"]
    assert "GV001" in {result["ruleId"] for result in run["results"]}


def test_test_runners_read_junit(nan: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.xml"
    assert gsgen_here("validate", nan, "--format", "junit", "-o", report).code == 1
    assert ElementTree.parse(report).getroot().get("failures") != "0"


@pytest.mark.parametrize("name", ["markdown", "md"])
def test_pull_requests_read_markdown(nan: Path, name: str) -> None:
    completed = gsgen_here("validate", nan, "--format", name)
    assert completed.code == 1
    assert completed.out.startswith("### ❌ `")


def test_github_gets_annotations_and_a_summary_page(nan: Path, tmp_path: Path) -> None:
    summary = tmp_path / "summary.md"
    summary.write_text("before\n")
    env = {"GITHUB_STEP_SUMMARY": str(summary)}
    completed = gsgen_here("validate", nan, "--format", "github", env=env)
    assert completed.code == 1
    assert completed.out.startswith("::error file=")
    page = gsgen_here("validate", nan, "--format", "md").out
    assert summary.read_text("utf-8") == f"before\n{page}"


def test_other_formats_leave_the_summary_page_alone(nan: Path, tmp_path: Path) -> None:
    summary = tmp_path / "summary.md"
    env = {"GITHUB_STEP_SUMMARY": str(summary)}
    assert gsgen_here("validate", nan, "--format", "json", env=env).code == 1
    assert not summary.exists()


def test_a_summary_page_that_cannot_be_written_is_trouble(nan: Path, tmp_path: Path) -> None:
    env = {"GITHUB_STEP_SUMMARY": str(tmp_path)}
    completed = gsgen_here("validate", nan, "--format", "github", env=env)
    assert completed.code == 2
    assert completed.out.startswith("::error file=")
    assert f"{tmp_path}: cannot be written: Is a directory" in completed.err


def test_quiet_prints_a_line_a_model(good: Path, nan: Path) -> None:
    completed = gsgen_here("validate", good, nan, "-q")
    assert completed.code == 1
    first, second, last = completed.out.splitlines()
    assert first.startswith(f"{good}: conforms: ")
    assert second.startswith(f"{nan}: invalid: ")
    assert last == "2 models: 1 conforms, 1 invalid"


def test_a_baseline_forgives_what_it_lists_and_no_more(
    good: Path, nan: Path, dim: Path, tmp_path: Path
) -> None:
    baseline = tmp_path / "baseline.json"
    assert gsgen_here("validate", nan, "--format", "json", "-o", baseline).code == 1
    completed = gsgen_here("validate", nan, "--baseline", baseline)
    assert completed.code == 0
    assert f" known from {baseline}" in completed.out
    assert "GV001 error" not in completed.out
    assert gsgen_here("validate", good, "--format", "json", "-o", baseline).code == 0
    assert gsgen_here("validate", nan, "--baseline", baseline).code == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "the baseline cannot be read"),
        ("{", "the baseline is not JSON"),
        ("{}", "the baseline is not a validation report"),
    ],
)
def test_invalid_baseline_exits_2(
    good: Path, tmp_path: Path, text: str | None, message: str
) -> None:
    baseline = tmp_path / "baseline.json"
    if text is not None:
        baseline.write_text(text)
    completed = gsgen_here("validate", good, "--baseline", baseline)
    assert completed.code == 2
    assert f"gsgen: {baseline}: {message}" in completed.err
    assert "Traceback" not in completed.err


def test_a_waiver_is_shown_with_its_reason(nan: Path) -> None:
    config = nan.parent / "gsgen.toml"
    config.write_text('[[waive]]\nrule = "rows-finite"\nreason = "Row 7 is a marker."\n')
    completed = gsgen_here("validate", nan, cwd=nan.parent)
    assert completed.code == 0
    assert (
        "  GV001 waived: rows-finite\n    output gaussians: Row 7 is a marker.\n" in completed.out
    )
    config.write_text('[[waive]]\nrule = "GV001"\n')
    completed = gsgen_here("validate", nan, cwd=nan.parent)
    assert completed.code == 2
    assert "'reason' is a required property" in completed.err


def test_undecodable_path_is_printed_in_every_format(nan: Path) -> None:
    odd = Path(f"{nan.parent}/a\udcff'\"<%.onnx")
    nan.rename(odd)
    for name in ("text", "json", "sarif", "junit", "md", "github"):
        completed = gsgen("validate", odd, "--level", "static", "--format", name)
        assert completed.code == 0, completed.err
        assert "Traceback" not in completed.err
    assert json.loads(gsgen("validate", odd, "--format", "json").out)["subject"]["uri"] == str(odd)
