"""`gsgen export --timeout` ends each stage with a line; what agrees with torch is written."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from gsgen.cli.commands.exporting import export_job
from gsgen.cli.commands.exporting.export import app
from gsgen.contract.spec.manifest import ReferenceImage
from gsgen.runtime.checks import eager_pictures
from gsgen.sdk import source_pictures
from support.commands import gsgen

STAGES = (
    *("building the generator", "running the module in eager torch", "tracing the graph"),
    "comparing with eager torch",
)
# What begins a part of the validation → the last level that has run when its time is over there.
LEVELS = {
    "reading": "static",
    "checking values": "static",
    "comparing runs": "values",
    "replaying": "behaviour",
}
MODULE = """
import torch
from gsgen.sdk import GaussianGenerator, Gaussians, inputs

class Dots(GaussianGenerator):
    inputs = (inputs.time(),)

    def forward(self, time):
        ones = torch.ones(8, 4)
        line = torch.linspace(0, 1, 8)[:, None] * torch.tensor([1.0, 0.5, 0.2]) + time
        return Gaussians(line, ones[:, 0] * 0.8, ones[:, :3] * 0.1, ones, rgb=ones[:, :3] * 0.5)
"""
ENDLESS = "def busy():\n    while True: pass\n"
# Deaf to alarms, as one long call into C++ is.
DEAF = """
import ctypes, signal
from gsgen.contract.process.interrupts import time_limit

with time_limit(0.1, "too late"):
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
    ctypes.CDLL(None).pause()
"""
ROWS = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 2.0))
PICTURE = ReferenceImage(
    path="picture.png",
    sha256="0" * 64,
    inputs="zeros",
    view=ROWS,
    focal=(8.0, 8.0),
    center=(4.0, 4.0),
    psnr=40.0,
    from_="source",
)
needs_alarms = pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="there are no alarms")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "timed_dots.py").write_text(MODULE, "utf-8")
    (tmp_path / "endless.py").write_text(ENDLESS, "utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "timed_dots", raising=False)
    return tmp_path


def exported_until(
    message: str, monkeypatch: pytest.MonkeyPatch, *options: str
) -> tuple[int, str, str]:
    """Export the dots; time is over when the first message with these words comes."""

    def progress(words: str) -> None:
        if words.startswith(message) and not calls:
            calls.append(words)
            signal.raise_signal(signal.SIGALRM)

    calls: list[str] = []
    monkeypatch.setattr(export_job, "progress", progress)
    words = ["timed_dots:Dots", "-o", "m.onnx", "--verify", "quick", "--timeout", "600", *options]
    result = CliRunner().invoke(app, words)
    assert len(calls) == 1, result.output
    return result.exit_code, result.stdout, result.stderr


@needs_alarms
@pytest.mark.parametrize(
    "stage",
    [STAGES[0], STAGES[2], *(pytest.param(s, marks=pytest.mark.slow) for s in STAGES[1::2])],
)
def test_an_export_out_of_time_names_its_stage_and_writes_nothing(
    folder: Path, monkeypatch: pytest.MonkeyPatch, stage: str
) -> None:
    code, _, message = exported_until(stage, monkeypatch)
    assert code == 1
    assert f"out of time after 600 s (--timeout), {stage}" in message
    assert "Give more with --timeout. Used: building the generator" in message
    assert "m.onnx was not written" in message
    assert not list(folder.glob("*m.onnx*"))
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


@needs_alarms
@pytest.mark.parametrize(
    "message",
    ["replaying", *(pytest.param(m, marks=pytest.mark.slow) for m in LEVELS if m != "replaying")],
)
def test_levels_out_of_time_are_not_checked_and_the_model_is_written(
    folder: Path, monkeypatch: pytest.MonkeyPatch, message: str
) -> None:
    code, out, _ = exported_until(message, monkeypatch, "--json", "--level", "live")
    assert code == 0
    levels = json.loads(out)["validation"]["levels"]
    names = [level["level"] for level in levels]
    assert names == ["static", "values", "behaviour", "live"]
    last = names.index(LEVELS[message])
    assert [level["status"] == "ran" for level in levels] == [number <= last for number in range(4)]
    reasons = {level["reason"] for level in levels[last + 1 :]}
    assert reasons == {"not checked: out of time after 600 s (--timeout)"}
    assert (folder / "m.onnx").exists()


@needs_alarms
@pytest.mark.parametrize("message", ["drawing", "writing pictures"])
def test_a_model_that_agrees_is_written_without_pictures(
    folder: Path, monkeypatch: pytest.MonkeyPatch, message: str
) -> None:
    """Time is over before the first picture, or when all are files and the manifest is not."""

    def draw(*_: object) -> list[tuple[bytes, ReferenceImage]]:
        return [(b"png", PICTURE)]

    def write(*_: object) -> None:
        export_job.progress("writing pictures")

    monkeypatch.setattr(eager_pictures, "draw_source_frames", draw)
    monkeypatch.setattr(source_pictures, "write_manifest_text", write)
    code, out, err = exported_until(message, monkeypatch, "--json", "--pictures", "1")
    assert code == 0
    assert "note: --pictures: no picture was drawn: out of time after 600 s (--timeout)" in err
    levels = json.loads(out)["validation"]["levels"]
    assert [level["status"] for level in levels] == ["ran", "skipped", "skipped"]
    assert [path.name for path in folder.glob("*m*") if path.suffix != ".py"] == ["m.onnx"]
    assert not list(folder.rglob("*.png"))


@needs_alarms
def test_code_that_never_ends_is_ended(folder: Path) -> None:
    ran = gsgen("export", "endless:busy", "-o", "m.onnx", "--timeout", "5", cwd=folder)
    assert ran.code == 1
    assert "out of time after 5 s (--timeout), building the generator" in ran.err
    assert ran.err.endswith("gsgen: m.onnx was not written\n")


@needs_alarms
def test_a_call_that_hears_no_alarm_ends_with_its_process() -> None:
    ran = subprocess.run([sys.executable, "-c", DEAF], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (1, "too late\n")
