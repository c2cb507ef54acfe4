"""Every command that reads a file ends with 4 where it cannot, whatever it would have done."""

import re
from pathlib import Path

import pytest

from gsgen.contract.errors import ExitCode
from gsgen.sdk.plugins.plugin import find_plugins
from support.commands import ROOT, gsgen_here

# What is typed for MODEL, where the file named is none.
MODELS = {
    "bench": ("bench", "MODEL"),
    "bench-render": ("bench-render", "MODEL"),
    "conformance": ("conformance", "MODEL"),
    "diff": ("diff", "MODEL", "MODEL"),
    "fix": ("fix", "MODEL", "-o", "out.onnx"),
    "float16": ("float16", "MODEL", "-o", "out.onnx"),
    "inspect": ("inspect", "MODEL"),
    "inspect --emit-manifest": ("inspect", "MODEL", "--emit-manifest"),
    "references": ("references", "MODEL", "-o", "out.onnx"),
    "render": ("render", "MODEL", "-o", "out.png"),
    "repro": ("repro", "MODEL", "--rule", "GV003"),
    "rewrite": ("rewrite", "MODEL", "-o", "out.onnx"),
    "validate": ("validate", "MODEL"),
    "vectors": ("vectors", "MODEL"),
}
SCENES = {
    "bench-render": ("bench-render", "MODEL"),
    "convert": ("convert", "MODEL", "out.ply"),
    "export static": ("export", "static", "MODEL", "-o", "out.onnx"),
    "render": ("render", "MODEL", "-o", "out.png"),
}
METHODS = sorted(set(find_plugins()) - {"static"})


@pytest.fixture(autouse=True)
def _work_in_tmp_path(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("file", ["gone", "text"])
@pytest.mark.parametrize(
    ("words", "suffix"),
    [
        *(pytest.param(words, ".onnx", id=name) for name, words in MODELS.items()),
        *(pytest.param(words, ".ply", id=f"{name} ply") for name, words in SCENES.items()),
    ],
)
def test_unreadable_file_exits_4(words: tuple[str, ...], suffix: str, file: str) -> None:
    Path(f"text{suffix}").write_text("this is nothing of the sort", encoding="utf-8")
    by_name = f"{file}{suffix}"
    completed = gsgen_here(*(by_name if word == "MODEL" else word for word in words))
    assert completed.code == 4, completed.err
    assert by_name in completed.err
    assert not list(Path.cwd().glob("out.*"))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("folder", ["gone", "empty"])
def test_unreadable_checkpoint_exits_4(method: str, folder: str) -> None:
    Path("empty").mkdir()
    completed = gsgen_here("export", method, "--checkpoint", folder, "-o", "out.onnx")
    assert completed.code == 4, completed.err
    assert completed.err.rpartition("gsgen: ")[2].startswith(folder)
    assert not Path("out.onnx").exists()


def test_invalid_options_exit_2() -> None:
    Path("text.onnx").write_text("no model", encoding="utf-8")
    for words in (
        ("export", "static", "gone.ply", "-o", "out.onnx", "--level", "values2"),
        ("export", "lhm", "--checkpoint", "gone"),
        ("rewrite", "text.onnx"),
        ("validate", "text.onnx", "--target", "core2"),
        ("explain", "GV03"),
    ):
        completed = gsgen_here(*words)
        assert completed.code == 2, (words, completed.err)


def test_documented_exit_codes_are_those_of_the_program() -> None:
    text = (ROOT / "docs" / "commands.md").read_text("utf-8")
    section = text.partition("## Exit codes\n")[2].partition("\n## ")[0]
    assert {int(code) for code in re.findall(r"^\| (\d+) \|", section, re.MULTILINE)} == set(
        ExitCode
    )
