"""A fault of this machine ends `gsgen validate` with 2 and its cause, never with a verdict."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures.builders.moving import drifting_model
from support.models.endless import endless

# Sets a limit for the program that it becomes, as `ulimit` does.
_LIMITED = """
import os, resource, sys
size = int(sys.argv[2])
resource.setrlimit(getattr(resource, sys.argv[1]), (size, size))
os.execv(sys.executable, [sys.executable, "-m", "gsgen.cli", *sys.argv[3:]])
"""

pytestmark = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="Linux alone")


def roomy(folder: Path, count: int, megabytes: int) -> Path:
    """Return a right generator that needs some megabytes of memory while it runs."""
    text = (
        "many = ConstantOfShape (size) most = ReduceMax <keepdims = 0> (many) "
        "moment = Add (time, most) shift = Mul (speed, moment)"
    )
    spec = drifting_model(count).replace_text("shift = Mul (speed, time)", text)
    path = folder / "roomy.onnx"
    spec.with_weights(size=np.array([megabytes << 18], np.int64)).write(path)
    return path


@pytest.mark.parametrize(
    ("limit", "size", "cause"),
    [
        ("RLIMIT_FSIZE", 1 << 16, "inputs and outputs of the model cannot be stored"),
        ("RLIMIT_DATA", 230 << 20, "this process is limited to 230 MiB"),
        ("RLIMIT_NOFILE", 24, "Too many open files"),
    ],
)
def test_a_limit_of_the_system_is_no_verdict(
    tmp_path: Path, limit: str, size: int, cause: str
) -> None:
    path = roomy(tmp_path, 2_000, 300)
    words = [limit, str(size), "validate", str(path), "--level", "values"]
    completed = subprocess.run(
        [sys.executable, "-c", _LIMITED, *words], capture_output=True, text=True, check=False
    )
    assert completed.returncode == 2
    assert completed.stdout == ""
    assert cause in completed.stderr
    assert "Traceback" not in completed.stderr


@pytest.mark.slow
def test_the_same_model_conforms_without_the_limits(tmp_path: Path) -> None:
    words = ["validate", str(roomy(tmp_path, 2_000, 300)), "--level", "values"]
    completed = subprocess.run(
        [sys.executable, "-m", "gsgen.cli", *words], capture_output=True, text=True, check=False
    )
    assert (completed.returncode, completed.stderr) == (0, ""), completed.stdout


@pytest.mark.slow
def test_a_killed_child_is_no_verdict(tmp_path: Path) -> None:
    words = ["validate", str(endless(tmp_path, after=0.5)), "--level", "values"]
    with subprocess.Popen(
        [sys.executable, "-m", "gsgen.cli", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        try:
            os.kill(_busy_child(running.pid), signal.SIGKILL)
            output, errors = running.communicate(timeout=60)
        finally:
            running.kill()
    assert (running.returncode, output) == (2, "")
    assert "killed by SIGKILL" in errors


def _busy_child(process: int) -> int:
    """Return the child that has used a second of processor time, once there is one."""
    end = time.monotonic() + 60
    while time.monotonic() < end:
        for task in Path(f"/proc/{process}/task").iterdir():
            for child in (task / "children").read_text().split():
                fields = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()
                if int(fields[11]) + int(fields[12]) > os.sysconf("SC_CLK_TCK"):
                    return int(child)
        time.sleep(0.02)
    raise AssertionError("no child computes")
