"""The input of behaviour rules: several runs of a model, compared output by output."""

__all__ = ["Behaviour", "Comparison", "ProbeRun", "ProbeRuns", "read_behaviour"]

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.differences import largest_difference, paired_blocks
from gsgen.contract.probing.probe_plan import Plan
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.sandbox import Execution, RowCount, Sample


@dataclass(frozen=True, slots=True)
class ProbeRuns:
    """The planned test runs of a model, and the outputs of each."""

    subject: InspectedModel
    execution: Execution
    plan: Plan


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two runs of a model: the test inputs of both, and the difference of each output.

    Attributes:
        first: Label of the first run's probe.
        second: Label of the second's.
        changed: Output name → largest absolute difference; outputs with equal bits are absent.
    """

    first: str
    second: str
    changed: dict[str, float]


@dataclass(frozen=True, slots=True)
class ProbeRun:
    """One run of a model with test inputs that a behaviour rule requested.

    Attributes:
        probe: Its inputs.
        sample: Its outputs; None if it failed.
        error: The message of ONNX Runtime; empty if it succeeded.
    """

    probe: Probe
    sample: Sample | None
    error: str

    @property
    def outputs(self) -> dict[str, np.ndarray]:
        """The run's outputs, sampled if they have many rows; empty if the run failed."""
        from gsgen.contract.probing.sandbox_worker import subsample_rows

        if self.sample is None:
            return {}
        return {name: subsample_rows(value) for name, value in self.sample.outputs.items()}

    @property
    def digest(self) -> str:
        """The SHA-256 of all outputs of the run; empty if the run failed."""
        return self.sample.digest if self.sample is not None else ""

    @property
    def row_count(self) -> RowCount | None:
        """The Gaussian count of a run at a named moment; else None."""
        return self.sample.survey if self.sample is not None else None

    @property
    def not_finite(self) -> tuple[str, ...]:
        """The names of the run's outputs with a value that is NaN or infinite."""
        if self.sample is None or self.sample.thin:
            return self.sample.not_finite if self.sample else ()
        floats = {n: v for n, v in self.sample.outputs.items() if v.dtype.kind == "f"}
        return tuple(name for name, value in floats.items() if not np.isfinite(value).all())


@dataclass(frozen=True, slots=True, kw_only=True)
class Behaviour:
    """Comparisons between model runs: the input of rules about a model's behaviour.

    Attributes:
        subject: The model.
        repeated: The same inputs twice in a row.
        revisited: The same inputs with other runs in between; None without inputs.
        varied: Role → runs that differ in that role's inputs alone.
        trial: The runs themselves.
        unfinished_probes: Requested extra probes that did not run: label, and the reached limit.
    """

    subject: InspectedModel
    repeated: Comparison
    revisited_pair: Comparison | None
    comparisons_by_role: dict[str, tuple[Comparison, ...]]
    trial: ProbeRuns
    unfinished_probes: list[tuple[str, str]] = field(default_factory=list)

    def without_unfinished(self) -> "Behaviour":
        """Copy the comparisons of model runs for one rule; its list of unfinished runs is empty."""
        return replace(self, unfinished_probes=[])

    @property
    def probe_outputs(self) -> list[tuple[Probe, dict[str, np.ndarray]]]:
        """The outputs that the rules about values check, except those of all-zero test inputs."""
        return [
            runs
            for runs in self._finished_outputs(range(self.trial.plan.values))
            if not runs[0].zeros
        ]

    def variants(self, role: str) -> list[tuple[Probe, dict[str, np.ndarray]]]:
        """The base run, and runs whose inputs differ in one role alone, such as camera or time."""
        base, variants = self.trial.plan.variants.get(role, (0, ()))
        return self._finished_outputs((base, *variants)) if variants else []

    @property
    def values(self) -> list[ProbeRun]:
        """The model runs whose outputs the rules about values check, in the planned order."""
        return [self._probe_run(index) for index in range(self.trial.plan.values)]

    @property
    def base(self) -> ProbeRun:
        """The model run that most other runs are compared with."""
        repeated = self.trial.plan.repeated
        assert repeated is not None
        return self._probe_run(repeated[0])

    @property
    def seconds(self) -> list[float]:
        """The duration, in seconds, of each run whose outputs the rules about values check."""
        return [run.seconds for run in self.trial.execution.runs[: self.trial.plan.values]]

    def trial_runs(self, trial: str) -> list[ProbeRun]:
        """Return the finished model runs of a group of test inputs; record the unfinished ones."""
        return self._recorded_runs(self.trial.plan.trials.get(trial, ()))

    def _recorded_runs(self, probe_indices: tuple[int, ...]) -> list[ProbeRun]:
        unfinished_indices = (index for index in probe_indices if not self._has_finished(index))
        self.unfinished_probes.extend(
            (self.trial.plan.probes[index].label, self.trial.execution.runs[index].missing_resource)
            for index in unfinished_indices
        )
        return [self._probe_run(index) for index in probe_indices if self._has_finished(index)]

    @property
    def moments(self) -> list[ProbeRun]:
        """The finished model runs at named moments; unfinished ones are recorded."""
        return self._recorded_runs(self.trial.plan.moments)

    def runs(self, indices: Iterable[int]) -> list[ProbeRun]:
        """Return the finished model runs with the given indices in the planned list of runs."""
        return [self._probe_run(index) for index in indices if self._has_finished(index)]

    def _has_finished(self, index: int) -> bool:
        run = self.trial.execution.runs[index]
        return run.sample >= 0 or bool(run.error)

    def _probe_run(self, index: int) -> ProbeRun:
        run, probe = self.trial.execution.runs[index], self.trial.plan.probes[index]
        sample = self.trial.execution.samples[run.sample] if run.sample >= 0 else None
        if run.center:
            center = ", ".join(f"{value:.6g}" for value in run.center)
            probe = replace(probe, label=f"{probe.label} ({center})")
        return ProbeRun(probe, sample, run.error)

    def _finished_outputs(
        self, indices: Iterable[int]
    ) -> list[tuple[Probe, dict[str, np.ndarray]]]:
        probe_runs = (self._probe_run(index) for index in indices)
        return [(v.probe, v.sample.outputs) for v in probe_runs if v.sample is not None]


def read_behaviour(trial: ProbeRuns) -> Behaviour:
    """Compare the model's outputs between test runs that repeat the inputs or vary one of them."""
    plan = trial.plan
    assert plan.repeated is not None
    comparisons_by_role = {
        role: tuple(_compare(trial, base, variant) for variant in variants)
        for role, (base, variants) in plan.variants.items()
    }
    revisited_pair = _compare(trial, *plan.revisited_pair) if plan.revisited_pair else None
    repeated = _compare(trial, *plan.repeated)
    return Behaviour(
        subject=trial.subject,
        repeated=repeated,
        revisited_pair=revisited_pair,
        comparisons_by_role=comparisons_by_role,
        trial=trial,
    )


def _compare(trial: ProbeRuns, first: int, second: int) -> Comparison:
    runs, samples = trial.execution.runs, trial.execution.samples
    labels = trial.plan.probes[first].label, trial.plan.probes[second].label
    a, b = runs[first].sample, runs[second].sample
    if a == b:
        return Comparison(*labels, {})
    pairs = ((name, value, samples[b].outputs[name]) for name, value in samples[a].outputs.items())
    changed = {name: largest_difference(x, y) for name, x, y in pairs if not _same_bits(x, y)}
    return Comparison(*labels, changed)


def _same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and all(x.tobytes() == y.tobytes() for x, y in paired_blocks(a, b))
