"""`gsgen rewrite` as a user runs it."""

import subprocess
import sys
from pathlib import Path

from gsgen.conformance.fixtures import find
from support.commands import gsgen_here


def test_a_model_is_rewritten_and_validates_for_the_viewer(tmp_path: Path) -> None:
    path, result = find("largest_of_two_on_jsep").write(tmp_path), tmp_path / "made.onnx"
    before = gsgen_here("validate", path, "--target", "visionary", "--level", "static")
    assert "GG006" in before.out
    completed = gsgen_here("rewrite", path, "-o", result, "--target", "visionary")
    assert completed.code == 0, completed.err
    assert "select-extremes: 1× " in completed.out
    assert completed.err == ""
    after = gsgen_here("validate", result, "--target", "visionary", "--level", "static")
    assert "GG006" not in after.out


def test_mistake_is_reported_without_a_traceback(tmp_path: Path) -> None:
    path = find("drift").write(tmp_path)
    completed = gsgen_here("rewrite", path, "-o", tmp_path / "o.onnx", "--pass", "chunk-conat")
    assert completed.code == 2
    assert "Did you mean 'chunk-concat'?" in completed.err
    resolved = gsgen_here("rewrite", tmp_path / "gone.onnx", "--dry-run")
    assert resolved.code == 4
    assert "Traceback" not in completed.err + resolved.err


def test_rewriting_needs_no_torch() -> None:
    """A model from elsewhere is rewritten at once: torch alone would take seconds to load."""
    code = "import gsgen.sdk.rewriting.rewrite, sys; print('torch' in sys.modules)"
    finished = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert finished.stdout.strip() == "False", finished.stderr
