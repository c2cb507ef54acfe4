"""Collects evidence of broken rules: a command that reproduces each, with inputs and outputs."""

__all__ = ["Evidence", "EvidenceDumps", "collect_evidence", "suspect_probes"]

import os
import re
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from gsgen.conformance.cases import Case
from gsgen.conformance.rerun import (
    SINGLE_PROBE_SCOPES,
    Arrays,
    Replay,
    plan_model_runs,
    rerun_probes,
    save_runs,
)
from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.probing.probe_plan import Plan
from gsgen.contract.probing.probes import Probe
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.units import MEBIBYTE, format_mebibytes
from gsgen.contract.validation.finding import Finding
from gsgen.contract.validation.settings import Settings

_MAX_RUNS = 4

Runs = list[tuple[Probe, Arrays]]


@dataclass(frozen=True, slots=True)
class Evidence:
    """Evidence of one failure: the command and the test inputs that reproduce it, saved files.

    Attributes:
        command: The command line; it exits 1 as long as the rule is broken.
        dump: An ``.npz`` with inputs and outputs of the failing probes, or None.
        withheld: The size of a dump that exceeds the limit, in bytes; 0 otherwise.
    """

    command: str
    dump: Path | None = None
    withheld_bytes: int = 0

    def __str__(self) -> str:
        lines = [f"    reproduce: {self.command}"]
        if self.dump:
            lines.append(f"    inputs and outputs: {self.dump}")
        if self.withheld_bytes:
            size = format_mebibytes(self.withheld_bytes, 0)
            lines.append(f"    inputs and outputs: {size}, kept only where a folder is given")
        return "\n".join(lines)


@dataclass(frozen=True, slots=True)
class EvidenceDumps:
    """The folder in which model inputs and outputs of failed test runs are saved.

    Attributes:
        folder: The folder; it is created for the first file.
        most: The largest size of one file, in bytes; None for any size.
    """

    folder: Path
    max_bytes: int | None = None

    def __post_init__(self) -> None:
        """Raise if the folder for saved model inputs and outputs is a file."""
        if self.folder.exists() and not self.folder.is_dir():
            raise ConfigInvalid("is a file, expected a folder", where=str(self.folder))


def collect_evidence(
    path: Path, settings: Settings, cases: Iterable[Case], dumps: EvidenceDumps | None
) -> dict[str, Evidence]:
    """Return the evidence for each broken rule; save model inputs and outputs if a folder is set.

    The failing probes are run once more, so that a command names a probe only if that probe
    alone breaks the rule.
    """
    failed_cases = [case for case in cases if case.has_failed]
    evidence_by_rule = {
        case.rule.id: Evidence(_command(path, settings, case)) for case in failed_cases
    }
    executed_cases = [case for case in failed_cases if case.rule.scope not in ("model", "report")]
    if not executed_cases:
        return evidence_by_rule
    subject, plan = plan_model_runs(path, settings)
    probes_by_rule = {case.rule.id: suspect_probes(plan, case.findings) for case in executed_cases}
    if any(case.rule.scope == "execution" for case in executed_cases):  # the run did not finish,
        for case in executed_cases:  # so it is not repeated
            runs: Runs = [(probe, {}) for probe in probes_by_rule[case.rule.id]]
            command = _command(path, settings, case)
            evidence_by_rule[case.rule.id] = _save_evidence(
                dumps, path, settings, case, command, runs
            )
        return evidence_by_rule
    probes = list(
        {
            id(probe): probe for rule_probes in probes_by_rule.values() for probe in rule_probes
        }.values()
    )
    index_by_probe = {id(probe): number for number, probe in enumerate(probes)}
    with rerun_probes(subject, probes, settings) as rerun:
        for case in executed_cases:
            numbers = [index_by_probe[id(probe)] for probe in probes_by_rule[case.rule.id]]
            runs = [(probes[number], rerun.outputs(number)) for number in numbers]
            command = _command(path, settings, case, _sufficient_probe(rerun, case, numbers))
            evidence_by_rule[case.rule.id] = _save_evidence(
                dumps, path, settings, case, command, runs
            )
    return evidence_by_rule


def _save_evidence(
    dumps: EvidenceDumps | None,
    path: Path,
    settings: Settings,
    case: Case,
    command: str,
    runs: Runs,
) -> Evidence:
    if dumps is None:
        return Evidence(command)
    arrays = (
        array for probe, outputs in runs for array in (*probe.inputs.values(), *outputs.values())
    )
    size = sum(array.nbytes for array in arrays)
    if dumps.max_bytes is not None and size > dumps.max_bytes:
        return Evidence(command, withheld_bytes=size)
    name = re.sub(r"[^\w.-]+", "-", f"{path.stem}.{settings.target.name}.{case.rule.id}")
    target = dumps.folder / f"{name}.npz"
    save_runs(target, runs)
    return Evidence(command, target)


def suspect_probes(plan: Plan, findings: Sequence[Finding]) -> list[Probe]:
    """Return the probes (sets of test inputs) that findings name, or else one probe of the plan."""
    text = " ".join(finding.message for finding in findings)
    labels = {example.probe for finding in findings for example in finding.examples[:1]}
    matches = [probe for probe in plan.probes if probe.label in labels or repr(probe.label) in text]
    for role, (base, variants) in plan.variants.items():
        if any(finding.where.subject == f"role {role}" for finding in findings):
            matches += [plan.probes[base], *(plan.probes[variant] for variant in variants)]
    distinct_probes = list({id(probe): probe for probe in matches}.values())
    return distinct_probes[:_MAX_RUNS] or [plan.probes[min(1, plan.values - 1)]]


def _sufficient_probe(rerun: Replay, case: Case, numbers: list[int]) -> Probe | None:
    """Return the first of given sets of test inputs that by itself makes a model break a rule."""
    if case.rule.scope not in SINGLE_PROBE_SCOPES:
        return None
    failing_numbers = (number for number in numbers if rerun.findings(case.rule, number))
    first = next(failing_numbers, None)
    return None if first is None else rerun.probes[first]


def _command(path: Path, settings: Settings, case: Case, probe: Probe | None = None) -> str:
    words = ["gsgen", "repro", os.path.relpath(path) if _is_near_cell_time(path) else str(path)]
    words += ["--rule", case.rule.id]
    words += ["--probe", probe.label] if probe else []
    return shlex.join([*words, *_options(settings)])


def _is_near_cell_time(path: Path) -> bool:
    return path.resolve().is_relative_to(Path.cwd())


def _options(settings: Settings) -> list[str]:
    """Return the options of `gsgen repro` that are equivalent to validation settings."""
    words = []
    if settings.source != "defaults":
        words += ["--config", settings.source]
    if settings.target.name != "core":
        words += ["--target", settings.target.name]
    if settings.seed:
        words += ["--seed", str(settings.seed)]
    if settings.limits.seconds != Limits().seconds:
        words += ["--timeout", f"{settings.limits.seconds:g}"]
    if settings.limits.memory != Limits().memory:
        words += ["--memory", str(max(settings.limits.memory // MEBIBYTE, 1))]
    return words
