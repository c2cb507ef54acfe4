import json

import pytest

from gsgen.contract.errors import ModelUnreadable
from gsgen.contract.reporters.json_report import SCHEMA, to_dict, to_json
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.report import Unreadable
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from support.models.small_models import good_rows, save_moving
from support.reports.goldens import assert_is_golden
from support.reports.judged import MODELS


def without_the_hour(document):
    """Replace what differs from run to run and from one installation to the next."""
    document["tool"] |= {"version": "0", "rules_digest": "0"}
    assert "seconds" not in document
    document["environment"] = dict.fromkeys(document["environment"], "0")
    for finding in document["findings"]:
        finding["why"] = "Because."  # the rules' own tests are for that
    for rule in document["rules"]:
        assert "ms" not in rule
        if "items" in rule:
            rule["items"] = min(rule["items"], 1)  # runs may be planned anew
    return document


@pytest.mark.parametrize("name", MODELS)
def test_json_report_matches_the_golden_file(reports, name):
    document = without_the_hour(json.loads(to_json([reports[name]])))
    text = json.dumps(document, indent=2, ensure_ascii=False) + "\n"
    assert_is_golden(f"{name}.report.json", text)


def test_one_report_is_an_object_and_several_are_a_list(reports):
    several = json.loads(to_json([reports["good"], reports["broken"]]))
    assert several["schema"] == SCHEMA
    assert several["reports"] == [to_dict(reports["good"]), to_dict(reports["broken"])]
    assert json.loads(to_json([])) == {"schema": SCHEMA, "reports": []}


def test_a_model_that_could_not_be_read_stands_with_its_error():
    error = ModelUnreadable("is empty", where="a.onnx", hint="Write it again.")
    assert json.loads(to_json([Unreadable("a.onnx", error)])) == {
        "schema": SCHEMA,
        "subject": {"uri": "a.onnx"},
        "verdict": "unreadable",
        "error": {"message": "is empty", "where": "a.onnx", "hint": "Write it again."},
    }


def test_finding_counts_add_up(reports):
    for report in reports.values():
        document = to_dict(report)
        assert sum(document["counts"]["rules"].values()) == len(document["rules"])
        findings = [finding for finding in document["findings"] if not finding["waived"]]
        waived = len(document["findings"]) - len(findings)
        assert (document["counts"]["waived"], document["counts"]["known"]) == (waived, 0)
        for severity in ("error", "warning", "info"):
            count = sum(finding["severity"] == severity for finding in findings)
            assert document["counts"][severity] == count


def test_a_million_bad_rows_take_little_room(tmp_path):
    rows = good_rows(125_000)
    rows[:, 3] = 2
    report = validate(save_moving(tmp_path / "a.onnx", rows), Settings(level=Level.VALUES))
    (finding,) = to_dict(report)["findings"]
    assert finding["stats"]["count"] == finding["stats"]["total"] == 1_000_000
    assert len(finding["stats"]["examples"]) == 5
    good = validate(
        save_moving(tmp_path / "b.onnx", good_rows(125_000)), Settings(level=Level.VALUES)
    )
    # The list of rules is in every report; the rows that break one add little to it.
    assert len(to_json([report])) < len(to_json([good])) + 3_000
