"""Every report follows the published schema."""

import json

import pytest
from jsonschema import Draft202012Validator, ValidationError

from gsgen.conformance.fixtures import fixtures
from gsgen.contract.errors import ModelUnreadable
from gsgen.contract.reporters.document import schema
from gsgen.contract.reporters.json_report import to_dict, to_json
from gsgen.contract.validation.digest import rules_digest
from gsgen.contract.validation.report import Unreadable
from gsgen.contract.validator import validate

CHECKED = Draft202012Validator(schema())
# One of seven, so that all families are among them and the run stays short.
SAMPLE = fixtures()[::7]
UNREADABLE = Unreadable("a.onnx", ModelUnreadable("is empty", where="a.onnx"))


@pytest.mark.parametrize("fixture", SAMPLE, ids=lambda finding: finding.name)
def test_reports_of_the_corpus_follow_the_schema(fixture, tmp_path):
    report = validate(fixture.write(tmp_path), fixture.settings)
    document = json.loads(to_json([report]))
    CHECKED.validate(document)
    assert document["verdict"] == report.verdict
    assert len(document["findings"]) == len(report.findings)


def test_several_reports_follow_the_schema(reports):
    for entries in ([], [UNREADABLE], [*reports.values(), UNREADABLE]):
        CHECKED.validate(json.loads(to_json(entries)))


@pytest.mark.parametrize(
    "change",
    [
        {"schema": "gsgen-report/2"},
        {"verdict": "fine"},
        {"fail_on": "never"},
        {"stranger": 1},
        {"subject": {}},
        {"findings": [{}]},
    ],
)
def test_schema_refuses_invalid_reports(reports, change):
    with pytest.raises(ValidationError):
        CHECKED.validate(to_dict(reports["good"]) | change)


def test_causes_name_the_rules_that_they_blocked(reports):
    document = to_dict(reports["foreign"])
    by_rule = {cause["rule"]: cause for cause in document["causes"]}
    assert by_rule["GO005"]["blocked"] == ["GO008"]
    (finding,) = (finding for finding in document["findings"] if finding["rule"] == "GO005")
    assert by_rule["GO005"]["findings"] == [finding["fingerprint"]]
    blocked = [id for cause in by_rule.values() for id in cause["blocked"]]
    dependents = [
        finding["id"] for finding in document["rules"] if "because" in finding.get("reason", "")
    ]
    assert sorted(blocked) == sorted(dependents)


def test_report_states_its_rule_set(reports):
    text = {to_dict(report)["tool"]["rules_digest"] for report in reports.values()}
    assert text == {rules_digest(finding.rule for finding in reports["good"].outcomes)}
