"""`gsgen samples`: writes sample files to try the other commands with."""

__all__ = ["samples"]

import json
from pathlib import Path
from typing import Annotated

import typer


def samples(
    folder: Annotated[Path, typer.Argument(help="Folder to write the files into.", metavar="DIR")],
    *,
    force: Annotated[
        bool, typer.Option("--force", help="Replace files of the same names and other content.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the paths as JSON.")] = False,
) -> None:
    """Write sample files into DIR: a garden of splats, cameras, a generator and a motion for it.

    Exits 0 if all were written, 2 if DIR cannot be written to or has other files of these names.
    """
    from gsgen.reference_plugins.samples.files import SAMPLE_WRITERS, write_samples

    paths = write_samples(folder, force=force)
    if as_json:
        typer.echo(json.dumps([str(path) for path in paths], indent=2))
        return
    for path in paths:
        typer.echo(f"{path}: {SAMPLE_WRITERS[path.name][0]}")
    enter_text = "" if folder == Path() else f"  cd {folder}\n"
    next_commands = "  gsgen render scene.json -o garden.png\n  gsgen validate sunflower.onnx"
    typer.echo(f"\nNext:\n{enter_text}{next_commands}")
