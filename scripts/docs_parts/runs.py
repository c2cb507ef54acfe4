"""Runs commands, and returns their output for the documentation."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from gsgen.conformance.fixtures import find


def run(*words: str) -> str:
    """Return a command, its output and its exit code; MODEL.onnx is that example model."""
    completed = _run(words)
    printed = (completed.stdout + completed.stderr).rstrip()
    return f"```console\n$ {' '.join(words)}\n{printed}\n$ echo $?\n{completed.returncode}\n```"


def finding(name: str) -> str:
    """Return the first finding of an example model as a JSON report has it."""
    completed = _run(("gsgen", "validate", f"{name}.onnx", "--format", "json"))
    first = json.loads(completed.stdout)["findings"][0]
    return f"```json\n{json.dumps(first, indent=2, ensure_ascii=False)}\n```"


def _run(words: tuple[str, ...]) -> "subprocess.CompletedProcess[str]":
    assert words[0] == "gsgen", words
    with tempfile.TemporaryDirectory() as folder:
        for word in words:
            if word.endswith(".onnx"):
                find(Path(word).stem).write(Path(folder))
        return subprocess.run(
            [sys.executable, "-m", "gsgen.cli", *words[1:]],
            cwd=folder,
            capture_output=True,
            encoding="utf-8",
            env=os.environ | {"PYTHONIOENCODING": "utf-8", "COLUMNS": "96", "NO_COLOR": "1"},
        )
