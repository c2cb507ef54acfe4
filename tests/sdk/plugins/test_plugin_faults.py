"""A fault in a plugin's own code is told as its author's, with the line, and not as one of gsgen."""

from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from gsgen.cli.commands.exporting.plugin_function import plugin_function
from gsgen.contract.errors import GsgenError
from gsgen.sdk import Plugin, inputs


def build(checkpoint: Path) -> object:
    """Build a generator; the name of its input is mistyped."""
    return inputs.tme(range=(0, 1))  # type: ignore[attr-defined]


def test_an_error_of_a_plugin_names_the_plugin_and_the_line(tmp_path: Path) -> None:
    plugin = Plugin(name="mine", summary="Mine.", reads="Reads.", inputs=("time",), build=build)
    app = typer.Typer()
    app.command()(plugin_function(plugin))
    ended = CliRunner().invoke(app, ["checkpoint.pt", "-o", str(tmp_path / "mine.onnx")])
    assert isinstance(ended.exception, GsgenError)
    assert ended.exception.where.startswith("mine, test_plugin_faults.py:")
    assert "inputs.tme(range=(0, 1))" in ended.exception.where
    assert "AttributeError" in ended.exception.message
    assert not (tmp_path / "mine.onnx").exists()


def test_an_error_of_our_own_plugin_stays_a_crash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(build, "__module__", "gsgen.reference_plugins.mine")
    plugin = Plugin(name="mine", summary="Mine.", reads="Reads.", inputs=("time",), build=build)
    app = typer.Typer()
    app.command()(plugin_function(plugin))
    ended = CliRunner().invoke(app, ["checkpoint.pt", "-o", str(tmp_path / "mine.onnx")])
    assert isinstance(ended.exception, AttributeError)
