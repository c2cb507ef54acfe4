"""The command `gsgen tiles pack`, which puts the folder of a tileset into one .3tz archive."""

__all__ = ["pack"]

from pathlib import Path
from typing import Annotated

import typer

from gsgen.cli.output import echo
from gsgen.contract.errors import InputUnreadable


def pack(
    folder: Annotated[
        Path, typer.Argument(help="The folder of a tileset.json.", show_default=False)
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="The .3tz archive.", show_default=False)
    ],
) -> None:
    """Pack the tileset in FOLDER into a .3tz archive, which servers send by byte ranges.

    Equal folders give equal archives. Exits 0, 2 if the archive cannot be written, 4 if FOLDER
    has no tileset.json.
    """
    from gsgen.contract.process.atomic_files import refuse_itself
    from gsgen.formats.tileset_paths import INDEX_FILE
    from gsgen.tiles.stores.zip_store import write_archive

    if not (folder / INDEX_FILE).is_file():
        raise InputUnreadable(
            f"the folder has no {INDEX_FILE}; expected the folder of a tileset",
            where=str(folder),
            hint="`gsgen tiles build SCENE -o FOLDER` builds one.",
        )
    if output.is_file() and output.resolve().is_relative_to(folder.resolve()):
        refuse_itself(output, (path for path in folder.rglob("*") if path.suffix != ".3tz"))
    count = write_archive(folder, output)
    echo(f"{output}: {count:,} files, {output.stat().st_size / 1e6:,.1f} MB")
