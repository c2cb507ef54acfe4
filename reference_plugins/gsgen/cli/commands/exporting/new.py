"""`gsgen new`: create a plugin package from a template."""

__all__ = ["new"]

from pathlib import Path
from typing import Annotated

import typer

from gsgen.cli.output import echo, echo_json
from gsgen.contract._safe_text import for_shell


def new(
    name: Annotated[
        str, typer.Argument(help="Name of the package and of the plugin, such as my-method.")
    ],
    into: Annotated[
        Path, typer.Option(help="Folder that will contain the package's folder.")
    ] = Path(),
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print the paths as JSON.")] = False,
) -> None:
    """Create a plugin package NAME: a method, its export command, and passing tests.

    Exits 0 if it was created, 2 if the name is not valid or the folder exists.
    """
    from gsgen.sdk.plugins.plugin_template import write_plugin_package

    package = write_plugin_package(name, into)
    if as_json:
        files = [str(package.folder / file) for file in package.files]
        echo_json({"folder": str(package.folder), "files": files})
        return
    for file in package.files:
        echo(package.folder / file)
    folder = for_shell(str(package.folder))
    echo("", "Next:", f"  cd {folder}", "  pip install -e '.[test]'", "  pytest")
