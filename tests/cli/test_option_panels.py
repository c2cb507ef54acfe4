"""The help of a command: its options in panels, its texts whole."""

from typing import Annotated, Any

import pytest
import typer
from typer.main import get_command

from gsgen.cli.option_panels import arrange_options


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
