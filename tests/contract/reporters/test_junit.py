import re
from dataclasses import replace
from xml.etree import ElementTree

import pytest

from gsgen.contract.errors import ModelUnreadable
from gsgen.contract.reporters.junit import to_junit
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.report import Unreadable
from support.reports.goldens import assert_is_golden
from support.reports.judged import MODELS


def cases_of(report):
    root = ElementTree.fromstring(to_junit([report]))
    return {case.get("name").partition(" ")[0]: case for case in root.iter("testcase")}


@pytest.mark.parametrize("name", MODELS)
def test_junit_document_matches_the_golden_file(reports, name):
    text = to_junit([reports[name]])
    assert ' time="' not in text
    timed = to_junit([replace(reports[name], timed=True)])
    assert re.sub(r' time="[0-9.]+"', "", timed) == text
    assert_is_golden(f"{name}.junit.xml", text + "\n")


def test_every_rule_is_a_test(reports):
    report = reports["broken"]
    cases = cases_of(report)
    assert list(cases) == [outcome.rule.id for outcome in report.outcomes]
    assert {case.get("classname") for case in cases.values()} == {"broken.onnx"}


def test_failing_findings_become_failures_and_others_output(reports):
    report = reports["broken"]
    cases = cases_of(report)
    failed = {id for id, case in cases.items() if case.find("failure") is not None}
    assert failed == {finding.rule for finding in report.findings if report.fails_by(finding)}
    text = {id for id, case in cases.items() if case.find("system-out") is not None}
    assert text == {finding.rule for finding in report.findings if not report.fails_by(finding)}
    waived = "error (waived: Row 9 is mended in the next export.): output gaussians"
    assert cases["GV005"].findtext("system-out").startswith(waived)
    assert cases["GV018"].findtext("system-out").startswith("error (waived: ignored): ")


def test_stricter_fail_on_gives_more_failures(reports):
    cases = cases_of(replace(reports["broken"], fail_on=Severity.WARNING))
    assert cases["GV006"].find("failure").get("type") == "warning"


def test_unchecked_rule_is_skipped_with_its_reason(reports):
    cases = cases_of(reports["foreign"])
    expected = "not-applicable: because GI005 does not hold"
    assert cases["GV001"].find("skipped").get("message") == expected


def test_a_crashed_rule_is_an_error(reports):
    outcome, *remaining = reports["good"].outcomes
    crashed = replace(outcome, status="crashed", reason="Traceback:\n  ValueError: \x00")
    cases = cases_of(replace(reports["good"], outcomes=(crashed, *remaining)))
    error = cases[outcome.rule.id].find("error")
    assert error.get("message") == r"  ValueError: \x00"
    assert error.text == "Traceback:\n  ValueError: \\x00"


def test_test_counts_add_up_over_all_models(reports):
    error = ModelUnreadable("is empty", where="a.onnx")
    entries = [*reports.values(), Unreadable("a.onnx", error)]
    root = ElementTree.fromstring(to_junit(entries))
    assert [suite.get("name") for suite in root] == [entry.path for entry in entries]
    for name in ("tests", "failures", "errors", "skipped"):
        assert int(root.get(name)) == sum(int(suite.get(name)) for suite in root)
    assert root.get("errors") == "1"
    assert root[-1].find("testcase/error").text == "a.onnx: is empty"
