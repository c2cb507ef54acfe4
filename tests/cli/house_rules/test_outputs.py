"""What is written goes to its place whole or not at all; what keeps it from there is one line."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures import find
from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.process.atomic_files import atomic_write
from gsgen.formats import FileUnwritable, write_ply
from support.commands import gsgen_here
from support.splat_files import scene

SMALL_SIZE_ARGS = ("--width", "32", "--height", "24", "--rasteriser", "tiles")
# What is typed before and after the output, how it ends, and the code where it cannot be.
WRITING_COMMANDS: dict[str, tuple[tuple[str, ...], str, tuple[str, ...], int]] = {
    "validate": (("validate", "MODEL", "--level", "static", "-o"), ".txt", (), 2),
    "export": (("export", "static", "cloud.npz", "--level", "static", "-o"), ".onnx", (), 2),
    "render a picture": (("render", "cloud.npz", *SMALL_SIZE_ARGS, "-o"), ".png", (), 2),
    "render floats": (("render", "cloud.npz", *SMALL_SIZE_ARGS, "-o"), ".npy", (), 2),
    "render a GIF": (("render", "cloud.npz", *SMALL_SIZE_ARGS, "-o"), ".gif", (), 2),
    "render a film": (("render", "cloud.npz", *SMALL_SIZE_ARGS, "-o"), ".mp4", (), 2),
    "render pictures": (("render", "cloud.npz", *SMALL_SIZE_ARGS, "--frames", "2", "-o"), "", (), 2),
    "convert": (("convert", "cloud.npz"), ".ply", (), 2),
    "references": (("references", "MODEL", "--width", "16", "--count", "1", "-o"), ".onnx", (), 2),
}  # fmt: skip


@pytest.fixture(autouse=True)
def _files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    rows = np.zeros((400, 10), np.float32)
    rows[:, :3] = rng.normal(size=(400, 3))
    rows[:, 3], rows[:, [4, 7, 9]] = 0.8, 0.02
    color = rng.uniform(size=(400, 3)).astype(np.float32)
    np.savez(tmp_path / "cloud.npz", gaussians=rows, appearance=color)
    find("drift").write(tmp_path).rename(tmp_path / "MODEL")
    (tmp_path / "file").touch()
    monkeypatch.chdir(tmp_path)


def run_writing_command(name: str, output: str) -> tuple[int, list[str]]:
    before, suffix, after, _ = WRITING_COMMANDS[name]
    completed = gsgen_here(*before, f"{output}{suffix}", *after)
    assert completed.code or f"{output}{suffix}" in completed.out  # it says what it wrote
    return completed.code, [
        line for line in completed.err.splitlines() if line.startswith("gsgen: ")
    ] if "Traceback" not in completed.err else [completed.err]


@pytest.mark.parametrize("name", WRITING_COMMANDS)
def test_unwritable_output_is_reported_in_one_line(name: str) -> None:
    code, (message,) = run_writing_command(name, "file/out")
    assert code == WRITING_COMMANDS[name][3]
    assert message.startswith("gsgen: file/out")
    assert "cannot be written" in message


@pytest.mark.parametrize(
    "name", ["validate", "export", "render a picture", "render floats", "convert"]
)
def test_folder_as_output_file_is_refused(name: str) -> None:
    Path(f"out{WRITING_COMMANDS[name][1]}").mkdir()
    code, (message,) = run_writing_command(name, "out")
    assert code == WRITING_COMMANDS[name][3]
    assert message.startswith(f"gsgen: out{WRITING_COMMANDS[name][1]}: ")
    assert not list(Path(f"out{WRITING_COMMANDS[name][1]}").iterdir())


@pytest.mark.parametrize("name", ["validate", "convert"])
def test_file_size_limit_is_reported(name: str) -> None:
    """The limit of a process says the same as a full disk, but drivers do not survive it."""
    before, suffix, after, code = WRITING_COMMANDS[name]
    limited = (
        "import resource; from gsgen.cli import main; "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (60, 60)); main()"
    )
    words = [sys.executable, "-c", limited, *before, f"out{suffix}", *after]
    finished = subprocess.run(words, capture_output=True, text=True)
    assert finished.returncode == code, finished.stderr
    assert "cannot be written: " in finished.stderr
    assert "Traceback" not in finished.stderr
    assert _left() == ["MODEL", "cloud.npz"]


def _left() -> list[str]:
    result = (path.name for path in Path().rglob("*") if path.name not in ("out", "file"))
    return sorted(result)


@pytest.mark.parametrize(
    ("name", "output"),
    [
        ("validate", "out"),
        ("export", "new/and/deep"),
        ("render pictures", "new/and/deep"),
        ("convert", "new/and/deep"),
    ],
)
def test_an_output_is_named_and_missing_parent_folders_are_created(name: str, output: str) -> None:
    code, message = run_writing_command(name, output)
    assert (code, message) == (0, [])
    assert Path(f"{output}{WRITING_COMMANDS[name][1]}").exists()


@pytest.mark.parametrize("words", [("rules",), ("--help",)])
def test_a_full_disk_behind_stdout_is_one_line(words: tuple[str, ...]) -> None:
    with Path("/dev/full").open("wb") as full:
        finished = subprocess.run(
            [sys.executable, "-m", "gsgen.cli", *words],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert finished.returncode == 2
    assert finished.stderr.startswith("gsgen: output, or a temporary file, cannot be written: ")
    assert len(finished.stderr.splitlines()) == 2


def test_device_file_is_not_replaced(tmp_path: Path) -> None:
    """As root, a file that is moved to /dev/null would be there in its place."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(ConfigInvalid, match="is a device or a pipe"), atomic_write(pipe):
        pass
    with pytest.raises(FileUnwritable, match="is a device or a pipe"):
        write_ply(pipe, scene(3, 0))
    assert pipe.is_fifo()


@pytest.mark.parametrize("name", ["/dev/stdout", "/dev/fd/1"])
@pytest.mark.parametrize("kind", ["a pipe", "a file"])
def test_report_to_dev_stdout_replaces_no_file(name: str, kind: str) -> None:
    code = (
        "import sys; from pathlib import Path; from gsgen.cli.output import "
        "write_text; write_text(Path(sys.argv[1]), 'a report')"
    )
    words = [sys.executable, "-c", code, name]
    before = os.lstat("/dev/stdout").st_ino
    if kind == "a pipe":
        message = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    else:
        with Path("said").open("w", encoding="utf-8") as file:
            subprocess.run(words, stdout=file, check=True)
        message = Path("said").read_text(encoding="utf-8")
    assert message == "a report"
    assert os.lstat("/dev/stdout").st_ino == before


def test_a_report_to_a_device_leaves_it_there() -> None:
    finished = subprocess.run(
        [sys.executable, "-m", "gsgen.cli", "validate", "MODEL", "--level", "static",
         "-o", "/dev/null"],
        capture_output=True,
        text=True,
    )  # fmt: skip
    assert finished.returncode == 0, finished.stderr
    assert finished.stdout == ""
    assert not Path("/dev/null").is_file()


def test_input_error_is_not_reported_for_the_output(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), atomic_write(tmp_path / "out"):
        (tmp_path / "gone").read_bytes()
