"""The command `gsgen tiles replay`: repeats a streamed flight from its event log."""

__all__ = ["replay"]

import json
from pathlib import Path
from typing import Annotated

import typer

from gsgen.contract.errors import ExitCode


def replay(
    tileset: Annotated[
        str,
        typer.Argument(
            help="tileset.json, its folder, a .3tz archive, or an address (http, https).",
            show_default=False,
        ),
    ],
    events: Annotated[
        Path,
        typer.Argument(
            help="Event log that `gsgen render` or `gsgen view` wrote with --log.",
            show_default=False,
        ),
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Replay the event log EVENTS of TILESET, and compare each frame's decisions with the log.

    Cameras, times and arriving tiles are those of the log. Uploads, evictions, fades and missing
    tiles are decided again, by the planner and the pool of the viewer; requests are not compared.
    Exits 0 if all frames agree, 1 at the first one that differs, 2 if EVENTS is of another tileset,
    or 4 if a file cannot be read.
    """
    from dataclasses import asdict

    from gsgen.tiles.simulate.replay import replay_log

    frames, difference = replay_log(tileset, events)
    if as_json:
        document = {"equal_frames": frames, "difference": difference and asdict(difference)}
        typer.echo(json.dumps(document))
    elif difference is None:
        typer.echo(f"{frames:,} frames: all decisions agree with the event log")
    else:
        typer.echo(str(difference))
    if difference is not None:
        raise typer.Exit(ExitCode.FAILURE)
