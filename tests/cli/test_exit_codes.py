"""Every command that reads a file ends with 4 where it cannot, whatever it would have done."""

import gc
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gsgen.cli.app import main
from gsgen.sdk.plugin import find_plugins

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
Run = Callable[..., tuple[int, str]]


@pytest.fixture
def run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Iterator[Run]:
    """Run a command line in this process and an empty folder; return its code and its trouble."""
    monkeypatch.chdir(tmp_path)
    threshold = gc.get_threshold()

    def run(*words: str) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["gsgen", *words])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, capsys.readouterr().err

    yield run
    gc.set_threshold(*threshold)


@pytest.mark.parametrize("file", ["gone", "text"])
@pytest.mark.parametrize(
    ("words", "suffix"),
    [
        *(pytest.param(words, ".onnx", id=name) for name, words in MODELS.items()),
        *(pytest.param(words, ".ply", id=f"{name} ply") for name, words in SCENES.items()),
    ],
)
def test_a_file_that_cannot_be_read_is_4(
    run: Run, words: tuple[str, ...], suffix: str, file: str
) -> None:
    Path(f"text{suffix}").write_text("this is nothing of the sort")
    named = f"{file}{suffix}"
    code, said = run(*(named if word == "MODEL" else word for word in words))
    assert code == 4, said
    assert named in said
    assert not list(Path.cwd().glob("out.*"))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("folder", ["gone", "empty"])
def test_a_checkpoint_that_cannot_be_read_is_4(run: Run, method: str, folder: str) -> None:
    Path("empty").mkdir()
    code, said = run("export", method, "--checkpoint", folder, "-o", "out.onnx")
    assert code == 4, said
    assert said.rpartition("gsgen: ")[2].startswith(folder)
    assert not Path("out.onnx").exists()


def test_wrong_options_are_2(run: Run) -> None:
    Path("text.onnx").write_text("no model")
    for words in (
        ("export", "static", "gone.ply", "-o", "out.onnx", "--level", "values2"),
        ("export", "lhm", "--checkpoint", "gone"),
        ("rewrite", "text.onnx"),
        ("validate", "text.onnx", "--target", "core2"),
        ("explain", "GV03"),
    ):
        code, said = run(*words)
        assert code == 2, (words, said)
