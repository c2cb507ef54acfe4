"""The command `gsgen tiles serve`: a web server for tilesets that can simulate a slow network."""

__all__ = ["serve"]

from pathlib import Path
from typing import Annotated

import typer

from gsgen.cli.output import echo
from gsgen.contract.errors import ConfigInvalid, InputUnreadable


def serve(
    folder: Annotated[
        Path,
        typer.Argument(
            help="The folder of a tileset, of several, or of a clip's scene file and segments.",
            show_default=False,
        ),
    ],
    port: Annotated[int, typer.Option(help="0 takes one that is free.", min=0, max=65535)] = 8000,
    host: Annotated[str, typer.Option(help="The address to listen at.")] = "127.0.0.1",
    rate: Annotated[
        float | None,
        typer.Option(
            help="Megabits a second, of all answers together. [default: no limit]",
            min=0.001,
            metavar="MBPS",
        ),
    ] = None,
    latency: Annotated[
        float, typer.Option(help="Milliseconds before an answer begins.", min=0)
    ] = 0.0,
    fail: Annotated[
        list[str] | None,
        typer.Option(
            help="STATUS:SHARE, cut:SHARE or stall:SHARE of answers that fail; repeatable.",
            metavar="WHAT:SHARE",
        ),
    ] = None,
    cors: Annotated[
        list[str] | None,
        typer.Option(
            help="An origin whose pages may read the files, such as https://viewer.example, or *; "
            "repeatable. [default: the server's own pages]",
            metavar="ORIGIN",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the choice which answers fail.")] = 0,
    verbose: Annotated[bool, typer.Option("-v", "--verbose", help="Print each answer.")] = False,
) -> None:
    """Serve FOLDER until Ctrl-C, with ranges, ETags and JSON in gzip; hidden files are left out.

    Prints the address first. Exits 130 at Ctrl-C, 2 for wrong options or a port that is taken,
    4 if there is no such folder.
    """
    from gsgen.contract.fetching.addresses import parse_origin
    from gsgen.tiles.serving.faults import NetworkFaults, parse_failure
    from gsgen.tiles.serving.server import serve_folder

    if not folder.is_dir():
        raise InputUnreadable(
            "is not a folder", where=str(folder), hint="Name the folder of tileset.json."
        )
    faults = NetworkFaults(
        bytes_per_second=rate * 1e6 / 8 if rate else None,
        latency=latency / 1000,
        failures=tuple(parse_failure(text) for text in fail or ()),
        seed=seed,
    )
    try:
        server = serve_folder(
            folder,
            host=host,
            port=port,
            faults=faults,
            log=_print_answer if verbose else _discard_line,
            cors=[
                origin if origin == "*" else str(parse_origin(origin, "--cors"))
                for origin in cors or ()
            ],
        )
    except OSError as error:
        raise ConfigInvalid(
            f"cannot listen: {error.strerror}",
            where=f"{host}:{port}",
            hint="Choose another --port; 0 takes one that is free.",
        ) from error
    with server:
        echo(server.address)
        is_tileset = (folder / "tileset.json").is_file()
        trial = f"; try: gsgen tiles info {server.address}tileset.json" if is_tileset else ""
        echo(f"serving {folder}{trial}", err=True)
        server.serve_forever(poll_interval=0.1)


def _print_answer(line: str) -> None:
    echo(line, err=True)


def _discard_line(line: str) -> None:
    del line
