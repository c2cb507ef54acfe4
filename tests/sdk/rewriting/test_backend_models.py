"""ONNX's backend test through inspect, rewrite and float16: no traceback, no broken file, no change."""

from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from sdk.rewriting.backend_models import BackendModel, backend_models, verdict

FAULTS = ("traceback", "broken", "changed")


def outcomes_of(model: BackendModel) -> tuple[str, dict[str, str]]:
    with TemporaryDirectory() as folder:
        return model.name, verdict(model, Path(folder))


def assert_no_faults(results: list[tuple[str, dict[str, str]]]) -> Counter[str]:
    faults = [
        (name, step, outcome)
        for name, outcomes in results
        for step, outcome in outcomes.items()
        if outcome.startswith(FAULTS)
    ]
    assert faults == []
    return Counter(outcomes["rewrite"].split(":")[0] for _, outcomes in results)


@pytest.mark.slow
@pytest.mark.parametrize("word", ["sequence", "optional"])
def test_models_of_sequences_and_optionals_are_kept_or_rewritten_right(word: str) -> None:
    models = [model for model in backend_models() if word in model.name]
    assert len(models) >= 10
    counts = assert_no_faults([outcomes_of(model) for model in models])
    assert counts["same bytes"] >= 6


@pytest.mark.slow
def test_models_that_name_the_type_of_a_result_are_kept_or_rewritten_right() -> None:
    """Operators such as BitCast, whose attribute ``to`` says how many bits an element has."""
    models = [model for model in backend_models() if "bitcast" in model.name]
    assert len(models) >= 5
    assert_no_faults([outcomes_of(model) for model in models])


@pytest.mark.slow
def test_every_fiftieth_backend_model_is_kept_or_rewritten_right() -> None:
    models = list(backend_models())[::50]
    assert len(models) >= 30
    counts = assert_no_faults([outcomes_of(model) for model in models])
    assert counts["ok"] >= 8


@pytest.mark.nightly
def test_all_backend_models_are_kept_or_rewritten_right() -> None:
    """Three of four are rewritten or kept; others are refused, most of them by ONNX Runtime."""
    models = list(backend_models())
    assert len(models) >= 1500
    with ProcessPoolExecutor() as pool:
        counts = assert_no_faults(list(pool.map(outcomes_of, models, chunksize=8)))
    assert counts["ok"] + counts["same bytes"] >= 0.75 * len(models)
