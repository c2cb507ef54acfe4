"""`gsgen bench` and what is behind it: a child for each provider, figures, and who crashed."""

import json
import os
import signal
from pathlib import Path

import pytest

from gsgen.conformance.fixtures.builders.moving import input_driven_model
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.manifest import Input
from gsgen.sdk.binding import benchmark
from gsgen.sdk.binding.benchmark import time_frames
from gsgen.sdk.binding.benchmark_worker import _measure
from support.commands import gsgen, gsgen_here

JOB = {"frames": 4, "sizes": {}, "capture": True}


@pytest.mark.parametrize("provider", ["cpu", "webgpu"])
def test_measurements_of_a_frame_are_consistent(provider, models):
    facts = _measure(JOB | {"model": str(models["drift-float32"]), "provider": provider})
    assert facts["frames"] == 4
    assert 0 < facts["p50_seconds"] <= facts["p95_seconds"]
    assert facts["first_frame_seconds"] > facts["create_seconds"] > 0
    assert 0 <= facts["copy_share"] <= 1
    assert (facts["bytes_in"], facts["bytes_out"]) == (4, 5 * 10 * 4 + 5 * 3 * 4 + 4)
    assert facts["gaussians"] == 5
    assert facts["gaussians_per_second"] == 5 / facts["p50_seconds"]
    assert facts["captured"] is (provider == "webgpu")


def test_unmeasurable_models_have_distinct_errors(models, tmp_path, monkeypatch):
    failed = time_frames(models["split_into_many"], "webgpu", frames=1)
    assert (failed.state, failed.facts) == ("failed", {})
    assert "Too many storage buffers" in failed.reason
    missing_result = time_frames(models["drift-float32"], "cuda", frames=1)
    assert missing_result.state == "unavailable"
    (tmp_path / "endless.py").write_text("import time; time.sleep(60)")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(benchmark, "_WORKER", "endless")
    timed_out = time_frames(models["drift-float32"], "cpu", frames=1, limits=Limits(seconds=0.05))
    assert (timed_out.state, timed_out.reason) == ("crashed", "still running after 0.05 s")


def test_a_model_that_needs_a_size_says_which_option_gives_it(tmp_path):
    pose = Input(name="pose", role="pose")
    opened = input_driven_model("float[J,3] pose", pose, "shift = ReduceMean <keepdims = 0> (pose)")
    opened.write(tmp_path / "open.onnx")
    failed = time_frames(tmp_path / "open.onnx", "cpu", frames=1)
    assert failed.state == "failed"
    assert failed.reason.startswith(
        "tensor pose: axis 0 is symbolic (J), expected a size; Give its size"
    )
    assert "`--size J=24`" in failed.reason


def test_a_child_that_dies_is_reported_and_no_other(models, tmp_path, monkeypatch):
    """A worker that kills itself stands for a driver that does."""
    (tmp_path / "deadly.py").write_text("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(benchmark, "_WORKER", "deadly")
    failed_run = time_frames(models["drift-float32"], "webgpu", frames=1)
    assert (failed_run.state, failed_run.reason) == (
        "crashed",
        f"ended by signal {signal.SIGSEGV.name}",
    )
    monkeypatch.undo()
    assert time_frames(models["drift-float32"], "cpu", frames=1).state == "measured"


def test_the_command_prints_a_table_and_writes_json(models, tmp_path):
    out = tmp_path / "figures.json"
    completed = gsgen("bench", models["round_on_the_cpu"], "--frames", "3", "-o", out)
    assert completed.code == 0, completed.err
    results = json.loads(out.read_text())["results"]
    named = [
        (Path(result["model"]).stem, result["provider"], result["state"]) for result in results
    ]
    assert named == [("round_on_the_cpu", provider, "measured") for provider in ("cpu", "webgpu")]
    assert results[1]["nodes_on_cpu"] == ["Round"]
    for words in ("p50 ms", "first ms", "copies", "nodes on the CPU (Round)", "not captured: "):
        assert words in completed.out
    for entry in results:
        assert f"{1000 * entry['p50_seconds']:.3f}" in completed.out


def test_command_lists_unmeasured_models(models, tmp_path):
    completed = gsgen_here("bench", models["drift-float32"], "--provider", "cuda", "--json")
    assert completed.code == 1
    (result,) = json.loads(completed.out)["results"]
    assert (result["state"], result["provider"]) == ("unavailable", "cuda")
    assert "onnxruntime-gpu" in result["why"]


@pytest.mark.parametrize(
    ("words", "code", "expected_message"),
    [
        (["--provider", "tpu"], 2, "'tpu' is not one of"),
        (["--frames", "0"], 2, "--frames"),
        (["--size", "J"], 2, "the value is 'J', expected SYMBOL=SIZE"),
        ([os.devnull], 4, "is not a regular file"),
    ],
)
def test_invalid_bench_options_are_refused(words, code, expected_message, models):
    completed = gsgen_here("bench", models["drift-float32"], *words)
    assert completed.code == code
    assert expected_message in completed.err
    assert "Traceback" not in completed.err
