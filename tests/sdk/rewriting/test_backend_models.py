"""ONNX's backend test through inspect, rewrite and float16: no traceback, no broken file, no change."""

import os
import signal
import time
from collections import Counter

import pytest

from corpora.strangers import committed
from sdk.rewriting.backend_models import (
    FAULTS,
    VERDICTS,
    backend_models,
    compact,
    outcomes_of,
    outcomes_of_all,
    versions,
)
from support.forks import results_of_forks


def assert_no_faults(outcomes: dict[str, dict[str, str]]) -> Counter[str]:
    faults = [
        (name, step, outcome)
        for name, entry in outcomes.items()
        for step, outcome in entry.items()
        if outcome.startswith(FAULTS)
    ]
    assert faults == []
    return Counter(entry["rewrite"].split(":")[0] for entry in outcomes.values())


def test_no_committed_verdict_of_a_backend_model_is_a_fault() -> None:
    verdicts = committed(VERDICTS.stem)
    assert len(verdicts) >= 1500
    assert [name for name, text in verdicts.items() if any(fault in text for fault in FAULTS)] == []


def _ends_at_minus_one(number: int) -> int:
    if number == -1:
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def test_a_fork_that_ends_loses_one_item() -> None:
    results = list(results_of_forks(_ends_at_minus_one, [1, -1, 2, -1], seconds=60))
    assert results == [2, "ended with status -9", 4, "ended with status -9"]


def test_a_fork_that_takes_too_long_loses_one_item() -> None:
    results = list(results_of_forks(_sleeps_for, [0.0, 60.0, 0.0], seconds=1))
    assert results == [0.0, "still running after 1 s", 0.0]


def _sleeps_for(seconds: float) -> float:
    time.sleep(seconds)
    return seconds


@pytest.mark.slow
@pytest.mark.parametrize("word", ["sequence", "optional"])
def test_models_of_sequences_and_optionals_are_kept_or_rewritten_right(word: str) -> None:
    models = [model for model in backend_models() if word in model.name]
    assert len(models) >= 10
    counts = assert_no_faults(outcomes_of(models))
    assert counts["same bytes"] >= 6


@pytest.mark.slow
def test_models_that_name_the_type_of_a_result_are_kept_or_rewritten_right() -> None:
    """Operators such as BitCast, whose attribute ``to`` says how many bits an element has."""
    models = [model for model in backend_models() if "bitcast" in model.name]
    assert len(models) >= 5
    assert_no_faults(outcomes_of(models))


@pytest.mark.slow
def test_every_fiftieth_backend_model_is_kept_or_rewritten_right() -> None:
    models = list(backend_models())[::50]
    assert len(models) >= 30
    counts = assert_no_faults(outcomes_of(models))
    assert counts["ok"] >= 8


@pytest.mark.nightly
def test_all_backend_models_are_kept_or_rewritten_right() -> None:
    """Three of four are rewritten or kept; others are refused, most of them by ONNX Runtime."""
    models = list(backend_models())
    assert len(models) >= 1500
    outcomes = outcomes_of_all(models)
    counts = assert_no_faults(outcomes)
    assert counts["ok"] + counts["same bytes"] >= 0.75 * len(models)
    if VERDICTS.read_text().startswith(f"{versions()}\n"):
        assert {name: compact(entry) for name, entry in outcomes.items()} == committed(
            VERDICTS.stem
        )
