import json
from dataclasses import replace

import pytest

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.reporters.json_report import to_dict, to_json
from gsgen.contract.reporters.text import render
from gsgen.contract.validation.baseline import Baseline, read_baseline
from gsgen.contract.validation.finding import Location
from gsgen.contract.validation.report import ResolvedFinding


def resolved_finding(name):
    return ResolvedFinding(
        rule="GV003", slug="opacity-range", fingerprint=name, where=Location("output g"), message=""
    )


@pytest.fixture
def saved(tmp_path):
    def save(*entries):
        path = tmp_path / "baseline.json"
        path.write_text(to_json(entries), "utf-8")
        return path

    return save


def test_listed_finding_does_not_fail_again(reports, saved):
    path = saved(reports["broken"])
    report = read_baseline(path).apply(reports["broken"])
    assert report.verdict == "conforms"
    assert report.baseline == str(path)
    assert all(finding.known or finding.waived for finding in report.findings)
    assert to_dict(report)["counts"]["known"] == 3


def test_new_finding_fails(reports, saved):
    baseline = read_baseline(saved(reports["broken"]))
    first, *remaining = reports["broken"].findings
    moved = replace(first, where=Location("output other"))
    report = baseline.apply(replace(reports["broken"], findings=(moved, *remaining)))
    assert report.verdict == "invalid"
    assert [finding.known for finding in report.findings if not finding.waived] == [
        False,
        True,
        True,
    ]


def test_more_rows_of_a_known_finding_stay_known(reports, saved):
    baseline = read_baseline(saved(reports["broken"]))
    first, *_ = reports["broken"].findings
    worse_finding = replace(first, count=9, total=10, message="9 of 10 rows")
    report = baseline.apply(replace(reports["broken"], findings=(worse_finding,)))
    assert report.findings[0].known


def test_possible_finding_that_becomes_confirmed_is_new(reports, saved):
    first, *_ = reports["broken"].findings
    possible_finding = replace(first, certainty="possible")
    baseline = read_baseline(saved(replace(reports["broken"], findings=(possible_finding,))))
    report = baseline.apply(replace(reports["broken"], findings=(first,)))
    assert not report.findings[0].known


def test_baseline_distinguishes_its_models(reports, saved):
    baseline = read_baseline(saved(*reports.values()))
    assert set(baseline.known) == {"good.onnx", "broken.onnx", "foreign.onnx"}
    renamed = replace(reports["broken"], path="good.onnx")
    assert baseline.apply(renamed).verdict == "invalid"
    relocated_report = replace(reports["broken"], path="/ci/models/broken.onnx")
    assert baseline.apply(relocated_report).verdict == "conforms"


def test_baseline_of_one_model_applies_after_renaming(reports, saved):
    renamed = replace(reports["broken"], path="v2.onnx")
    assert read_baseline(saved(reports["broken"])).apply(renamed).verdict == "conforms"


def test_a_model_that_the_baseline_does_not_list_has_no_known_findings():
    finding, second_model = ({name: resolved_finding(name)} for name in "xy")
    baseline = Baseline("b.json", {"a.onnx": finding, "b.onnx": second_model})
    assert baseline.known_findings("c.onnx") == {}
    assert baseline.known_findings("folder/a.onnx") == finding


def test_fixed_finding_is_listed_with_location_and_in_verdict(reports, saved):
    broken = reports["broken"]
    path = saved(broken)
    first, *remaining = broken.findings
    report = read_baseline(path).apply(replace(broken, findings=tuple(remaining)))
    (listed,) = report.resolved
    assert (listed.rule, listed.where) == (first.rule, first.where)
    assert (listed.message, listed.fingerprint) == (first.message, first.fingerprint)
    text = [line.text for line in render(report)]
    line_number = text.index(f"  {first.rule} resolved: {first.slug}")
    assert text[line_number + 1].startswith(f"    {first.where}: ")
    assert f"; 1 resolved since {path}" in text[-1]
    (entry,) = to_dict(report)["gone"]
    assert entry["rule"] == first.rule
    assert entry["where"]["subject"] == first.where.subject
    assert entry["fingerprint"] == first.fingerprint


def test_unchanged_model_has_no_fixed_findings(reports, saved):
    report = read_baseline(saved(reports["broken"])).apply(reports["broken"])
    assert report.resolved == ()
    assert to_dict(report)["gone"] == []
    assert "gone" not in to_dict(reports["broken"])
    assert not any(" gone" in line.text for line in render(report))


def test_unchecked_rule_is_not_counted_as_fixed(reports, saved):
    broken = reports["broken"]
    first, *remaining = broken.findings
    skipped = tuple(
        replace(finding, status="skipped", reason="no time")
        if finding.rule.id == first.rule
        else finding
        for finding in broken.outcomes
    )
    later_report = replace(broken, findings=tuple(remaining), outcomes=skipped)
    assert read_baseline(saved(broken)).apply(later_report).resolved == ()


def test_waived_finding_is_not_counted_as_fixed(reports, saved):
    broken = reports["broken"]
    waived = tuple(replace(finding, waived=True) for finding in broken.findings)
    report = read_baseline(saved(broken)).apply(replace(broken, findings=waived))
    assert report.resolved == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the baseline is not JSON: Expecting value"),
        ("[" * 100_000, "the baseline is not JSON: "),
        (
            "[]",
            "the baseline is not a validation report: no schema; expected schema 'gsgen-report/1'",
        ),
        ('{"version": "2.1.0"}', "the baseline is not a validation report: no schema"),
        (
            '{"schema": "gsgen-report/2"}',
            "the baseline is not a validation report: schema 'gsgen-report/2'",
        ),
        ('{"schema": "gsgen-report/1", "reports": 3}', "the baseline is not a validation report: "),
    ],
)
def test_invalid_baseline_names_the_command_that_writes_one(tmp_path, text, message):
    path = tmp_path / "b.json"
    path.write_text(text)
    with pytest.raises(ConfigInvalid) as caught:
        read_baseline(path)
    assert str(caught.value).startswith(f"{path}")
    assert message in str(caught.value)
    assert "gsgen validate MODEL --format json" in str(caught.value)


def test_unreadable_baseline_is_refused(tmp_path):
    with pytest.raises(ConfigInvalid, match="the baseline cannot be read: Is a directory"):
        read_baseline(tmp_path)
    (tmp_path / "b.json").write_bytes(b"\xff")
    with pytest.raises(ConfigInvalid, match="the baseline is not JSON: 'utf-8' codec"):
        read_baseline(tmp_path / "b.json")


def test_a_finding_without_a_fingerprint_is_named_by_its_place(reports, tmp_path):
    document = json.loads(to_json([reports["broken"]]))
    del document["findings"][1]["fingerprint"]
    path = tmp_path / "b.json"
    path.write_text(json.dumps(document))
    with pytest.raises(ConfigInvalid, match="the baseline is not a validation report: "):
        read_baseline(path)
