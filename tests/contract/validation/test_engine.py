from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import TensorProto

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.clouds import still
from gsgen.contract.errors import ModelUnreadable
from gsgen.contract.probing.sandbox import execute
from gsgen.contract.process.limits import Limits
from gsgen.contract.reporters.text import render
from gsgen.contract.spec.manifest import Bounds
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation import engine
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.report import exit_code
from gsgen.contract.validation.rule import Registry
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.tiles.validation.rules import all_rules
from support.models.small_models import (
    good_rows,
    manifest_of,
    model,
    moving,
    save,
    save_moving,
    weight,
)
from support.reports.rules import breaking, crashing, made_up

ALL = {level: Settings(level=level) for level in Level}


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return save_moving(tmp_path_factory.mktemp("good") / "good.onnx", good_rows(8))


def with_rules(*rules):
    return Registry.from_rules([*all_rules().rules.values(), *rules])


def statuses(report):
    return {outcome.rule.id: outcome.status for outcome in report.outcomes}


def levels(report):
    return {finding.level: (finding.ran, finding.reason) for finding in report.levels}


def test_a_good_model_conforms_and_every_rule_is_accounted_for(good):
    report = validate(good)
    assert (report.verdict, report.findings) == ("conforms", ())
    models = all_rules().of_files("model")
    assert list(statuses(report)) == list(models.rules)
    assert len(models.rules) < len(all_rules().rules)
    checked_statuses = [
        finding.status for finding in report.outcomes if finding.rule.level <= report.level
    ]
    assert set(checked_statuses) == {"pass", "not-applicable"}
    assert (report.path, report.size) == (str(good), good.stat().st_size)
    assert (report.kind, report.name, report.contract) == ("gaussian-generator", "moving", "1.0")
    assert (report.capacity, report.level) == (8, Level.BEHAVIOUR)
    assert report.probes[:2] == ("all inputs zero", "time=0")
    assert len(report.probes) == 9
    assert set(report.environment) == {"onnx", "onnxruntime"}
    assert 0 < report.runtime_seconds < report.seconds
    assert exit_code([report]) == 0


@pytest.mark.parametrize("version", ["1.0", "1.1", "1.2", "1.7"])
def test_a_report_names_the_contract_that_the_manifest_declares(version, tmp_path):
    def declare(document):
        document["contract"] = version

    path = tmp_path / "m.onnx"
    still().edit_manifest(declare).write(path)
    assert validate(path, Settings(level=Level.STATIC)).contract == version


@pytest.mark.parametrize("name", ["absent.onnx", "."])
def test_non_model_file_raises(tmp_path, name):
    with pytest.raises(ModelUnreadable):
        validate(tmp_path / name)


def test_a_static_run_does_not_run_the_model(good):
    report = validate(good, ALL[Level.STATIC])
    assert levels(report) == {Level.STATIC: (True, "")}
    assert report.probes == ()
    assert "onnxruntime" not in report.environment
    for outcome in report.outcomes:
        if outcome.rule.level > Level.STATIC:
            assert outcome.status == "skipped"
            assert outcome.reason == f"level {outcome.rule.level.word} was not requested"


def test_a_run_for_values_does_not_compare_runs(good):
    report = validate(good, ALL[Level.VALUES])
    assert list(levels(report)) == [Level.STATIC, Level.VALUES]
    assert report.outcome("GV003").status == "pass"
    assert report.outcome("GB001").status == "skipped"


def test_levels_that_nothing_checks_are_reported_as_not_run(good):
    report = validate(
        good,
        ALL[Level.RENDER],
        registry=with_rules(
            made_up("acme/AC001", level=Level.LIVE), made_up("acme/AC002", level=Level.RENDER)
        ),
    )
    assert [completed for completed, _ in levels(report).values()] == [
        True,
        True,
        True,
        False,
        False,
    ]
    assert levels(report)[Level.LIVE][1].startswith("no installed package checks it")
    assert "gsgen[runtime]" in levels(report)[Level.RENDER][1]
    for name, level in {"acme/AC001": "live", "acme/AC002": "render"}.items():
        assert report.outcome(name).status == "skipped"
        assert report.outcome(name).reason == f"level {level} did not run"
    assert report.verdict == "conforms"


def test_a_rule_that_crashes_leaves_no_verdict_but_the_others_are_judged(good):
    scopes = ("model", "execution", "emission", "rows", "runs")
    rules = [
        made_up(f"acme/AC00{index}", crashing, over=scope) for index, scope in enumerate(scopes)
    ]
    report = validate(good, registry=with_rules(*rules))
    assert report.verdict == "internal-error"
    assert exit_code([report]) == 3
    for rule in rules:
        assert report.outcome(rule.id).status == "crashed"
        assert report.outcome(rule.id).reason.endswith("ZeroDivisionError: no luck")
    assert report.outcome("GV003").status == "pass"
    assert report.outcome("GB002").status == "pass"


def test_a_rule_is_judged_after_those_it_needs_whatever_their_order(good):
    last = made_up("acme/AC001", needs=("acme/AC002",))
    middle = made_up("acme/AC002", needs=("acme/AC003",))
    first = made_up("acme/AC003", breaking)
    report = validate(good, ALL[Level.STATIC], registry=with_rules(last, middle, first))
    assert report.outcome("acme/AC003").status == "fail"
    for name in ("acme/AC001", "acme/AC002"):
        assert report.outcome(name).reason == "because acme/AC003 does not hold"


def test_a_registry_may_lack_our_own_rules(good):
    rules = [made_up("acme/AC001", breaking), made_up("acme/AC002", over="rows")]
    report = validate(good, registry=Registry.from_rules(rules))
    assert statuses(report) == {"acme/AC001": "fail", "acme/AC002": "skipped"}
    reason = "the model was not run because no rule GV025 is installed"
    assert levels(report)[Level.VALUES] == (False, reason)


@pytest.fixture(scope="module")
def broken(tmp_path_factory):
    rows = good_rows(20)
    rows[3:5, 3] = 2
    return save_moving(tmp_path_factory.mktemp("broken") / "broken.onnx", rows)


def test_a_broken_rule_makes_a_model_invalid(broken):
    report = validate(broken)
    assert report.verdict == "invalid"
    (finding,) = report.findings
    assert (finding.rule, finding.count, finding.total) == ("GV003", 16, 160)
    assert [example.row for example in finding.examples] == [3, 4, 3, 4, 3]
    assert {example.probe for example in finding.examples} <= set(report.probes)


@pytest.mark.parametrize(
    ("options", "verdict"),
    [
        ({"ignore": frozenset({"GV003"})}, "conforms"),
        ({"severities": {"GV003": Severity.WARNING}}, "conforms"),
        ({"severities": {"GV003": Severity.WARNING}, "fail_on": Severity.WARNING}, "invalid"),
        ({"fail_on": Severity.INFO, "ignore": frozenset({"GV003"})}, "conforms"),
    ],
)
def test_settings_decide_what_counts(broken, options, verdict):
    report = validate(broken, Settings(level=Level.VALUES, **options))
    assert report.verdict == verdict
    assert [finding.waived for finding in report.findings] == ["ignore" in options]


def test_possible_finding_never_fails(good):
    def perhaps(_):
        yield Violation.at("output g", "odd", "even", certainty="possible")

    rule = made_up("acme/AC001", perhaps)
    strictest = Settings(level=Level.STATIC, fail_on=Severity.INFO)
    report = validate(good, strictest, registry=with_rules(rule))
    assert [finding.certainty for finding in report.findings] == ["possible"]
    assert report.verdict == "conforms"


def test_progress_messages_are_short(good):
    texts = []
    validate(good, progress=texts.append)
    assert texts == [
        "reading good.onnx",
        "running 27 probes in ONNX Runtime",
        "checking values",
        "comparing runs",
    ]


def test_refused_model_is_not_run_and_the_reason_is_given(tmp_path):
    path = save(tmp_path / "a.onnx", moving(good_rows(4)))
    proto = moving(good_rows(4))
    proto.metadata_props.add(key="gsgen.manifest", value="{")
    save(path, proto)
    report = validate(path)
    assert report.outcome("GM002").status == "fail"
    reason = "the model was not run because GM002 does not hold"
    assert levels(report)[Level.VALUES] == levels(report)[Level.BEHAVIOUR] == (False, reason)
    assert report.outcome("GV003").reason == "because GM002 does not hold"
    assert (report.kind, report.name, report.contract) == ("", "", "")


def test_model_without_a_manifest_is_checked_by_an_inferred_one(tmp_path):
    path = save(tmp_path / "a.onnx", moving(good_rows(4)))
    report = validate(path)
    assert report.outcome("GM001").status == "fail"
    assert report.outcome("GV003").status == "pass"
    assert (report.verdict, report.name) == ("invalid", "")
    assert validate(path, Settings(level=Level.STATIC, strict=True)).verdict == "invalid"


def test_a_model_that_runs_out_of_time_is_a_finding(tmp_path):
    text = """
    endless (float[1] time) => (float[1] y)
    <int64 turns = {4611686018427387904}, bool yes = {1}> {
        y = Loop (turns, yes, time) <body = b (int64 i, bool c, float[1] v) => (bool d, float[1] w) {
            d = Identity (c)
            w = Mul (v, v)
        }>
    }
    """
    path = save(tmp_path / "a.onnx", model(text))
    report = validate(path, Settings(limits=Limits(seconds=1)))
    assert report.outcome("GS004").status == "fail"
    assert report.outcome("GV025").reason == "because GS004 does not hold"
    (finding,) = (finding for finding in report.findings if finding.rule == "GS004")
    assert finding.message.startswith("still running after 1 s; expected at most 1 s and ")


def test_equal_output_of_several_probes_is_checked_once(tmp_path):
    proto = moving(good_rows(8))
    proto.graph.initializer[0].CopyFrom(weight("step", np.zeros((1, 10), np.float32)))
    report = validate(save(tmp_path / "a.onnx", proto, manifest_of(8)), ALL[Level.VALUES])
    assert report.outcome("GV003").items == 8


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3e38, 1e-45])
@pytest.mark.parametrize("column", [0, 3, 4, 5])
def test_no_number_that_a_model_emits_stops_a_rule(tmp_path, value, column):
    rows = good_rows(40)
    rows[7:9, column] = value
    report = validate(save_moving(tmp_path / "a.onnx", rows))
    assert report.verdict in ("conforms", "invalid")


@pytest.mark.parametrize("count", [np.nan, np.inf, 2.5])
def test_a_count_that_is_no_whole_number_is_a_finding(tmp_path, count):
    proto = moving(good_rows(4))
    proto.graph.initializer[-1].CopyFrom(weight("live", np.array([count], np.float32)))
    proto.graph.output[2].type.tensor_type.elem_type = TensorProto.FLOAT
    report = validate(save(tmp_path / "a.onnx", proto, manifest_of(4)))
    assert report.outcome("GO011").status == "fail"
    assert report.outcome("GV025").status == "pass"
    assert report.verdict == "invalid"


def test_a_manifest_of_enormous_numbers_stops_nothing(tmp_path):
    manifest = manifest_of(4)
    clock = replace(manifest.inputs[0], range=(-1.7e308, 1.7e308))
    bounds = Bounds((-1.7e308,) * 3, (1.7e308,) * 3)
    manifest = replace(manifest, inputs=(clock,), bounds=bounds)
    report = validate(save(tmp_path / "a.onnx", moving(good_rows(4)), manifest))
    assert report.verdict in ("conforms", "invalid")


@settings(max_examples=150)
@given(
    edits=st.lists(st.tuples(st.integers(0, 2**16), st.integers(0, 255)), min_size=1, max_size=3)
)
def test_no_damage_to_a_file_makes_a_rule_crash(tmp_path_factory, edits):
    path = tmp_path_factory.getbasetemp() / "damaged.onnx"
    content = bytearray(save_moving(path, good_rows(2)).read_bytes())
    for offset, value in edits:
        content[offset % len(content)] = value
    path.write_bytes(content)
    try:
        report = validate(path, ALL[Level.STATIC])
    except ModelUnreadable:
        return
    assert report.verdict != "internal-error"


def test_a_nan_that_every_probe_has_belongs_to_gv001_and_not_to_zero_inputs(tmp_path):
    base = find("time_is_baked").draw()
    broken = base.with_weights(
        center=np.where(np.arange(15).reshape(5, 3) == 4, np.nan, base.weights["center"]).astype(
            "f4"
        )
    )
    path = tmp_path / "m.onnx"
    broken.write(path)
    rules = {finding.rule for finding in validate(path).findings}
    assert "GV001" in rules
    assert "GI009" not in rules


def no_extras(monkeypatch, missing_resource):
    """Let every extra probe be one that a limit ended, as time does on a slow machine."""

    @contextmanager
    def shortened(path, names, probes, limits, *arguments, **options):
        with execute(path, names, probes, limits, *arguments, **options) as execution:
            runs = tuple(
                replace(run, sample=-1, missing_resource=missing_resource)
                if probes[run.probe].extra
                else run
                for run in execution.runs
            )
            yield replace(execution, runs=runs)

    monkeypatch.setattr(engine, "execute", shortened)


def test_a_rule_whose_probes_did_not_run_is_skipped_and_not_passed(good, monkeypatch):
    no_extras(monkeypatch, "time")
    report = validate(good)
    outcome = report.outcome("GB013")
    assert outcome.status == "skipped"
    assert "of its probes did not run, 'time=0 with zero time' first: " in outcome.reason
    assert outcome.reason.endswith(
        "50% of the 120 s of processor time were used up (see --timeout)"
    )
    assert report.outcome("GB010").status == "skipped"
    assert report.outcome("GI010").reason == "because GB013 was not checked"
    assert report.outcome("GB001").status == "pass"  # needs no extra probe
    assert "  GB013 skipped: edges-finite" in [line.text for line in render(report)]
    assert report.verdict == "conforms"


def test_probes_that_lack_memory_say_so(good, monkeypatch):
    no_extras(monkeypatch, "memory")
    outcome = validate(good).outcome("GB013")
    assert outcome.status == "skipped"
    assert outcome.reason.endswith("first: the memory limit was reached (see --memory)")


def test_a_rule_that_fails_by_the_probes_that_did_run_fails(good, monkeypatch):
    no_extras(monkeypatch, "time")

    def find(behaviour):
        assert behaviour.trial_runs("edges") == []
        yield Violation.at("output g", "nine", "ten")

    rule = made_up("acme/AC001", find, over="runs")
    assert validate(good, registry=with_rules(rule)).outcome("acme/AC001").status == "fail"


def test_only_the_child_is_granted_memory_for_weights(tmp_path, monkeypatch):
    memory_limits = []

    @contextmanager
    def noted(path, names, probes, limits, *arguments, **options):
        memory_limits.append(limits.memory)
        with execute(path, names, probes, limits, *arguments, **options) as execution:
            yield execution

    monkeypatch.setattr(engine, "execute", noted)
    path = save_moving(tmp_path / "a.onnx", good_rows(8))
    limits = Limits(memory=512 << 20)
    report = validate(path, Settings(level=Level.VALUES, limits=limits))
    assert memory_limits == [limits.memory + 5 * path.stat().st_size]
    assert report.outcome("GS002").status == "pass"


def test_a_weight_beyond_the_limit_is_a_finding_however_large_its_file_is(tmp_path):
    path = find("huge_weight").write(tmp_path)
    report = validate(path, Settings(level=Level.STATIC))
    assert report.outcome("GS002").status == "fail"
    (finding,) = (finding for finding in report.findings if finding.rule == "GS002")
    assert finding.message.endswith("expected 2048 MiB at most")
    raised = Settings(level=Level.STATIC, limits=Limits(memory=4 << 30))
    assert validate(path, raised).outcome("GS002").status == "pass"
