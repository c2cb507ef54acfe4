"""Rules of trajectory predictors look at every run, and skip those without outputs."""

from collections.abc import Callable
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gsgen.conformance.fixtures.valid.companions import trajectory
from gsgen.contract.probing.run_comparison import ProbeRuns
from gsgen.contract.rules.behaviour.steady_paths import fault_of_steady_path
from gsgen.contract.rules.behaviour.trajectory import (
    covariance_fault,
    predicted_quaternions_unit,
    prediction_finite,
)


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


def steady_path(
    random: np.random.Generator, count: int, *, turning: bool, vectors: bool
) -> np.ndarray:
    """Return states of constant speed, as SciPy turns them: [count, 7], or [count, 6] of vectors."""
    steps = np.arange(count)[:, None]
    positions = random.normal(size=3) + steps * random.normal(size=3) * (not turning)
    turn = random.normal(size=3)
    turn *= 0.2 * turning / np.linalg.norm(turn)
    rotations = Rotation.from_rotvec(steps * turn) * Rotation.random(rng=random)
    if vectors:
        return np.hstack([positions, rotations.as_rotvec()])
    quaternions = rotations.as_quat()[:, [3, 0, 1, 2]]
    for earlier, later in pairwise(quaternions):
        later *= 1 if earlier @ later >= 0 else -1
    return np.hstack([positions, quaternions])


def slowed(states: np.ndarray) -> np.ndarray:
    return np.asarray(states[:1] + 0.5 * (states - states[:1]))


# What a predictor does to the right states, of which the first is the newest of the history.
STEADY_FAULTS: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str]] = {
    "farthest first": (lambda states: states[:0:-1], "farthest first"),
    "slowed": (lambda states: slowed(states)[1:], "of the speed"),
    "late": (lambda states: states[:-1], "predicted state 1"),
    "early": (lambda states: states[[2, 3, 3]], "predicted state 1"),
    "one repeated": (lambda states: states[[1, 2, 2]], "predicted state 3"),
}


@pytest.mark.parametrize("turning", [False, True])
@pytest.mark.parametrize("vectors", [False, True])
def test_steady_paths_go_on_and_faults_are_named(turning: bool, vectors: bool) -> None:
    for seed in range(20):
        states = steady_path(np.random.default_rng(seed), 7, turning=turning, vectors=vectors)
        history, future = states[:4], states[4:]
        assert not fault_of_steady_path(history, future, turning=turning)
        for name, (fault, words) in STEADY_FAULTS.items():
            if turning and name == "slowed":
                continue
            wrong = fault(states[3:])
            assert words in fault_of_steady_path(history, wrong, turning=turning), (seed, name)
        drifting = future.copy()
        drifting[-1, 0 if turning else 3] += 0.01
        assert not fault_of_steady_path(history, drifting, turning=turning)
        drifting[-1, 0 if turning else 3] += 0.19
        assert "too, by 0.2" in fault_of_steady_path(history, drifting, turning=turning)
        if turning and not vectors:
            last = future[:, [0, 1, 2, 4, 5, 6, 3]]
            assert "order x y z w" in fault_of_steady_path(history, last, turning=True)


@pytest.mark.parametrize("wobble", [0.0, 0.3])
def test_predictions_may_brake_over_the_horizon(wobble: float) -> None:
    states = steady_path(np.random.default_rng(1), 24, turning=False, vectors=False)
    history, future, speeds = states[:4], states[4:], np.linspace(1, 0, 20)
    step = states[1, :3] - states[0, :3]
    aside = np.cross(step, [1, 0, 0])
    aside *= np.linalg.norm(step) / np.linalg.norm(aside)
    motions = speeds[:, None] * step + np.outer(np.arange(20) % 2, wobble * aside)
    future[:, :3] = history[-1, :3] + motions.cumsum(axis=0)
    assert not fault_of_steady_path(history, future, turning=False)
    for wrong in (-8 * step, 8 * step, 8 * aside):
        late = future.copy()
        late[12:, :3] = history[-1, :3] + 13 * step * (wrong @ step > 0) + wrong
        assert "predicted state 13" in fault_of_steady_path(history, late, turning=False)


def test_motion_along_the_vertical_may_be_damped() -> None:
    history = np.zeros((4, 7))
    history[:, 3], history[:, :3] = 1, np.arange(4)[:, None] * [1.0, 2.0, 0.5]
    future = np.repeat(history[-1:], 3, 0)
    future[:, :3] += np.arange(1, 4)[:, None] * [1.0, 0.5, 0.5]
    assert fault_of_steady_path(history, future, turning=False)
    assert not fault_of_steady_path(history, future, turning=False, vertical=1)


@pytest.mark.parametrize("size", [6, 7])
def test_covariances_are_read_as_upper_triangles(size: int) -> None:
    random = np.random.default_rng(size)
    factors = random.normal(size=(5, size, size))
    matrices = factors @ factors.transpose(0, 2, 1)
    rows, columns = np.triu_indices(size)
    assert not covariance_fault(matrices[:, rows, columns], size)
    lower = matrices[(slice(None), *np.tril_indices(size))]
    assert "read as the lower triangle" in covariance_fault(lower, size)
    matrices[3] -= 1.01 * np.linalg.eigvalsh(matrices[3]).min() * np.eye(size)
    matrices[3] -= 0.2 * np.outer(*[np.linalg.eigh(matrices[3])[1][:, 0]] * 2)
    assert "row 3 has the eigenvalue -" in covariance_fault(matrices[:, rows, columns], size)
    matrices[1, 0, 0] = 0.0
    assert "row 1 has the variance 0" in covariance_fault(matrices[:, rows, columns], size)
