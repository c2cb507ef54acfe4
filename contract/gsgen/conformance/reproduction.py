"""Reproduces a broken rule: checks it on one set of inputs, returns the Gaussians that break it."""

__all__ = ["Reproduction", "Row", "RuleCrashed", "RuleNotChecked", "reproduce"]

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from gsgen.conformance.evidence import suspect_probes
from gsgen.conformance.rerun import (
    SINGLE_PROBE_SCOPES,
    Replay,
    find_probes,
    plan_model_runs,
    rerun_probes,
    save_runs,
)
from gsgen.contract._safe_text import for_shell
from gsgen.contract.errors import ConfigInvalid, ExitCode, GsgenError
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.finding import Finding
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.rule import Registry, Rule
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate


class RuleNotChecked(GsgenError):
    """Raised if a rule cannot be checked, so that it is unknown whether the model breaks it."""


class RuleCrashed(RuleNotChecked):
    """Raised if a rule raises an exception: a fault of the rule, not of the model."""

    exit_code = ExitCode.INTERNAL


@dataclass(frozen=True, slots=True)
class Row:
    """A packed row that breaks a validation rule: its index, test inputs, ten values and colour."""

    number: int
    probe: str
    packed: tuple[float, ...]
    color: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Reproduction:
    """The result of checking one validation rule on one model again.

    Attributes:
        rule: The rule.
        findings: The findings of the rule; empty if it holds now.
        probes: The labels of the probes that were checked; empty for all.
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
    """Check one rule on a model again, with a single probe (set of test inputs) if requested.

    Args:
        path: The ONNX file.
        rule: The rule.
        settings: The target, limits and seed of the first check; the level is that of the rule.
        probe: The label or number of a probe.
        dump: The output file for inputs and outputs of the failing probes.

    Raises:
        ModelUnreadable: The file is not an ONNX model at all.
        NotJudged: The rule does not apply, or a rule that it needs does not hold.
        RuleCrashed: The rule raised an exception.
        ConfigInvalid: The rule does not check single probes, or the probe does not exist.
    """
    if rule.scope != "report":  # such a rule depends on all findings
        settings = replace(settings, level=rule.level)
    if probe is None:
        report = _check_rule(path, rule, settings)
        findings = tuple(finding for finding in report.findings if finding.rule == rule.id)
        return Reproduction(
            rule, findings, (), _rerun_and_read_rows(path, rule, settings, findings, dump)
        )
    if rule.scope not in SINGLE_PROBE_SCOPES:
        message = f"{rule.id} does not check single probes but {_SCOPE_TEXTS[rule.scope]}"
        raise ConfigInvalid(message, where="--probe", hint="Leave --probe out.")
    _check_rule(path, rule, replace(settings, level=Level.STATIC))
    subject, plan = plan_model_runs(path, settings)
    probes = find_probes(plan.probes, probe)
    labels = tuple(probe.label for probe in probes)
    with rerun_probes(subject, probes, settings) as rerun:
        if rerun.execution.fault and rule.scope != "execution":
            raise RuleNotChecked(rerun.execution.fault.message, where=f"{path} does not run")
        _save_dump(rerun, dump)
        for number in range(len(probes)):
            findings = rerun.findings(rule, number)
            if findings:
                return Reproduction(rule, findings, labels, _rows(rerun, number, findings))
    return Reproduction(rule, (), labels, ())


_SCOPE_TEXTS = {"model": "the file", "runs": "several runs compared", "report": "the whole report"}


def _check_rule(path: Path, rule: Rule, settings: Settings) -> Report:
    """Check one rule together with the rules that it depends on; return the validation report."""
    registry = installed_rules()
    needed_rules = Registry(
        registry.with_needs([rule.id]).rules
    )  # without backends of further levels
    rule_registry = registry if rule.scope == "report" else needed_rules
    report = validate(path, settings, registry=rule_registry)
    outcome = report.outcome(rule.id)
    failing_rules = [
        outcome.rule.id for outcome in report.outcomes if outcome.status in ("fail", "crashed")
    ]
    if settings.level < rule.level and outcome.status == "skipped":
        needs = [name for name in failing_rules if name in rule_registry.rules and name != rule.id]
        reason = f"because {needs[0]} does not hold" if needs else ""
    else:
        reason = "" if outcome.status in ("pass", "fail") else outcome.reason
    if reason:
        hint = f"`gsgen validate {for_shell(str(path))}` reports the reason."
        error_type = RuleCrashed if outcome.status == "crashed" else RuleNotChecked
        raise error_type(reason, where=f"{rule.id} was not checked", hint=hint)
    return report


def _rerun_and_read_rows(
    path: Path, rule: Rule, settings: Settings, findings: tuple[Finding, ...], dump: Path | None
) -> tuple[Row, ...]:
    """Rerun a model on inputs that break a rule; save the runs, and return invalid Gaussians."""
    if not findings or rule.scope in ("model", "report") or not (dump or rule.scope == "rows"):
        return ()
    subject, plan = plan_model_runs(path, settings)
    with rerun_probes(subject, suspect_probes(plan, findings), settings) as rerun:
        _save_dump(rerun, dump)
        labels = [probe.label for probe in rerun.probes]
        label = findings[0].examples[0].probe if findings[0].examples else ""
        return _rows(rerun, labels.index(label), findings) if label in labels else ()


def _save_dump(rerun: Replay, dump: Path | None) -> None:
    if dump is not None:
        runs = [(probe, rerun.outputs(number)) for number, probe in enumerate(rerun.probes)]
        save_runs(dump, runs)


def _rows(rerun: Replay, number: int, findings: Sequence[Finding]) -> tuple[Row, ...]:
    """Return the Gaussians that findings report as invalid, read from one run of the model."""
    emission, label = rerun.emission(number), rerun.probes[number].label
    if emission.gaussians is None:
        return ()
    row_indices = [
        e.row for finding in findings for e in finding.examples if e.probe in ("", label)
    ]
    rows = []
    for row in dict.fromkeys(row for row in row_indices if row is not None):
        packed = tuple(emission.gaussians[row].tolist())
        color = () if emission.appearance is None else emission.appearance[row].tolist()
        rows.append(Row(row, label, packed, tuple(color)))
    return tuple(rows)
