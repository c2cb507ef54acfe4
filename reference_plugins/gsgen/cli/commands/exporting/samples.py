"""`gsgen samples`: writes sample files to try the other commands with."""

__all__ = ["samples"]

from pathlib import Path
from typing import Annotated

import typer

from gsgen.cli.output import echo, echo_json
from gsgen.contract._safe_text import for_shell


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
        echo_json([str(path) for path in paths])
        return
    for path in paths:
        echo(f"{path}: {SAMPLE_WRITERS[path.name][0]}")
    echo("", "Next:", *([] if folder == Path() else [f"  cd {for_shell(str(folder))}"]))
    echo("  gsgen render scene.json -o garden.png", "  gsgen validate sunflower.onnx")
