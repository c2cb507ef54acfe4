"""Rules of trajectory predictors look at every run, and skip those without outputs."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from gsgen.conformance.fixtures.valid.companions import trajectory
from gsgen.contract.probing.run_comparison import ProbeRuns
from gsgen.contract.rules.behaviour.trajectory import predicted_quaternions_unit, prediction_finite


def runs_of(futures: list[np.ndarray | None]) -> ProbeRuns:
    """Return runs with these predicted states; None is a run without outputs."""
    samples: list[Any] = []
    runs, probes = [], []
    for number, future in enumerate(futures):
        runs.append(SimpleNamespace(sample=-1 if future is None else len(samples)))
        probes.append(SimpleNamespace(label=f"run {number}", zeros=False))
        if future is not None:
            samples.append(SimpleNamespace(outputs={"future": future}))
    parts = {
        "subject": SimpleNamespace(manifest=trajectory.draw().manifest),
        "execution": SimpleNamespace(runs=runs, samples=samples),
        "plan": SimpleNamespace(values=len(runs), probes=probes),
    }
    return cast(ProbeRuns, SimpleNamespace(**parts))


@pytest.mark.parametrize("wrong", [0, 1, 3])
def test_one_wrong_run_is_found_wherever_it_is(wrong: int) -> None:
    states = np.tile(np.array([1, 2, 3, 0, 1, 0, 0], np.float32), (3, 1))
    futures: list[np.ndarray | None] = [states, states.copy(), None, states.copy()]
    assert not list(predicted_quaternions_unit.check(runs_of(futures)))
    double = states.copy()
    double[2, 3:] *= 2
    futures[wrong] = double
    (violation,) = predicted_quaternions_unit.check(runs_of(futures))
    assert violation.actual == f"length 2 in row 2 at probe 'run {wrong}'"
    futures[wrong] = np.where(double == 2, np.float32(np.nan), double)
    (violation,) = prediction_finite.check(runs_of(futures))
    assert f"'run {wrong}'" in str(violation.actual)
