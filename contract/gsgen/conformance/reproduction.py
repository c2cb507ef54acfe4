"""Reproduce one failure: judge one rule, by one probe where that is enough, and show the rows."""

__all__ = ["NotJudged", "Reproduction", "Row", "reproduce"]

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from gsgen.conformance.evidence import suspects
from gsgen.conformance.required_rules import needed_by
from gsgen.conformance.rerun import ONE_PROBE, Replay, find_probes, plan_for, replay, save
from gsgen.contract.errors import ConfigInvalid, GsgenError
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.finding import Finding
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.rule import Rule
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate


class NotJudged(GsgenError):
    """A rule that cannot be judged, so that nobody knows whether it is broken."""


@dataclass(frozen=True, slots=True)
class Row:
    """A row that breaks the rule: its number, its probe, its ten packed values and its colour."""

    number: int
    probe: str
    packed: tuple[float, ...]
    color: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Reproduction:
    """What came of judging one rule again.

    Attributes:
        rule: The rule.
        findings: What it found; empty where it holds now.
        probes: Labels of the probes that it saw alone; empty where it saw all.
        rows: The first offending rows.
    """

    rule: Rule
    findings: tuple[Finding, ...]
    probes: tuple[str, ...]
    rows: tuple[Row, ...]


def reproduce(
    path: Path,
    rule: Rule,
    settings: Settings,
    *,
    probe: str | None = None,
    dump: Path | None = None,
) -> Reproduction:
    """Judge ``rule`` again, by ``probe`` alone if it is given.

    Args:
        path: The ONNX file.
        rule: The rule.
        settings: Target, limits and seed of the first time; the level is the rule's own.
        probe: Label or number of a probe.
        dump: Where to write inputs and outputs of the offending probes.

    Raises:
        ModelUnreadable: The file is not an ONNX model at all.
        NotJudged: The rule does not apply, or something it needs does not hold.
        ConfigInvalid: The rule does not look at single probes, or there is no such probe.
    """
    if rule.scope != "report":  # which depends on all that was found
        settings = replace(settings, level=rule.level)
    if probe is None:
        report = _judge(path, rule, settings)
        findings = tuple(finding for finding in report.findings if finding.rule == rule.id)
        return Reproduction(rule, findings, (), _look(path, rule, settings, findings, dump))
    if rule.scope not in ONE_PROBE:
        message = f"{rule.id} does not look at single probes but at {_SUBJECTS[rule.scope]}"
        raise ConfigInvalid(message, where="--probe", hint="Leave --probe out.")
    _judge(path, rule, replace(settings, level=Level.STATIC))
    subject, plan = plan_for(path, settings)
    probes = find_probes(plan.probes, probe)
    labels = tuple(probe.label for probe in probes)
    with replay(subject, probes, settings) as rerun:
        if rerun.execution.fault and rule.scope != "execution":
            raise NotJudged(rerun.execution.fault.message, where=f"{path} does not run")
        _save(rerun, dump)
        for number in range(len(probes)):
            findings = rerun.findings(rule, number)
            if findings:
                return Reproduction(rule, findings, labels, _rows(rerun, number, findings))
    return Reproduction(rule, (), labels, ())


_SUBJECTS = {"model": "the file", "runs": "several runs compared", "report": "the whole report"}


def _judge(path: Path, rule: Rule, settings: Settings) -> Report:
    """Judge ``rule`` and what it needs, as far as the level goes."""
    registry = installed_rules()
    part = registry if rule.scope == "report" else needed_by(rule, registry)
    report = validate(path, settings, registry=part)
    outcome = report.outcome(rule.id)
    blocked = [outcome.rule.id for outcome in report.outcomes if outcome.status in ("fail", "crashed")]
    if settings.level < rule.level and outcome.status == "skipped":
        needs = [name for name in blocked if name in part.rules and name != rule.id]
        reason = f"because {needs[0]} does not hold" if needs else ""
    else:
        reason = "" if outcome.status in ("pass", "fail") else outcome.reason
    if reason:
        hint = f"`gsgen validate {shlex.quote(str(path))}` says more."
        raise NotJudged(reason, where=f"{rule.id} was not judged", hint=hint)
    return report


def _look(
    path: Path,
    rule: Rule,
    settings: Settings,
    findings: tuple[Finding, ...],
    dump: Path | None,
) -> tuple[Row, ...]:
    """Run the probes that the findings speak of once more, to show rows and to keep them."""
    if not findings or rule.scope in ("model", "report") or not (dump or rule.scope == "rows"):
        return ()
    subject, plan = plan_for(path, settings)
    with replay(subject, suspects(plan, findings), settings) as rerun:
        _save(rerun, dump)
        labels = [probe.label for probe in rerun.probes]
        label = findings[0].examples[0].probe if findings[0].examples else ""
        return _rows(rerun, labels.index(label), findings) if label in labels else ()


def _save(rerun: Replay, dump: Path | None) -> None:
    if dump is not None:
        runs = [(probe, rerun.outputs(number)) for number, probe in enumerate(rerun.probes)]
        save(dump, runs)


def _rows(rerun: Replay, number: int, findings: Sequence[Finding]) -> tuple[Row, ...]:
    """Return the rows that findings show, as the probe gave them."""
    emission, label = rerun.emission(number), rerun.probes[number].label
    if emission.gaussians is None:
        return ()
    shown = [e.row for finding in findings for e in finding.examples if e.probe in ("", label)]
    rows = []
    for row in dict.fromkeys(row for row in shown if row is not None):
        packed = tuple(emission.gaussians[row].tolist())
        color = () if emission.appearance is None else emission.appearance[row].tolist()
        rows.append(Row(row, label, packed, tuple(color)))
    return tuple(rows)
