"""Runs a model again with a few test inputs, checks one rule, and saves inputs and outputs."""

__all__ = [
    "SINGLE_PROBE_SCOPES",
    "Replay",
    "find_probes",
    "plan_model_runs",
    "rerun_probes",
    "save_runs",
]

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gsgen.contract.errors import UnknownName
from gsgen.contract.model.inspected_model import InspectedModel, inspect_model
from gsgen.contract.model.model_file import open_model
from gsgen.contract.probing.drawn_sample import draw_sample
from gsgen.contract.probing.outputs import ModelOutputs, chunks, read_outputs
from gsgen.contract.probing.probe_plan import Plan, fetched_outputs, make_plan
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.run_comparison import ProbeRuns
from gsgen.contract.probing.sandbox import Execution, execute
from gsgen.contract.process.atomic_files import atomic_write
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.finding import Finding
from gsgen.contract.validation.outcomes import ResultCollector
from gsgen.contract.validation.rule import Registry, Rule
from gsgen.contract.validation.settings import Settings

# Scopes of rules that can be checked with one probe alone.
SINGLE_PROBE_SCOPES = ("rows", "sample", "emission", "execution")

Arrays = dict[str, np.ndarray]


@dataclass(frozen=True, slots=True)
class Replay:
    """The results of running a model again with some test inputs, in a separate sandbox.

    Attributes:
        subject: The model.
        probes: The probes in order; methods take an index into this list.
        execution: The results; the run may have ended early.
        settings: The settings of the validation.
    """

    subject: InspectedModel
    probes: tuple[Probe, ...]
    execution: Execution
    settings: Settings

    def outputs(self, probe: int) -> Arrays:
        """Return the outputs of the run with a set of test inputs; empty if it did not finish."""
        for run in self.execution.runs:
            if run.probe == probe:
                return self.execution.samples[run.sample].outputs
        return {}

    def emission(self, probe: int) -> ModelOutputs:
        """Return the model outputs for a set of test inputs, assigned to their declared roles."""
        run_probe = self.probes[probe]
        return read_outputs(
            self.subject, run_probe.label, self.outputs(probe), zeros=run_probe.zeros
        )

    def findings(self, rule: Rule, probe: int) -> tuple[Finding, ...]:
        """Return the findings of one validation rule for one set of test inputs alone."""
        single_rule = Registry.from_rules([replace(rule, needs=())])
        collector = ResultCollector(
            registry=single_rule, settings=self.settings, kind=self.subject.kind
        )
        for subject, start in self._rule_subjects(rule, probe):
            collector.check(rule, subject, self.probes[probe].label, start)
        collector.settle(single_rule.rules.values())
        return collector.findings()

    def _rule_subjects(self, rule: Rule, probe: int) -> Iterator[tuple[object, int]]:
        if rule.scope == "execution":
            plan = Plan(probes=self.probes, values=len(self.probes))
            yield ProbeRuns(self.subject, self.execution, plan), 0
        elif self.outputs(probe):
            emission = self.emission(probe)
            if rule.scope == "emission":
                yield emission, 0
            elif rule.scope == "sample" and (sample := draw_sample(emission)) is not None:
                yield sample, 0
            elif rule.scope == "rows":
                yield from ((chunk, chunk.start) for chunk in chunks(emission))


def plan_model_runs(path: Path, settings: Settings) -> tuple[InspectedModel, Plan]:
    """Return a model's parsed file and its planned test runs; the manifest must be readable."""
    subject = inspect_model(open_model(path), settings.target, settings.limits, settings.tolerances)
    level = min(max(settings.level, Level.VALUES), Level.BEHAVIOUR)
    return subject, make_plan(subject, level, settings.seed)


@contextmanager
def rerun_probes(
    subject: InspectedModel, probes: Sequence[Probe], settings: Settings
) -> Iterator[Replay]:
    """Run some test inputs of a model again in the sandbox; results last for the ``with`` block."""
    path, names = subject.file.path, fetched_outputs(subject)
    stored_probes = tuple(replace(probe, survey=False) for probe in probes)
    with execute(path, names, stored_probes, subject.sandbox_limits) as execution:
        yield Replay(subject, tuple(probes), execution, settings)


def find_probes(probes: Sequence[Probe], key: str) -> tuple[Probe, ...]:
    """Return the sets of test inputs (probes) with a given label or number; labels may repeat.

    Raises:
        UnknownName: No probe has this label or number; the hint names the nearest.
    """
    matches = [probe for probe in probes if probe.label == key]
    if not matches and key.isdecimal() and int(key) < len(probes):
        matches = [probes[int(key)]]
    if not matches:
        labels = dict.fromkeys(probe.label for probe in probes)
        raise UnknownName.among("probe", key, labels, "--probe")
    return tuple({id(probe): probe for probe in matches}.values())


def save_runs(path: Path, runs: Sequence[tuple[Probe, Arrays]]) -> None:
    """Save the inputs and outputs of model runs to an ``.npz`` file.

    The first run's arrays are called ``input.NAME`` and ``output.NAME``, the second's
    ``2.input.NAME`` and so on; ``probe`` and ``2.probe`` are their labels.
    """
    arrays: Arrays = {}
    for number, (probe, outputs) in enumerate(runs, start=1):
        key_prefix = f"{number}." if number > 1 else ""
        arrays[f"{key_prefix}probe"] = np.asarray(probe.label)
        arrays |= {f"{key_prefix}input.{name}": array for name, array in probe.inputs.items()}
        arrays |= {f"{key_prefix}output.{name}": array for name, array in outputs.items()}
    with atomic_write(path) as temporary_path, temporary_path.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]  # no array has the name `allow_pickle`
