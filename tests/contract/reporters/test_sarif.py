import json
from dataclasses import replace

import pytest
from jsonschema import Draft4Validator, FormatChecker

from gsgen.contract.errors import ModelUnreadable
from gsgen.contract.reporters.sarif import to_sarif
from gsgen.contract.validation.report import Unreadable
from support.reports.goldens import assert_is_golden
from support.reports.judged import MODELS
from support.reports.sarif import SCHEMA

FORMATS = FormatChecker()
UNREADABLE = Unreadable("a b.onnx", ModelUnreadable("is empty", where="a b.onnx"))


def log_of(*entries):
    """The log, which follows the schema of SARIF."""
    log = json.loads(to_sarif(entries))
    Draft4Validator(SCHEMA, format_checker=FORMATS).validate(log)
    return log


def run_of(*entries):
    (run,) = log_of(*entries)["runs"]
    return run


@pytest.mark.parametrize("name", MODELS)
def test_sarif_log_matches_the_golden_file(reports, name):
    log = log_of(reports[name])
    driver = log["runs"][0]["tool"]["driver"]
    driver |= {"version": "0", "rules": [rule["id"] for rule in driver["rules"]]}
    text = json.dumps(log, indent=2, ensure_ascii=False) + "\n"
    assert_is_golden(f"{name}.sarif", text)


def test_rules_are_described_by_their_declarations(reports):
    rules = run_of(reports["broken"])["tool"]["driver"]["rules"]
    actual = {finding.rule for finding in reports["broken"].findings}
    declared = [o.rule for o in reports["broken"].outcomes if o.rule.id in actual]
    assert [rule["id"] for rule in rules] == [rule.id for rule in declared]  # and no others
    assert run_of(reports["good"])["tool"]["driver"]["rules"] == []
    opacity = next(rule for rule in rules if rule["id"] == "GV003")
    assert opacity["name"] == "OpacityRange"
    assert opacity["shortDescription"]["text"].startswith("Opacity lies in [0, 1]")
    assert opacity["defaultConfiguration"] == {"level": "error"}


def test_a_result_says_what_and_where_and_stays_the_same_result(reports):
    report = reports["broken"]
    run = run_of(report)
    result = next(finding for finding in run["results"] if finding["ruleId"] == "GV003")
    finding = next(finding for finding in report.findings if finding.rule == "GV003")
    assert run["tool"]["driver"]["rules"][result["ruleIndex"]]["id"] == "GV003"
    assert result["message"]["text"] == f"{finding.where}: {finding.message}"
    assert result["partialFingerprints"] == {"gsgen/1": finding.fingerprint}
    (location,) = result["locations"]
    assert location["physicalLocation"]["artifactLocation"] == {"uri": "broken.onnx", "index": 0}
    (logical,) = location["logicalLocations"]
    assert logical["fullyQualifiedName"] == "output gaussians, opacity"


def test_severities_become_levels(reports):
    results = run_of(reports["broken"])["results"]
    levels = {finding["ruleId"]: finding["level"] for finding in results}
    assert (levels["GV003"], levels["GV006"]) == ("error", "warning")


def test_possible_finding_is_not_an_error(reports):
    (first, *_) = reports["broken"].findings
    possible_finding = replace(first, certainty="possible")
    (result,) = run_of(replace(reports["broken"], findings=(possible_finding,)))["results"]
    assert (result["level"], result["properties"]["certainty"]) == ("warning", "possible")


def test_waived_finding_is_suppressed_with_its_reason(reports):
    suppressed = {
        finding["ruleId"]: finding["suppressions"][0]["justification"]
        for finding in run_of(reports["broken"])["results"]
        if finding["suppressions"]
    }
    assert suppressed == {
        "GV005": "Row 9 is mended in the next export.",
        "GV018": "GV018 is ignored by the settings",
    }


def test_with_a_baseline_results_are_new_or_unchanged(reports):
    report = reports["broken"]
    first, *remaining = report.findings
    findings = (replace(first, known=True), *remaining)
    states = [
        finding["baselineState"]
        for finding in run_of(replace(report, findings=findings, baseline="b.json"))["results"]
    ]
    assert states == ["unchanged"] + ["new"] * len(remaining)
    assert "baselineState" not in run_of(report)["results"][0]


def test_several_models_are_artifacts_of_one_run(reports):
    run = run_of(UNREADABLE, reports["good"], reports["broken"])
    uris = [artifact["location"]["uri"] for artifact in run["artifacts"]]
    assert uris == ["a%20b.onnx", "good.onnx", "broken.onnx"]
    locations = {
        finding["locations"][0]["physicalLocation"]["artifactLocation"]["index"]
        for finding in run["results"]
    }
    assert locations == {2}


def test_unchecked_model_makes_the_run_unsuccessful(reports):
    (invocation,) = run_of(reports["broken"])["invocations"]
    assert invocation["executionSuccessful"]
    outcome, *remaining = reports["good"].outcomes
    crashed = replace(outcome, status="crashed", reason="Traceback:\n  ValueError: x")
    report = replace(reports["good"], outcomes=(crashed, *remaining))
    (invocation,) = run_of(report, UNREADABLE)["invocations"]
    assert not invocation["executionSuccessful"]
    texts = [finding["message"]["text"] for finding in invocation["toolExecutionNotifications"]]
    assert texts == [
        f"{outcome.rule.id} crashed: Traceback:\n  ValueError: x",
        "a b.onnx: is empty",
    ]


@pytest.mark.parametrize(
    ("path", "uri"),
    [
        ("m/a b.onnx", "m/a%20b.onnx"),
        ("c:d%20#.onnx", "c%3Ad%2520%23.onnx"),
        ("/tmp/ä.onnx", "file:///tmp/%C3%A4.onnx"),
        ("\udcff.onnx", "%FF.onnx"),
    ],
)
def test_paths_become_uris(reports, path, uri):
    (artifact,) = run_of(replace(reports["good"], path=path))["artifacts"]
    assert artifact["location"]["uri"] == uri


def test_no_models_are_an_empty_run():
    assert run_of()["results"] == []
