"""Command group `gsgen viewer-kit`: writes test models with pictures, and checks a viewer."""

__all__ = ["app"]

from pathlib import Path
from typing import Annotated

import typer

from gsgen.cli.command_group import SubcommandGroup
from gsgen.cli.output import echo, echo_text
from gsgen.contract._safe_text import for_json
from gsgen.contract.errors import ExitCode, InputUnreadable

app = typer.Typer(
    cls=SubcommandGroup,
    help="Test a viewer: small models, expected pictures, and a verdict for each test.",
    no_args_is_help=True,
)


@app.callback()
def _command_group_root() -> None:
    pass


@app.command("write")
def write(
    output: Annotated[
        Path, typer.Argument(help="The folder to write; must be empty.", show_default=False)
    ],
) -> None:
    """Write a viewer test kit to OUTPUT: models, cameras, inputs, expected pictures, test script.

    Exits 0 if it was written, 2 if it cannot be.
    """
    from gsgen.conformance.viewer_kit.write import kit_cases, write_kit
    from gsgen.runtime.checks.viewer_kit import draw_frames

    index = write_kit(output, draw_frames)
    echo(f"{index}: {len(kit_cases())} cases; check pictures with {output / 'check_viewer.py'}")


@app.command("check")
def check(
    kit: Annotated[
        Path, typer.Argument(help="The folder of the viewer test kit.", show_default=False)
    ],
    pictures: Annotated[
        Path,
        typer.Argument(help="Folder of the viewer's pictures, .npy or .png.", show_default=False),
    ],
    html: Annotated[
        Path | None,
        typer.Option(help="Write an HTML page with all pictures and differences to this file."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Compare a viewer's PICTURES with those of the test kit KIT, and name the likely faults.

    Exits 0 if every case passes, 1 if one fails, 4 if the kit or the folder of pictures cannot be
    read.
    """
    from gsgen.conformance.viewer_kit import check_viewer as checking
    from gsgen.contract.process.atomic_files import atomic_write, require_page

    if html is not None:
        require_page(html)
    try:
        result = checking.check_viewer(kit, pictures)
    except checking.KitUnreadable as error:
        raise InputUnreadable(str(error), hint=error.hint) from error
    text = for_json(result) if as_json else None
    echo_text(text or checking.summary_of(result).rstrip())
    if html is not None:  # after the verdict, which a page that cannot be written must not hide
        with atomic_write(html) as draft:
            draft.write_text(checking.page_of(kit, pictures, result), "utf-8")
    raise typer.Exit(ExitCode.FAILURE if result["verdict"] == "failed" else ExitCode.SUCCESS)
