import os
import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = {"torch", "onnxscript", "onnx_ir", "wgpu", "scipy"}


def imported(*words: str) -> set[str]:
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "gsgen.cli", *words],
        capture_output=True,
        text=True,
        env=os.environ | {"COLUMNS": "200"},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    lines = [line for line in done.stderr.splitlines() if line.startswith("import time:")]
    return {line.rpartition("|")[2].strip().partition(".")[0] for line in lines}


@pytest.mark.parametrize(
    "words", [("--help",), ("--version",), ("rules",), ("export", "--help")]
)
def test_light_commands_import_nothing_heavy(words: tuple[str, ...]) -> None:
    assert imported(*words) & (HEAVY | {"onnxruntime"}) == set()


def test_static_validation_imports_nothing_heavy(good: Path) -> None:
    names = imported("validate", "--level", "static", str(good))
    assert "onnx" in names  # the measure works
    assert names & (HEAVY | {"onnxruntime"}) == set()


def test_running_a_model_keeps_onnx_runtime_out_of_the_parent(good: Path) -> None:
    names = imported("validate", "--level", "behaviour", str(good))
    assert names & (HEAVY | {"onnxruntime"}) == set()
