"""What behaviour rules look at: several runs of one session, compared output by output."""

__all__ = ["Behaviour", "Comparison", "Trial", "read_behaviour"]

from dataclasses import dataclass

import numpy as np

from gsgen.contract.plan import Plan
from gsgen.contract.sandbox import Execution
from gsgen.contract.subject import Subject


@dataclass(frozen=True, slots=True)
class Trial:
    """A model's runs, as the plan laid them out."""

    subject: Subject
    execution: Execution
    plan: Plan


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two runs: their probes, and how much each output differs.

    Attributes:
        first: Label of the first run's probe.
        second: Label of the second's.
        changed: Output name → largest absolute difference; outputs with equal bits are absent.
    """

    first: str
    second: str
    changed: dict[str, float]


@dataclass(frozen=True, slots=True)
class Behaviour:
    """Comparisons between runs.

    Attributes:
        subject: The model.
        repeated: The same inputs twice in a row.
        revisited: The same inputs with others in between; None without inputs.
        varied: Role → runs that differ in that role's inputs alone.
    """

    subject: Subject
    repeated: Comparison
    revisited: Comparison | None
    varied: dict[str, tuple[Comparison, ...]]


def read_behaviour(trial: Trial) -> Behaviour:
    """Compare the runs that the plan made for it."""
    plan = trial.plan
    assert plan.repeated is not None
    varied = {
        role: tuple(_compare(trial, base, other) for other in others)
        for role, (base, others) in plan.variants.items()
    }
    revisited = _compare(trial, *plan.revisited) if plan.revisited else None
    return Behaviour(trial.subject, _compare(trial, *plan.repeated), revisited, varied)


def _compare(trial: Trial, first: int, second: int) -> Comparison:
    runs, samples = trial.execution.runs, trial.execution.samples
    labels = trial.plan.probes[first].label, trial.plan.probes[second].label
    a, b = runs[first].sample, runs[second].sample
    if a == b:
        return Comparison(*labels, {})
    pairs = (
        (name, value, samples[b].outputs[name])
        for name, value in samples[a].outputs.items()
    )
    changed = {name: _difference(x, y) for name, x, y in pairs if not _same_bits(x, y)}
    return Comparison(*labels, changed)


def _same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and a.tobytes() == b.tobytes()


def _difference(a: np.ndarray, b: np.ndarray) -> float:
    if a.shape != b.shape:
        return float("inf")
    x, y = a.astype(np.float64), b.astype(np.float64)
    same = (x == y) | (np.isnan(x) & np.isnan(y))
    with np.errstate(invalid="ignore"):  # infinity less infinity
        wide = np.where(same, 0, np.abs(x - y))
    return float(np.where(np.isnan(wide), np.inf, wide).max(initial=0.0))
