"""An output that cannot be written: one line with the cause, exit code 2, and no part of a file."""

from pathlib import Path
from typing import Final

import numpy as np
import pytest

from gsgen.cli.command_table import PANELS
from gsgen.cli.commands.tiles.group import app as tiles_app
from gsgen.conformance.fixtures import find
from support.commands import gsgen_here
from support.unwritable_runs import (
    FULL_DISK,
    LOCKED_FOLDER,
    READ_ONLY_DISK,
    can_mount,
    run_commands,
)

pytestmark = pytest.mark.skipif(not can_mount(), reason="no namespaces to mount a full disk in")

SMALL: Final = ("--width", "32", "--height", "24", "--rasteriser", "tiles")
# Command → words with the output OUT, and the suffix of the output.
FILE_COMMANDS: Final[dict[str, tuple[str, ...]]] = {
    "validate": ("validate", "in/drift.onnx", "--level", "static", "-o", "OUT.txt"),
    "validate to a page": (
        "validate", "in/drift.onnx", "--level", "static", "--format", "html", "-o", "OUT.html",
    ),
    "card": ("card", "in/drift.onnx", "-o", "OUT.md"),
    "export": ("export", "static", "in/cloud.npz", "--level", "static", "-o", "OUT.onnx"),
    "export report": (
        "export", "static", "in/cloud.npz", "--level", "static", "-o", "in/x.onnx", "--report", "OUT.json",
    ),
    "export html": ("export", "html", "in/cloud.ply", "-o", "OUT.html"),
    "fix": ("fix", "in/count_is_int64.onnx", "-o", "OUT.onnx"),
    "rewrite": ("rewrite", "in/drift.onnx", "-o", "OUT.onnx"),
    "float16": ("float16", "in/still_rgb.onnx", "-o", "OUT.onnx"),
    "references": ("references", "in/drift.onnx", "--width", "16", "--count", "1", "-o", "OUT.onnx"),
    "vectors copy": ("vectors", "in/drift.onnx", "--count", "1", "--into", "in/vectors", "-o", "OUT.onnx"),
    "render a picture": ("render", "in/cloud.npz", *SMALL, "-o", "OUT.png"),
    "render 16 bits": ("render", "in/cloud.npz", *SMALL, "--bits", "16", "-o", "OUT.png"),
    "render a JPEG": ("render", "in/cloud.npz", *SMALL, "-o", "OUT.jpg"),
    "render floats": ("render", "in/cloud.npz", *SMALL, "-o", "OUT.npy"),
    "render EXR": ("render", "in/cloud.npz", *SMALL, "-o", "OUT.exr"),
    "render a GIF": ("render", "in/cloud.npz", *SMALL, "-o", "OUT.gif"),
    "render a film": ("render", "in/cloud.npz", *SMALL, "-o", "OUT.mp4"),
    "bench": ("bench", "in/drift.onnx", "--provider", "cpu", "--frames", "1", "-o", "OUT.json"),
    "bench-render": ("bench-render", "in/cloud.npz", *SMALL[:4], "--frames", "1", "-o", "OUT.json"),
    "convert to ply": ("convert", "in/cloud.npz", "OUT.ply"),
    "convert to compressed ply": ("convert", "in/cloud.npz", "OUT.compressed.ply"),
    "convert to spz": ("convert", "in/cloud.npz", "OUT.spz"),
    "convert to glb": ("convert", "in/cloud.npz", "OUT.glb"),
    "convert to sog": ("convert", "in/cloud.npz", "OUT.sog"),
    "convert to splat": ("convert", "in/cloud.npz", "OUT.splat"),
    "convert histograms": ("convert", "in/cloud.npz", "in/x.ply", "--histograms", "OUT.png"),
    "bake": ("bake", "in/drift.onnx", "--time", "0", "-o", "OUT.ply"),
    "tiles pack": ("tiles", "pack", "in/tiles", "-o", "OUT.3tz"),
    "tiles score": ("tiles", "score", "in/tiles/tileset.json", "in/cloud.ply", "-o", "OUT.png"),
}  # fmt: skip
# Command → words with the folder OUT that it writes.
FOLDER_COMMANDS: Final[dict[str, tuple[str, ...]]] = {
    "samples": ("samples", "OUT"),
    "new": ("new", "acme-splats", "--into", "OUT"),
    "rules": ("rules", "--pages", "OUT"),
    "vectors": ("vectors", "in/drift.onnx", "--count", "1", "--into", "OUT"),
    "viewer-kit": ("viewer-kit", "write", "OUT"),
    "render frames": ("render", "in/cloud.npz", *SMALL, "--frames", "2", "-o", "OUT"),
    "convert to meta.json": ("convert", "in/cloud.npz", "OUT/meta.json"),
    "convert to lod-meta.json": ("convert", "in/cloud.npz", "OUT/lod-meta.json"),
    "bake frames": ("bake", "in/drift.onnx", "--time", "0:1:2", "-o", "OUT/%04d.ply"),
    "tiles build": ("tiles", "build", "in/cloud.ply", "-o", "OUT"),
    "conformance": ("conformance", "in/nan_row.onnx", "--dump", "OUT"),
    "repro": ("repro", "in/nan_row.onnx", "--rule", "GV001", "--dump", "OUT/dump.npz"),
}
# Commands without an output, and `view`, which writes at a key.
READING_COMMANDS: Final = {
    "diff", "doctor", "explain", "inspect", "plugins", "tiles info", "tiles serve",
    "tiles simulate", "view",
}  # fmt: skip
SLOW: Final = {
    "bench", "bench-render", "card", "conformance", "export html", "fix", "float16", "references", "render 16 bits", "render a JPEG", "render a GIF", "render a film", "render floats", "render frames", "repro", "rewrite", "tiles score", "tiles build", "tiles pack", "vectors", "vectors copy", "viewer-kit", "export report", "convert to sog", "convert to lod-meta.json", "bake frames",
}  # fmt: skip
# Fault → folder of the output.
FAULTS: Final = {
    "full disk": f"{FULL_DISK}/out",
    "read-only disk": f"{READ_ONLY_DISK}/out",
    "no permission": f"{LOCKED_FOLDER}/out",
    "below a file": "in/file/out",
    "name too long": "n" * 256,
    "other kind": "taken",  # a folder where a file is to be written, and vice versa
}
CAUSES: Final = {
    "full disk": "No space left on device",
    "read-only disk": "Read-only file system",
    "no permission": "Permission denied",
    "below a file": "Not a directory",
    "name too long": "File name too long",
    "other kind": "",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with inputs of all commands."""
    inputs = tmp_path / "in"
    inputs.mkdir()
    rng = np.random.default_rng(0)
    rows = np.zeros((400, 10), np.float32)
    rows[:, :3] = rng.normal(size=(400, 3))
    rows[:, 3], rows[:, [4, 7, 9]] = 0.8, 0.02
    color = rng.uniform(size=(400, 3)).astype(np.float32)
    np.savez(inputs / "cloud.npz", gaussians=rows, appearance=color)
    (inputs / "file").touch()
    return tmp_path


COMMANDS: Final = [
    pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else [])
    for name in (*FILE_COMMANDS, *FOLDER_COMMANDS)
]


@pytest.mark.parametrize("name", COMMANDS)
def test_unwritable_output_is_one_line_with_exit_code_2(folder: Path, name: str) -> None:
    is_file = name in FILE_COMMANDS
    words = FILE_COMMANDS[name] if is_file else FOLDER_COMMANDS[name]
    _write_inputs(folder / "in", words)
    commands = [
        [word.replace("OUT", output_path) for word in words] for output_path in FAULTS.values()
    ]
    _occupy(folder, next(word for word in words if "OUT" in word).replace("OUT", "taken"), is_file)
    before = _files(folder)
    runs = run_commands(folder, commands)
    for (fault, cause), run in zip(CAUSES.items(), runs, strict=True):
        lines = [line for line in run.err.splitlines() if line.startswith("gsgen: ")]
        assert len(lines) == 1, (fault, run)
        assert cause in lines[0], (fault, run)
        assert "Traceback" not in run.err
        assert run.code == 2, (fault, run)
    assert _files(folder) - {"in/x.onnx", "in/x.ply"} == before


def _write_inputs(inputs: Path, words: tuple[str, ...]) -> None:
    if any("cloud.ply" in word or "in/tiles" in word for word in words):
        assert gsgen_here("convert", inputs / "cloud.npz", inputs / "cloud.ply").code == 0
    if any("in/tiles" in word for word in words):
        assert gsgen_here("tiles", "build", inputs / "cloud.ply", "-o", inputs / "tiles").code == 0
    for word in words:
        if (
            word.endswith(".onnx")
            and word.startswith("in/")
            and not (inputs.parent / word).exists()
            and word != "in/x.onnx"
        ):
            find(Path(word).stem).write(inputs)


def _occupy(folder: Path, output: str, is_file: bool) -> None:
    """Put a folder where the command writes a file, and a file where it writes a folder."""
    if is_file:
        (folder / output).mkdir()
    else:
        (folder / output.partition("/")[0]).touch()


def _files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def test_every_command_that_writes_is_in_the_table() -> None:
    commands = {command.name for panel in PANELS.values() for command in panel} - {"tiles"}
    commands |= {f"tiles {command.name}" for command in tiles_app.registered_commands}
    rows = [*FILE_COMMANDS.values(), *FOLDER_COMMANDS.values()]
    writing_commands = {" ".join(words[: 1 + (words[0] == "tiles")]) for words in rows}
    assert commands - writing_commands == READING_COMMANDS
