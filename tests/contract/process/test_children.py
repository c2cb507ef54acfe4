"""No child process imports a module of the folder that a command runs in."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from support.commands import ROOT

_ROOMS = ("contract", "sdk", "runtime", "reference_plugins")
_HOSTILE = ("random.py", "socket.py", "multiprocessing/__init__.py", "pickle.py", "onnx.py")


@pytest.fixture
def hostile_folder(tmp_path: Path) -> Path:
    for name in _HOSTILE:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("open('canary', 'w').write(__file__)\n", "utf-8")
    return tmp_path


def run_with(flag: str, script: str, folder: Path) -> "subprocess.CompletedProcess[str]":
    main = folder / "elsewhere" / "main.py"
    main.parent.mkdir()
    main.write_text(script, "utf-8")
    command = [sys.executable, *([flag] if flag else []), str(main)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


_POOL = """
import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from contextlib import nullcontext
from gsgen.contract.process.parent_watchdog import safe_multiprocessing

if __name__ == "__main__":
    with GUARD(), ProcessPoolExecutor(1, get_context("spawn")) as pool:
        print(pool.submit(abs, -3).result())
    print("PYTHONSAFEPATH" in os.environ)
"""


@pytest.mark.parametrize("flag", ["", "-P", "-I"])
def test_worker_of_a_pool_imports_nothing_from_the_folder(flag: str, hostile_folder: Path) -> None:
    done = run_with(flag, _POOL.replace("GUARD", "safe_multiprocessing"), hostile_folder)
    assert done.stdout.split() == ["3", "False"], done.stderr
    assert not (hostile_folder / "canary").exists()


def test_worker_without_the_guard_imports_from_the_folder(hostile_folder: Path) -> None:
    run_with("", _POOL.replace("GUARD", "nullcontext"), hostile_folder)
    assert (hostile_folder / "canary").exists()


@pytest.mark.parametrize(
    ("flag", "expected"),
    [("", ["-P"]), ("-P", ["-P"]), ("-I", ["-I"]), ("-E", ["-P", "-E"]), ("-s", ["-P", "-s"])],
)
def test_child_is_as_isolated_as_its_parent(flag: str, expected: list[str]) -> None:
    script = "from gsgen.contract.process.parent_watchdog import python_command as command\n"
    words = [sys.executable, *([flag] if flag else []), "-c", f"{script}print(*command()[1:])"]
    environment = {name: value for name, value in os.environ.items() if "PYTHON" not in name}
    done = subprocess.run(words, capture_output=True, text=True, env=environment)
    assert done.stdout.split() == expected, done.stderr


def test_every_child_is_started_by_these_functions() -> None:
    starts = re.compile(r"\[sys\.executable|ProcessPoolExecutor\(|LocalCluster\(|\bPopen\(")
    files = [path for room in _ROOMS for path in (ROOT / room).rglob("*.py")]
    for path in files:
        text = path.read_text("utf-8")
        if starts.search(text) and path.name != "parent_watchdog.py":
            assert "python_command()" in text or "safe_multiprocessing()" in text, path
