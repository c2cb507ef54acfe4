"""A level that another package runs: it is prepared once, judged, skipped or crashed."""

from contextlib import contextmanager
from dataclasses import replace

import pytest

from gsgen.contract.rules.catalogue import builtin_rules
from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.level_backend import LevelBackend, LevelContext, LevelUnavailable
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.rule import Registry
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from support.models.small_models import good_rows, save_moving
from support.reports.rules import made_up

CONTEXT = "what the runner prepared"


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return save_moving(tmp_path_factory.mktemp("good") / "good.onnx", good_rows(4))


def report_context(context):
    yield Violation.at("output g", str(context), "something else")


def validate_live(path, prepare, *rules, level=Level.LIVE) -> Report:
    runner = LevelBackend(Level.LIVE, "doing it live", contextmanager(prepare))
    registry = Registry.from_rules([*builtin_rules(), *rules], [runner])
    return validate(path, Settings(level=level), registry=registry)


def of_level(report, level=Level.LIVE):
    return next(outcome for outcome in report.levels if outcome.level is level)


def test_rules_of_the_level_receive_the_prepared_context(good):
    arguments = []

    def prepare(trial):
        arguments.append(len(trial.execution.runs))
        yield LevelContext(context=CONTEXT, items=3, environment={"device": "made up"}, seconds=100)
        arguments.append("closed")

    dependent_rule = made_up("acme/AC001", over="live", needs=("acme/AC002",))
    report = validate_live(
        good, prepare, dependent_rule, made_up("acme/AC002", report_context, over="live")
    )
    assert (arguments[0] > 8, arguments[1:]) == (True, ["closed"])
    assert of_level(report).ran
    assert report.outcome("acme/AC001").reason == "because acme/AC002 does not hold"
    assert report.outcome("acme/AC002").items == 3
    assert report.findings[0].message == f"{CONTEXT}; expected something else"
    assert report.environment["device"] == "made up"
    assert report.runtime_seconds > 100


def test_a_rule_that_cannot_be_judged_here_is_skipped_with_its_reason(good):
    def prepare(trial):
        yield LevelContext(context=CONTEXT, skipped={"acme/AC001": "no such unit"})

    rules = [made_up(f"acme/AC00{k}", report_context, over="live", needs=()) for k in (1, 2)]
    report = validate_live(good, prepare, *rules)
    outcome = report.outcome("acme/AC001")
    assert (outcome.status, outcome.reason) == ("skipped", "no such unit")
    assert report.outcome("acme/AC002").status == "fail"


def test_a_level_that_cannot_run_is_skipped_with_its_reason(good):
    def prepare(trial):
        raise LevelUnavailable("no such device", hint="buy one")
        yield

    rules = [made_up(f"acme/AC00{k}", report_context, over="live", needs=()) for k in (1, 2)]
    report = validate_live(good, prepare, *rules)
    assert (of_level(report).ran, of_level(report).reason) == (False, "no such device: buy one")
    for rule in rules:
        outcome = report.outcome(rule.id)
        assert (outcome.status, outcome.reason) == ("skipped", "no such device: buy one")
    assert report.verdict == "conforms"


def test_crashed_backend_leaves_no_verdict_but_keeps_the_report(good):
    def prepare(trial):
        raise ZeroDivisionError("no luck")
        yield

    report = validate_live(good, prepare, made_up("acme/AC001", over="live"))
    assert report.outcome("acme/AC001").status == "crashed"
    assert report.outcome("acme/AC001").reason.endswith("ZeroDivisionError: no luck")
    assert report.verdict == "internal-error"
    assert report.outcome("GV003").status == "pass"


def test_a_level_that_was_not_asked_for_is_not_prepared(good):
    def prepare(trial):
        raise AssertionError
        yield

    report = validate_live(good, prepare, made_up("acme/AC001", over="live"), level=Level.BEHAVIOUR)
    assert report.outcome("acme/AC001").reason == "level live was not requested"


def test_a_model_that_does_not_run_is_not_run_live(tmp_path):
    rows = good_rows(4)
    path = save_moving(tmp_path / "a.onnx", rows)
    path.write_bytes(path.read_bytes().replace(b'"contract"', b'"contrakt"'))

    def prepare(trial):
        raise AssertionError
        yield

    report = validate_live(path, prepare, made_up("acme/AC001", over="live", needs=("GV025",)))
    reason = "the model did not run to the end on the CPU"
    assert (of_level(report).ran, of_level(report).reason) == (False, reason)
    assert report.outcome("acme/AC001").status == "not-applicable"


def test_level_has_one_backend():
    runner = LevelBackend(Level.LIVE, "doing it live", contextmanager(lambda trial: iter(())))
    with pytest.raises(ValueError, match="validation level live has two backends"):
        Registry.from_rules([], [runner, runner])


@pytest.mark.parametrize(
    ("measured", "target", "status"),
    [
        (None, "core", "not-applicable"),
        (None, "webgpu", "not-applicable"),
        (None, "visionary", "fail"),  # its release of ONNX Runtime is not the one that ran
        (report_context, "webgpu", "fail"),
    ],
)
def test_a_prediction_is_withdrawn_where_the_level_live_disproves_it(
    good, measured, target, status
):
    def prepare(trial):
        yield LevelContext(context=CONTEXT)

    prediction = replace(
        made_up("acme/AC001", report_context, over="model"), settled_by=("acme/AC002",)
    )
    measurement = (
        made_up("acme/AC002", measured, over="live")
        if measured
        else made_up("acme/AC002", over="live")
    )
    runner = LevelBackend(Level.LIVE, "doing it live", contextmanager(prepare))
    registry = Registry.from_rules([*builtin_rules(), prediction, measurement], [runner])
    settings = Settings(level=Level.LIVE, target=load_target(target))
    report = validate(good, settings, registry=registry)
    assert report.outcome("acme/AC001").status == status
    has_finding = any(finding.rule == "acme/AC001" for finding in report.findings)
    assert has_finding is (status == "fail")


def test_a_prediction_stands_where_the_level_live_did_not_run(good):
    prediction = replace(
        made_up("acme/AC001", report_context, over="model"), settled_by=("acme/AC002",)
    )
    rules = [*builtin_rules(), prediction, made_up("acme/AC002", over="live")]
    report = validate(good, Settings(level=Level.LIVE), registry=Registry.from_rules(rules))
    assert report.outcome("acme/AC001").status == "fail"
