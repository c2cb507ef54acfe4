from dataclasses import replace

import pytest

from gsgen.contract.errors import ModelUnreadable
from gsgen.contract.reporters.github import to_github
from gsgen.contract.validation.finding import Location
from gsgen.contract.validation.report import Unreadable
from support.reports.goldens import assert_is_golden
from support.reports.judged import MODELS


def read_command(line):
    """Read a workflow command as the runner does: command, properties, message."""
    assert line.startswith("::")
    head, _, message = line[2:].partition("::")
    command, _, listed = head.partition(" ")
    pairs = (pair.partition("=") for pair in listed.split(","))
    properties = {key: value for key, _, value in pairs}
    for code, letter in (("%2C", ","), ("%3A", ":"), ("%0A", "\n"), ("%25", "%")):
        properties = {key: v.replace(code, letter) for key, v in properties.items()}
        message = message.replace(code, letter) if code != "%2C" else message
    return command, properties, message


@pytest.mark.parametrize("name", MODELS)
def test_annotations_match_the_golden_file(reports, name):
    assert_is_golden(f"{name}.github.txt", to_github([reports[name]]) + "\n")


def test_an_annotation_names_its_file_and_says_how_to_mend(reports):
    first, *_ = reports["broken"].findings
    command, properties, message = read_command(to_github([reports["broken"]]).splitlines()[0])
    assert command == "error"
    assert properties == {"file": "broken.onnx", "title": f"{first.rule} {first.slug}"}
    assert message == f"{first.where}: {first.message}\nhint: {first.hint}"


def test_severities_become_commands_and_possible_findings_warnings(reports):
    lines = to_github([reports["broken"]]).splitlines()
    assert [line.split(" ")[0] for line in lines] == [
        *("::error", "::error", "::warning", "gsgen:")
    ]
    first, *_ = reports["broken"].findings
    possible_finding = replace(first, certainty="possible")
    line, _ = to_github([replace(reports["broken"], findings=(possible_finding,))]).splitlines()
    assert line.startswith("::warning ")


def test_waived_or_known_finding_is_not_annotated(reports):
    first, second, *_ = reports["broken"].findings
    findings = (replace(first, known=True), replace(second, waived=True))
    text = to_github([replace(reports["broken"], findings=findings, baseline="b.json")])
    assert "::" not in text


def test_unreadable_models_and_crashed_rules_are_annotated(reports):
    outcome, *remaining = reports["good"].outcomes
    crashed = replace(outcome, status="crashed", reason="Traceback:\n  ValueError: x")
    report = replace(reports["good"], outcomes=(crashed, *remaining))
    error = ModelUnreadable("is empty", where="a.onnx", hint="Write it again.")
    lines = to_github([report, Unreadable("a.onnx", error)]).splitlines()
    assert read_command(lines[0])[1]["title"] == f"{outcome.rule.id} crashed"
    assert read_command(lines[2])[2] == "a.onnx: is empty\n  Write it again."
    assert lines[-1] == "2 models: 1 without verdict, 1 unreadable"


@pytest.mark.parametrize("name", ["a::b,c=d%0A", "x\r\n::error::y", "##[error]z", "\x1b[2J"])
def test_names_cannot_inject_workflow_commands(reports, name):
    first, *_ = reports["broken"].findings
    report = replace(reports["broken"], path=name, findings=(replace(first, where=Location(name)),))
    first_line, last_line = to_github([report]).splitlines()
    assert read_command(first_line)[0] == "error"
    assert last_line.startswith("gsgen: ")
    assert "##[" not in last_line
