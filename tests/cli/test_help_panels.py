"""`gsgen --help`: commands in panels, and the lines that install those that are missing."""

from types import SimpleNamespace
from typing import Annotated, Any

import pytest
import typer
from typer.main import get_command

from gsgen.cli.app import _epilog
from gsgen.cli.help_panels import PANELS, arrange_options, panel_of, panel_order


def command(name: str, remedy: str, *missing: str) -> Any:
    return SimpleNamespace(name=name, remedy=remedy, missing=missing)


def test_missing_commands_are_listed_by_their_remedy() -> None:
    commands = [
        command("validate", "none"),
        command("fix", "pip install 'gsgen[sdk]'", "torch"),
        command("render", "pip install 'gsgen[runtime]'", "wgpu"),
        command("rewrite", "pip install 'gsgen[sdk]'", "torch", "onnx-ir"),
    ]
    assert _epilog(commands) == (
        r"Not installed here: fix, rewrite: pip install 'gsgen\[sdk]'; "
        r"render: pip install 'gsgen\[runtime]'"
    )
    assert _epilog(commands[:1]) is None


def test_commands_stand_in_the_order_of_their_panels_and_others_come_last() -> None:
    listed = [name for names in PANELS.values() for name in names]
    commands = sorted(["zebra", *listed, "acme"], key=panel_order)
    assert commands == [*listed, "acme", "zebra"]
    assert panel_of("acme") == panel_of("zebra") != panel_of(listed[-1])


def test_brackets_of_a_help_text_are_shown_and_many_options_are_grouped(
    capsys: pytest.CaptureFixture[str],
) -> None:
    def draw(
        width: Annotated[int | None, typer.Option(help="In px. [default: the camera's]")] = None,
        fov: Annotated[float, typer.Option(rich_help_panel="Lens")] = 0,
    ) -> None:
        """Draw."""

    app = typer.Typer(add_completion=False)
    app.command()(draw)
    program: Any = get_command(app)
    arrange_options(program)
    program(["--help"], standalone_mode=False)
    printed = capsys.readouterr().out
    assert ("[default: the camera's]" in printed, "Camera" in printed) == (True, False)
    program = get_command(app)
    program.params *= 11
    arrange_options(program)
    assert [option.rich_help_panel for option in program.params[:2]] == ["Camera", "Lens"]
