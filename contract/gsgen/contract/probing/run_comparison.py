"""The input of behaviour rules: several runs of a model, compared output by output."""

__all__ = [
    "Behaviour",
    "Comparison",
    "ProbeRun",
    "ProbeRuns",
    "isolated_views",
    "read_behaviour",
    "read_seen_rows",
]

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.differences import largest_difference, paired_blocks
from gsgen.contract.probing.probe_plan import Plan
from gsgen.contract.probing.probes import Probe, as_tensor
from gsgen.contract.probing.sandbox import Execution, RowCount, Sample
from gsgen.contract.spec.fields.roles import CAMERA_ROLES
from gsgen.contract.spec.layout import CULL_OPACITY, OPACITY, POSITION, ROW_LENGTH

if TYPE_CHECKING:
    from gsgen.contract.causes.readings import SeenRows


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
        readings: What rules compute of the same runs, by name; shared by the copies for each rule.
    """

    subject: InspectedModel
    repeated: Comparison
    revisited_pair: Comparison | None
    comparisons_by_role: dict[str, tuple[Comparison, ...]]
    trial: ProbeRuns
    unfinished_probes: list[tuple[str, str]] = field(default_factory=list)
    readings: dict[str, Any] = field(default_factory=dict, compare=False)

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


def read_seen_rows(probe_runs: ProbeRuns, index: int) -> "SeenRows | None":
    """Return the Gaussians that one run shows to its camera; None without a camera or rows."""
    from gsgen.contract.causes.readings import SeenRows

    subject, probe = probe_runs.subject, probe_runs.plan.probes[index]
    run = probe_runs.execution.runs[index] if index < len(probe_runs.execution.runs) else None
    declared, count = subject.declared_gaussians, subject.declared_count
    if run is None or run.sample < 0 or declared is None or count is None:
        return None
    outputs = probe_runs.execution.samples[run.sample].outputs
    rows, live = outputs.get(declared.name), outputs.get(count.name)
    is_packed = rows is not None and rows.ndim == 2 and rows.shape[1] == ROW_LENGTH
    if not is_packed or rows is None or live is None or not live.size:
        return None
    view, projection = _input_matrix(probe_runs, probe, "view"), None
    if view is not None:
        projection = _input_matrix(probe_runs, probe, "projection")
    centers = subject.inputs_of("camera_position")
    if view is None and not centers:
        return None
    # Runs that differ in one role alone differ in the view, where there is one.
    center = -view[:3, :3].T @ view[:3, 3] if view is not None else None
    if center is None:
        center = probe.inputs[centers[0][0].name].astype(np.float64).reshape(-1)
    drawn = np.asarray(rows[:, OPACITY] >= CULL_OPACITY)
    live_share = max(0, int(live.reshape(-1)[0])) / max(declared.capacity, 1)
    drawn[math.ceil(live_share * len(rows)) :] = False  # of many rows, a part was kept
    position = rows[:, POSITION].astype(np.float64)
    return SeenRows(center=center, view=view, projection=projection, position=position, drawn=drawn)


def _input_matrix(
    probe_runs: ProbeRuns, probe: Probe, role: str
) -> Float[np.ndarray, "4 4"] | None:
    subject = probe_runs.subject
    entries = subject.inputs_of(role)
    space = subject.generator.space if subject.generator else None
    order = space.matrix_order if space else "column"
    if not entries:
        return None
    return as_tensor(probe.inputs[entries[0][0].name], order).astype(np.float64)


def isolated_views(probe_runs: ProbeRuns) -> "tuple[SeenRows, ...]":
    """Return cameras and Gaussians of all model runs whose inputs differ in the camera alone."""
    plan, manifest = probe_runs.plan, probe_runs.subject.manifest
    roles = {entry.role for entry in manifest.inputs} if manifest else set()
    role = "view" if "view" in roles else "camera_position"
    base, variants = plan.variants.get(role, (0, ()))
    indices = [base, *variants] if variants else []
    if not indices and roles <= set(CAMERA_ROLES):
        indices = [index for index in range(plan.values) if not plan.probes[index].zeros]
    seen_rows = (read_seen_rows(probe_runs, index) for index in indices)
    return tuple(entry for entry in seen_rows if entry is not None)
