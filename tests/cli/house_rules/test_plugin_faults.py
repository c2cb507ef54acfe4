"""A plugin that fails in any way is named, and never makes a command end with exit code 0."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gsgen.conformance.fixtures import find
from support.commands import Ran

# What runs a plugin of each entry point group.
COMMANDS = {
    "gsgen.rules": ("validate", "drift.onnx", "--level", "static"),
    "gsgen.fixtures": ("explain", "GV003"),
    "gsgen.generators": ("export", "acme", "-o", "acme.onnx"),
    "gsgen.commands": ("acme",),
    "gsgen.targets": ("validate", "drift.onnx", "--level", "static", "--target", "acme"),
}
FAULTS = {
    "SystemExit(0)": "raise SystemExit(0)",
    "SystemExit(None)": "raise SystemExit(None)",
    "sys.exit": "import sys; sys.exit()",
    "os._exit": "import os; os._exit(0)",
    "GeneratorExit": "raise GeneratorExit",
    "CancelledError": "import asyncio; raise asyncio.CancelledError",
    "own BaseException": "class Stop(BaseException): pass\nraise Stop",
    "recursion": "def again(): again()\nagain()",
    "hostile message": "raise ValueError('a\\x1b[2J\\n::error::b\\u202e')",
    "endless message": "raise ValueError('a' * 10_000_000)",
    "no message": "class Mute(Exception):\n def __str__(self): raise SystemExit(0)\n"
    " __repr__ = __str__\nraise Mute",
}


# One fault of each kind in the fast tests, all of them in the slow ones.
MARKED_FAULTS = [
    pytest.param(name, marks=() if name in ("SystemExit(0)", "os._exit") else pytest.mark.slow)
    for name in FAULTS
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("models")
    find("drift").write(folder)
    return folder


def run_with_plugin(
    folder: Path, site: Path, group: str, code: str, *words: str, name: str = "acme"
) -> Ran:
    """Run a command where a distribution registers the module ``acme_plugin`` with some code."""
    info = site / "acme-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: acme\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{group}]\n{name} = acme_plugin\n", "utf-8")
    (site / "acme_plugin.py").write_text(code, "utf-8")
    completed = subprocess.run(
        [sys.executable, "-P", "-m", "gsgen.cli", *words],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(site), "COLUMNS": "200"},
        capture_output=True,
        text=True,
        timeout=100,
    )
    return Ran(completed.returncode, completed.stdout, completed.stderr)


@pytest.mark.parametrize("fault", MARKED_FAULTS)
@pytest.mark.parametrize("group", COMMANDS)
def test_plugin_that_does_not_load_ends_with_3_and_is_named(
    folder: Path, tmp_path: Path, group: str, fault: str
) -> None:
    completed = run_with_plugin(folder, tmp_path, group, FAULTS[fault], *COMMANDS[group])
    text = completed.out + completed.err
    assert completed.code == 3, text
    assert "acme" in text
    assert "internal error" not in text
    assert len(text) < 10_000
    assert all(char.isprintable() for char in text.replace("\n", ""))
    assert not [line for line in text.splitlines() if line.lstrip().startswith("::")]


@pytest.mark.parametrize(
    ("group", "words"),
    [
        ("gsgen.commands", ("--help",)),
        ("gsgen.commands", ("NAME",)),
        ("gsgen.generators", ("plugins",)),
        ("gsgen.generators", ("export", "--help")),
        ("gsgen.generators", ("export", "NAME")),
        ("gsgen.rules", COMMANDS["gsgen.rules"]),
        ("gsgen.targets", ("validate", "drift.onnx", "--target", "NAME")),
    ],
)
def test_name_of_a_plugin_controls_no_terminal(
    folder: Path, tmp_path: Path, group: str, words: tuple[str, ...]
) -> None:
    name = "acme\x1b[2J\x9b1m\u202e::x"
    typed = [name if word == "NAME" else word for word in words]
    completed = run_with_plugin(folder, tmp_path, group, FAULTS["sys.exit"], *typed, name=name)
    text = completed.out + completed.err
    assert "acme" in text
    assert not set(text) & {"\x1b", "\x9b", "\u202e"}


RULE = """
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.rule import Severity, rule

@rule("acme/AC001", Severity.INFO)
def rule_that_fails(model: InspectedModel):
    "Nothing is required.\\n\\nWhy:\\n    None.\\n\\nHint:\\n    None."
    yield from ()
"""


@pytest.mark.parametrize("fault", MARKED_FAULTS)
@pytest.mark.parametrize("jobs", ["1", pytest.param("2", marks=pytest.mark.slow)])
def test_rule_that_fails_while_it_runs_ends_with_3_and_is_named(
    folder: Path, tmp_path: Path, fault: str, jobs: str
) -> None:
    code = RULE + "".join(f"    {line}\n" for line in FAULTS[fault].split("\n"))
    words = ("validate", "drift.onnx", "drift.onnx", "--level", "static", "--jobs", jobs)
    completed = run_with_plugin(folder, tmp_path, "gsgen.rules", code, *words)
    assert completed.code == 3, completed.out + completed.err
    assert "acme/AC001" in completed.out


def test_rule_without_a_fault_ends_with_0(folder: Path, tmp_path: Path) -> None:
    words = ("validate", "drift.onnx", "--level", "static")
    assert run_with_plugin(folder, tmp_path, "gsgen.rules", RULE, *words).code == 0


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["SystemExit(0)", "os._exit", "GeneratorExit"])
@pytest.mark.parametrize("raising_part", ["module", "factory", "forward"])
def test_own_module_that_ends_the_process_ends_with_a_failure(
    folder: Path, tmp_path: Path, fault: str, raising_part: str
) -> None:
    lines = [f"    {line}" for line in FAULTS[fault].split("\n")]
    module = f"if {raising_part == 'module'}:\n" + "\n".join(lines)
    factory = f"    if {raising_part == 'factory'}:\n" + "\n".join(f"    {line}" for line in lines)
    forward = "\n".join(f"    {line}" for line in lines)
    code = f"""
import torch
from gsgen.sdk import GaussianGenerator
{module}
class Drift(GaussianGenerator):
    def forward(self):
{forward}
def make():
{factory}
    return Drift()
"""
    words = ("export", "acme_plugin:make", "-o", "acme.onnx")
    completed = run_with_plugin(folder, tmp_path, "acme.nothing", code, *words)
    assert completed.code in (1, 2), completed.err
    assert "acme_plugin.py" in completed.err
