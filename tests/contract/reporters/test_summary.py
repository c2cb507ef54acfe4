from dataclasses import replace

import pytest

from gsgen.contract.errors import ModelUnreadable
from gsgen.contract.reporters.summary import plural, printable, summary_line, verdict_line
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.report import Unreadable

UNREADABLE = Unreadable("a.onnx", ModelUnreadable("is empty"))


def crashed(report):
    first, *remaining = report.outcomes
    return replace(report, outcomes=(replace(first, status="crashed", reason="x"), *remaining))


def test_verdict_counts_waived_and_known_findings(reports):
    first, second, *remaining = reports["broken"].findings
    findings = (replace(first, known=True), replace(second, severity=Severity.INFO), *remaining)
    text = verdict_line(replace(reports["broken"], findings=findings, baseline="b.json"))
    assert text == (
        "conforms: 28 rules hold; 1 warning; 1 info; ignored: GV018; 1 waived; "
        "1 known from b.json; 3 not applicable"
    )


def test_several_models_are_counted_by_verdict(reports):
    good, broken = reports["good"], reports["broken"]
    assert summary_line([good]) == "1 model: 1 conforms"
    assert summary_line([good, good, broken]) == "3 models: 2 conform, 1 invalid"
    text = summary_line([crashed(good), UNREADABLE, crashed(good)])
    assert text == "3 models: 2 without verdict, 1 unreadable"
    assert summary_line([]) == "0 models: no model validated"


@pytest.mark.parametrize(("count", "text"), [(0, "0 rules"), (1, "1 rule"), (2, "2 rules")])
def test_nouns_have_plurals(count, text):
    assert plural(count, "rule") == text


def test_control_characters_are_written_out():
    assert printable("a\x1b[2J\x9b\ud800é\u202e\n") == r"a\x1b[2J\x9b\ud800é\u202e\n"
    assert printable("a\nb\r", kept_chars="\n") == "a\nb\\r"
