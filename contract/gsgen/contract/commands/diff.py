"""`gsgen diff`: how two models differ."""

__all__ = ["diff"]

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from gsgen.contract.errors import ModelUnreadable

_UNREADABLE = 4


def diff(
    first: Annotated[Path, typer.Argument(help="An ONNX file.", show_default=False)],
    second: Annotated[Path, typer.Argument(help="Another.", show_default=False)],
    tolerance: Annotated[
        float,
        typer.Option(help="Largest difference of outputs that counts as none.", min=0.0),
    ] = 0.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Show how two models differ: what they declare, their graphs, and what they emit.

    Exits 0 if they do not, 1 if they do, 4 if a file is no model.
    """
    from gsgen.contract.tools.model_diff import compare_models

    try:
        facts, outputs, reason = compare_models(first, second)
    except ModelUnreadable as error:
        typer.echo(f"gsgen: {error}", err=True)
        raise typer.Exit(_UNREADABLE) from error
    apart = [one for one in outputs if one.largest > tolerance]
    if as_json:
        made = {
            "facts": [asdict(one) for one in facts],
            "outputs": [asdict(one) | {"largest": _finite(one.largest)} for one in outputs],
            "not_compared": reason or None,
        }
        typer.echo(json.dumps(made, indent=2, ensure_ascii=False))
        raise typer.Exit(int(bool(facts or apart or reason)))
    for fact in facts:
        typer.echo(f"{fact.kind}  {fact.what}: {fact.first} → {fact.second}")
    for one in outputs:
        same = (
            "equal bits"
            if one.largest == 0
            else (
                f"up to {one.largest:.3g} apart, {one.rows:,} rows differ (worst: {one.probe})"
            )
        )
        typer.echo(f"output  {one.role}: {same}")
    if reason:
        typer.echo(f"outputs were not compared: {reason}")
    if not facts and not apart and not reason:
        typer.echo("no difference")
    raise typer.Exit(int(bool(facts or apart or reason)))


def _finite(number: float) -> float | None:
    """Return a number as JSON has it: null where it has none, as for shapes that differ."""
    return number if math.isfinite(number) else None
