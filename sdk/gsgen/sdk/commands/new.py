"""`gsgen new`: the package of a plugin, ready to be changed."""

__all__ = ["new"]

from pathlib import Path
from typing import Annotated

import typer


def new(
    name: Annotated[
        str,
        typer.Argument(help="Of the package and of the plugin, such as my-method."),
    ],
    into: Annotated[
        Path, typer.Option(help="Folder in which the package's own folder is made.")
    ] = Path(),
) -> None:
    """Write the package of a plugin NAME: a method, its export command, and tests that pass.

    Exits 0 if it was written, 2 if the name cannot be used or something stands there.
    """
    from gsgen.sdk.plugins.plugin_template import scaffold

    made = scaffold(name, into)
    for file in made.files:
        typer.echo(made.folder / file)
    typer.echo(f"\nNext:\n  cd {made.folder}\n  pip install -e '.[test]'\n  pytest")
