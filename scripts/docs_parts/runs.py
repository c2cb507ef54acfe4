"""Runs commands, and returns their output for the documentation."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from gsgen.conformance.fixtures import find


def run(*words: str) -> str:
    """Return a command, its output and its exit code; MODEL.onnx is that example model."""
    assert words[0] == "gsgen", words
    with tempfile.TemporaryDirectory() as folder:
        for word in words:
            if word.endswith(".onnx"):
                find(Path(word).stem).write(Path(folder))
        completed = subprocess.run(
            [sys.executable, "-m", "gsgen.cli", *words[1:]],
            cwd=folder,
            capture_output=True,
            encoding="utf-8",
            env=os.environ | {"PYTHONIOENCODING": "utf-8", "COLUMNS": "96", "NO_COLOR": "1"},
        )
    printed = (completed.stdout + completed.stderr).rstrip()
    return f"```console\n$ {' '.join(words)}\n{printed}\n$ echo $?\n{completed.returncode}\n```"
