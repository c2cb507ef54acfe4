import re
from dataclasses import replace

import pytest

from gsgen.conformance.fixtures import find
from gsgen.contract.errors import ModelUnreadable
from gsgen.contract.reporters.text import Line, render, render_all
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.finding import Location
from gsgen.contract.validation.report import Unreadable
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from support.reports.goldens import assert_is_golden
from support.reports.judged import MODELS

VOLATILE = (
    (r"\(\d[\d,]* checked", "(N checked"),  # runs may be planned anew
    (r"\b\d+\.\d\d s\b", "0.00 s"),
)


def text_of(report, **options):
    text = "".join(line.text + "\n" for line in render(report, **options))
    for pattern, stand_in in VOLATILE:
        text = re.sub(pattern, stand_in, text)
    return text


@pytest.mark.parametrize("name", MODELS)
def test_report_matches_the_golden_file(reports, name):
    assert_is_golden(f"{name}.txt", text_of(reports[name]))


@pytest.mark.parametrize("name", MODELS)
def test_verbose_report_matches_the_golden_file(reports, name):
    assert_is_golden(f"{name}.verbose.txt", text_of(reports[name], verbose=True))


def test_no_line_of_a_finding_is_longer_than_a_terminal(reports):
    for report in reports.values():
        for line in render(report)[2:-1]:
            assert len(line.text) <= 96


def styles(report):
    return [line.style for line in render(report) if line.style]


def test_the_verdict_and_errors_have_a_style(reports):
    assert styles(reports["good"]) == ["bold", "bold green"]
    assert set(styles(reports["broken"])) == {"bold", "bold red", "yellow"}


def test_a_finding_says_whether_it_is_possible_and_where_it_comes_from(reports):
    (finding, *_) = reports["broken"].findings
    possible_finding = replace(finding, certainty="possible", source="webgpu@1.0")
    text = text_of(replace(reports["broken"], findings=(possible_finding,)))
    assert f"  {finding.rule} error (possible) {finding.slug} [webgpu@1.0]\n" in text


def test_a_crashed_rule_is_shown_with_its_traceback(reports):
    report = reports["good"]
    crashed = replace(report.outcomes[0], status="crashed", reason="Traceback:\n  ValueError: x")
    text = text_of(replace(report, outcomes=(crashed, *report.outcomes[1:])))
    heading = f"  {crashed.rule.id} crashed: this is a fault of the rule\n    Traceback:\n      Val"
    assert heading in text
    assert text.splitlines()[-1].startswith("a rule crashed, no verdict: ")


def test_the_last_line_counts_in_the_plural_where_there_are_several(reports):
    (finding, *_) = reports["broken"].findings
    findings = [replace(finding, severity=severity, waived=False) for severity in Severity]
    report = replace(reports["broken"], findings=(*findings, findings[-1], findings[0]))
    assert "2 errors; 1 warning; 2 info;" in text_of(report).splitlines()[-1]


def test_sizes_are_shown_in_mebibytes_from_one_on(reports):
    large_report = replace(reports["good"], size=5 << 19, settings="gsgen.toml")
    first, second = text_of(large_report).splitlines()[:2]
    assert first.endswith(", 8 rows, 2.5 MiB")
    assert second.endswith(", settings from gsgen.toml")


def test_model_names_cannot_inject_terminal_codes(reports):
    (finding, *_) = reports["broken"].findings
    injected_finding = replace(
        finding, where=Location("output \x1b[2J\x9b1m\ud800é"), message="a\nb\x07"
    )
    lines = render(replace(reports["broken"], findings=(injected_finding,)))
    assert Line(r"    output \x1b[2J\x9b1m\ud800é: a b\x07") in lines
    assert all(line.text.isprintable() for line in lines)


def test_finding_lists_the_rules_that_it_blocked(reports):
    lines = text_of(reports["foreign"]).splitlines()
    after = lines[lines.index("  GO005 error appearance-declared") :]
    assert after[3] == "    so 1 rule could not be checked: GO008"


@pytest.mark.parametrize("most", [10, 11])
def test_many_blocked_rules_are_counted(reports, monkeypatch, most):
    monkeypatch.setattr("gsgen.contract.reporters.text._MAX_BLOCKED_RULES", most)
    report = reports["foreign"]
    expected_line = "so 11 rules could not be checked, which `gsgen validate -v` lists\n"
    assert (expected_line in text_of(report)) == (most < 11)
    assert "so 11 rules could not be checked: GV001, " in text_of(report, verbose=True)


def test_causes_that_are_no_finding_are_named_all_the_same(reports):
    report = replace(reports["foreign"], findings=())
    lines = text_of(report).splitlines()
    index = lines.index("  GO005 fail: appearance-declared")
    assert lines[index + 1] == "    so 1 rule could not be checked: GO008"


def test_a_cause_in_the_baseline_is_marked_as_known(reports):
    findings = tuple(replace(finding, known=True) for finding in reports["foreign"].findings)
    lines = text_of(replace(reports["foreign"], findings=findings, baseline="b")).splitlines()
    assert "  GO005 fail (known): appearance-declared" in lines


def test_known_findings_are_shown_only_in_verbose_reports(reports):
    first, *remaining = reports["broken"].findings
    findings = (replace(first, known=True), *remaining)
    report = replace(reports["broken"], findings=findings, baseline="old.json")
    assert f"{first.rule} error" not in text_of(report)
    assert "1 known from old.json" in text_of(report).splitlines()[-1]
    assert f"  {first.rule} error {first.slug} (known)\n" in text_of(report, verbose=True)


def test_omitted_locations_are_mentioned(reports):
    first, *_ = reports["broken"].findings
    report = replace(reports["broken"], findings=(replace(first, truncated=True),))
    expected = "    and violations at further locations, which are not listed\n"
    assert expected in text_of(report)


@pytest.mark.parametrize(("total", "heading"), [(1, 1), (5, 5), (6, 4), (40, 4)])
def test_findings_of_one_rule_share_heading_and_hint(reports, total, heading):
    first, *_ = reports["broken"].findings
    findings = tuple(replace(first, where=Location(f"tensor t{i}")) for i in range(total))
    third = replace(first, hint="Something else.")
    report = replace(reports["broken"], findings=(*findings, third))
    text = text_of(report)
    assert text.count(f"  {first.rule} error {first.slug}\n") == 2
    assert text.count(f"    hint: {first.hint[:40]}") == 1
    assert text.count("    tensor t") == heading
    suffix = f"    and at {total - heading} more locations, which `gsgen validate -v` lists\n"
    assert (suffix in text) == (heading < total)
    assert text_of(report, verbose=True).count("    tensor t") == total


def test_quiet_is_a_line_a_model(reports):
    error = ModelUnreadable("is empty", where="a.onnx")
    entries = [reports["good"], Unreadable("a.onnx", error), reports["broken"]]
    lines = [line.text for line in render_all(entries, quiet=True)]
    assert lines == [
        "good.onnx: conforms: 33 rules hold; 3 not applicable",
        "broken.onnx: invalid: 28 rules hold; 2 errors; 1 warning; ignored: GV018; "
        "1 waived; 3 not applicable",
        "3 models: 1 conforms, 1 invalid, 1 unreadable",
    ]


def test_single_model_has_no_summary_line(reports):
    report = reports["good"]
    assert render_all([report]) == render(report)
    assert render_all([report, report])[:-1] == render(report) * 2


def test_a_requested_rule_that_does_not_apply_is_named_with_the_reason(tmp_path):
    path = find("still_sh0").write(tmp_path)
    texts = [line.text for line in render(validate(path, Settings(only=frozenset({"GB050"}))))]
    index = next(k for k, text in enumerate(texts) if text.startswith("  GB050 not applicable: "))
    assert texts[index + 1].strip() == "only for kind trajectory-predictor"
    complete_lines = [line.text for line in render(validate(path, Settings(level=Level.STATIC)))]
    assert not any("GB050" in text for text in complete_lines)
