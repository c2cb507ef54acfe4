import json
from dataclasses import replace

import pytest

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.reporters.json_report import to_dict, to_json
from gsgen.contract.reporters.text import render
from gsgen.contract.validation.baseline import Baseline, read_baseline
from gsgen.contract.validation.finding import Location
from gsgen.contract.validation.report import Gone


def gone(name):
    return Gone("GV003", "opacity-range", name, Location("output g"), "")


@pytest.fixture
def saved(tmp_path):
    def save(*entries):
        path = tmp_path / "baseline.json"
        path.write_text(to_json(entries), "utf-8")
        return path

    return save


def test_what_the_baseline_lists_does_not_fail_again(reports, saved):
    path = saved(reports["broken"])
    report = read_baseline(path).applied(reports["broken"])
    assert report.verdict == "conforms"
    assert report.baseline == str(path)
    assert all(one.known or one.waived for one in report.findings)
    assert to_dict(report)["counts"]["known"] == 3


def test_what_is_new_fails(reports, saved):
    baseline = read_baseline(saved(reports["broken"]))
    first, *rest = reports["broken"].findings
    moved = replace(first, where=Location("output other"))
    report = baseline.applied(replace(reports["broken"], findings=(moved, *rest)))
    assert report.verdict == "invalid"
    assert [one.known for one in report.findings if not one.waived] == [False, True, True]


def test_more_rows_of_the_same_are_known(reports, saved):
    baseline = read_baseline(saved(reports["broken"]))
    first, *_ = reports["broken"].findings
    worse = replace(first, count=9, total=10, message="9 of 10 rows")
    report = baseline.applied(replace(reports["broken"], findings=(worse,)))
    assert report.findings[0].known


def test_a_guess_that_is_proven_is_new(reports, saved):
    first, *_ = reports["broken"].findings
    guess = replace(first, certainty="possible")
    baseline = read_baseline(saved(replace(reports["broken"], findings=(guess,))))
    report = baseline.applied(replace(reports["broken"], findings=(first,)))
    assert not report.findings[0].known


def test_the_models_of_a_baseline_are_told_apart(reports, saved):
    baseline = read_baseline(saved(*reports.values()))
    assert set(baseline.known) == {"good.onnx", "broken.onnx", "foreign.onnx"}
    renamed = replace(reports["broken"], path="good.onnx")
    assert baseline.applied(renamed).verdict == "invalid"
    elsewhere = replace(reports["broken"], path="/ci/models/broken.onnx")
    assert baseline.applied(elsewhere).verdict == "conforms"


def test_a_baseline_of_one_model_holds_whatever_it_is_called_now(reports, saved):
    renamed = replace(reports["broken"], path="v2.onnx")
    assert read_baseline(saved(reports["broken"])).applied(renamed).verdict == "conforms"


def test_a_model_that_the_baseline_does_not_list_has_no_known_findings():
    one, other = ({name: gone(name)} for name in "xy")
    baseline = Baseline("b.json", {"a.onnx": one, "b.onnx": other})
    assert baseline.of("c.onnx") == {}
    assert baseline.of("folder/a.onnx") == one


def test_what_is_gone_is_listed_with_its_place_and_in_the_verdict(reports, saved):
    broken = reports["broken"]
    path = saved(broken)
    first, *rest = broken.findings
    report = read_baseline(path).applied(replace(broken, findings=tuple(rest)))
    (listed,) = report.gone
    assert (listed.rule, listed.where) == (first.rule, first.where)
    assert (listed.message, listed.fingerprint) == (first.message, first.fingerprint)
    text = [line.text for line in render(report)]
    at = text.index(f"  {first.rule} gone: {first.slug}")
    assert text[at + 1].startswith(f"    {first.where}: ")
    assert f"; 1 gone since {path}" in text[-1]
    (entry,) = to_dict(report)["gone"]
    assert entry["rule"] == first.rule
    assert entry["where"]["subject"] == first.where.subject
    assert entry["fingerprint"] == first.fingerprint


def test_nothing_is_gone_where_nothing_changed(reports, saved):
    report = read_baseline(saved(reports["broken"])).applied(reports["broken"])
    assert report.gone == ()
    assert to_dict(report)["gone"] == []
    assert "gone" not in to_dict(reports["broken"])
    assert not any(" gone" in line.text for line in render(report))


def test_what_was_not_judged_this_time_is_not_gone(reports, saved):
    broken = reports["broken"]
    first, *rest = broken.findings
    skipped = tuple(
        replace(one, status="skipped", reason="no time")
        if one.rule.id == first.rule
        else one
        for one in broken.outcomes
    )
    later = replace(broken, findings=tuple(rest), outcomes=skipped)
    assert read_baseline(saved(broken)).applied(later).gone == ()


def test_what_is_waived_now_is_not_gone(reports, saved):
    broken = reports["broken"]
    waived = tuple(replace(one, waived=True) for one in broken.findings)
    report = read_baseline(saved(broken)).applied(replace(broken, findings=waived))
    assert report.gone == ()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is not JSON: Expecting value"),
        ("[" * 100_000, "is not JSON: "),
        ("[]", "is not a report: no schema; wanted 'gsgen-report/1'"),
        ('{"version": "2.1.0"}', "is not a report: no schema"),
        ('{"schema": "gsgen-report/2"}', "is not a report: schema 'gsgen-report/2'"),
        ('{"schema": "gsgen-report/1", "reports": 3}', "is not a report: "),
    ],
)
def test_what_is_no_report_is_refused_with_the_command_that_makes_one(tmp_path, text, said):
    path = tmp_path / "b.json"
    path.write_text(text)
    with pytest.raises(ConfigInvalid) as caught:
        read_baseline(path)
    assert str(caught.value).startswith(f"{path}")
    assert said in str(caught.value)
    assert "gsgen validate MODEL --format json" in str(caught.value)


def test_what_cannot_be_read_is_refused(tmp_path):
    with pytest.raises(ConfigInvalid, match="cannot be read: Is a directory"):
        read_baseline(tmp_path)
    (tmp_path / "b.json").write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigInvalid, match="is not JSON: 'utf-8' codec"):
        read_baseline(tmp_path / "b.json")


def test_a_finding_without_a_fingerprint_is_named_by_its_place(reports, tmp_path):
    document = json.loads(to_json([reports["broken"]]))
    del document["findings"][1]["fingerprint"]
    path = tmp_path / "b.json"
    path.write_text(json.dumps(document))
    with pytest.raises(ConfigInvalid, match="is not a report: "):
        read_baseline(path)
