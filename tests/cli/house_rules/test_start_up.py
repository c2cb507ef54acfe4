import os
import subprocess
import sys
from pathlib import Path

import pytest

from gsgen.formats import write_ply
from gsgen.reference_plugins.samples import garden

HEAVY_MODULES = {"torch", "onnxscript", "onnx_ir", "wgpu", "scipy"}


def imported(*words: str, whole: bool = False, code: int = 0) -> set[str]:
    finished = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "gsgen.cli", *words],
        capture_output=True,
        text=True,
        env=os.environ | {"COLUMNS": "200"},
    )
    assert finished.returncode == code, finished.stderr[-2000:]
    lines = [line for line in finished.stderr.splitlines() if line.startswith("import time:")]
    names = {line.rpartition("|")[2].strip() for line in lines}
    return names if whole else {name.partition(".")[0] for name in names}


@pytest.mark.parametrize("words", [("--help",), ("--version",), ("rules",)])
def test_light_commands_import_nothing_heavy(words: tuple[str, ...]) -> None:
    assert imported(*words) & (HEAVY_MODULES | {"onnxruntime"}) == set()


def test_static_validation_imports_nothing_heavy(good: Path) -> None:
    names = imported("validate", "--level", "static", str(good))
    assert "onnx" in names  # the measure works
    assert (
        names & (HEAVY_MODULES | {"onnxruntime", "jsonschema", "jaxtyping", "multiprocessing"})
        == set()
    )
    whole = imported("validate", "--level", "static", str(good), whole=True)
    assert not [name for name in whole if name.startswith(("gsgen.tiles", "gsgen.formats"))]


def test_running_a_model_keeps_onnx_runtime_out_of_the_parent(good: Path) -> None:
    names = imported("validate", "--level", "behaviour", str(good))
    assert names & (HEAVY_MODULES | {"onnxruntime"}) == set()


def test_a_repair_needs_no_torch(good: Path) -> None:
    names = imported("fix", str(good), "--dry-run", code=1)  # nothing is broken
    assert "onnx_ir" in names
    assert "torch" not in names


def test_only_the_reporter_that_is_asked_for_is_imported(good: Path) -> None:
    def reporters(*words: str) -> set[str]:
        names = imported("validate", "--level", "static", str(good), *words, whole=True)
        head = "gsgen.contract.reporters."
        return {name.removeprefix(head) for name in names if name.startswith(head)}

    assert reporters() == {"rule_pages", "summary", "text"}
    # The reporters themselves are imported by name, which the interpreter does not list.
    assert reporters("--format", "json") == {"document", "rule_pages"}
    assert reporters("--format", "junit") == {"summary"}


MODULES = """
import sys
from gsgen.cli import main
try:
    main()
finally:
    print(*sys.modules, file=sys.stderr)
"""


def modules_of(*words: str) -> set[str]:
    command = [sys.executable, "-c", MODULES, *words]
    completed = subprocess.run(command, capture_output=True, text=True, check=True)
    return set(completed.stderr.splitlines()[-1].split())


def modules_of_gsgen(*words: str) -> set[str]:
    return {name for name in modules_of(*words) if name.partition(".")[0] == "gsgen"}


def test_list_of_methods_imports_no_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the help and for TAB; only the exporter's and the plugins' own declarations are read."""
    heavy = HEAVY_MODULES | {"numpy", "onnx", "jaxtyping", "asyncio"}
    assert imported("export", "--help") & heavy == set()
    monkeypatch.setenv("_GSGEN_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "gsgen export ")
    monkeypatch.setenv("COMP_CWORD", "2")
    assert imported() & heavy == set()


@pytest.mark.parametrize("words", [("--help",), ("--version",)])
def test_help_and_version_import_no_command(words: tuple[str, ...]) -> None:
    names = modules_of(*words)
    assert "gsgen.cli.app" in names
    assert not [name for name in names if name.startswith(("gsgen.cli.commands", "typer"))]


def test_validate_imports_few_modules_and_no_other_command(good: Path) -> None:
    names = modules_of_gsgen("validate", "--level", "static", str(good))
    assert len(names) <= 150
    head = "gsgen.cli.commands."
    assert {name.removeprefix(head) for name in names if name.startswith(head)} == {
        "checking", "checking.validate", "checking.validate_file",
    }  # fmt: skip


def test_render_of_a_splat_file_imports_few_modules_and_none_of_tiles(tmp_path: Path) -> None:
    write_ply(tmp_path / "x.ply", garden(300))
    size = ("--width", "32", "--height", "32")
    names = modules_of_gsgen(
        "render", str(tmp_path / "x.ply"), "-o", str(tmp_path / "x.png"), *size
    )
    assert len(names) <= 240
    assert not [name for name in names if name.startswith(("gsgen.tiles", "gsgen.sdk.exporting"))]
    rooms = {name.split(".")[3] for name in names if name.startswith("gsgen.cli.commands.")}
    assert rooms == {"drawing"}
