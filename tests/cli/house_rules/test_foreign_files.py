"""Each command says what a file is that it cannot read, and names no other format as the file's."""

from collections.abc import Callable
from pathlib import Path

import pytest

from support.commands import gsgen_here
from support.foreign_files import FOREIGN_FILES

Words = list[str | Path]
COMMANDS: dict[str, Callable[[Path, Path], Words]] = {
    "render": lambda file, out: ["render", file, "-o", out / "a.png"],
    "convert": lambda file, out: ["convert", file, out / "a.spz"],
    "validate": lambda file, _: ["validate", file],
    "inspect": lambda file, _: ["inspect", file],
    "tiles info": lambda file, _: ["tiles", "info", file],
    "tiles build": lambda file, out: [
        "tiles",
        "build",
        file,
        "-o",
        out / "t",
        "--engine",
        "serial",
    ],
}
OTHER_COMMANDS: dict[str, Callable[[Path, Path], Words]] = {
    "view": lambda file, _: ["view", file, "--web", "--port", "1"],
    "bake": lambda file, out: ["bake", file, "-o", out / "a.ply"],
    "export static": lambda file, out: ["export", "static", file, "-o", out / "a.onnx"],
    "export html": lambda file, out: ["export", "html", file, "-o", out / "a.html"],
    "fix": lambda file, out: ["fix", file, "-o", out / "a.onnx"],
    "rewrite": lambda file, out: ["rewrite", file, "-o", out / "a.onnx"],
    "float16": lambda file, out: ["float16", file, "-o", out / "a.onnx"],
    "diff": lambda file, _: ["diff", file, file],
    "tiles score": lambda file, _: ["tiles", "score", file, file],
}
# What readers say of content that they took for theirs.
MISNOMERS = ("is not JSON", "means", "appearance", "first bytes", "Traceback", "internal error")


@pytest.mark.parametrize("command", COMMANDS)
def test_a_foreign_file_is_named_by_each_command(command: str, tmp_path: Path) -> None:
    assert unnamed(COMMANDS[command], tmp_path) == {}


@pytest.mark.slow
@pytest.mark.parametrize("command", OTHER_COMMANDS)
def test_a_foreign_file_is_named_by_each_further_command(command: str, tmp_path: Path) -> None:
    assert unnamed(OTHER_COMMANDS[command], tmp_path) == {}


def unnamed(command: Callable[[Path, Path], Words], folder: Path) -> dict[str, str]:
    """Run a command on each foreign file; return the output of those that it does not name."""
    wrong = {}
    out = folder / "out"
    for name, (content, words) in FOREIGN_FILES.items():
        file = folder / name
        file.write_bytes(content)
        completed = gsgen_here(*command(file, out), cwd=folder)
        text = completed.out + completed.err
        is_named = words in completed.err and not any(word in text for word in MISNOMERS)
        if completed.code not in (1, 2, 4) or not is_named or out.exists():
            wrong[name] = f"{completed.code}: {text}"
    return wrong
