"""`gsgen float16`: compute in float16 wherever that does not show."""

__all__ = ["float16"]

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.contract.commands.progress import clear, progress
from gsgen.contract.errors import ConfigInvalid, GsgenError, ModelUnreadable

if TYPE_CHECKING:
    from collections.abc import Iterator

    from gsgen.sdk.float16.convert_model import Float16Result


_UNREADABLE = 4
_SHOWN = 6


def float16(
    model: Annotated[
        Path, typer.Argument(help="The ONNX file, with a manifest.", show_default=False)
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The float16 copy.")
    ] = None,
    keep_outputs: Annotated[
        bool, typer.Option("--keep-outputs", help="Outputs stay float32.")
    ] = False,
    budget: Annotated[
        int, typer.Option(help="How many choices of nodes may be measured.", min=4)
    ] = 200,
    timeout: Annotated[
        float, typer.Option(help="Seconds that running the copy may take.", min=0.1)
    ] = 120.0,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Write nothing; say what would change.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Write a float16 copy of MODEL; what would show stays float32, which is measured.

    Exits 0 if the copy keeps the tolerances, 1 if none does (then nothing is written), 4 if MODEL
    is no model.
    """
    from gsgen.contract.process.limits import Limits
    from gsgen.sdk.commands.copies import copy_of
    from gsgen.sdk.float16.convert_model import write_float16

    output = copy_of(output, dry_run)
    try:
        done = write_float16(
            model,
            output,
            outputs=not keep_outputs,
            budget=budget,
            limits=Limits(seconds=timeout),
            progress=progress,
        )
    except ConfigInvalid:
        raise
    except GsgenError as error:
        clear()
        typer.echo(f"gsgen: {error}", err=True)
        code = _UNREADABLE if isinstance(error, ModelUnreadable) else 1
        raise typer.Exit(code) from error
    clear()
    if as_json:
        typer.echo(json.dumps(_document(done), indent=2, ensure_ascii=False))
        return
    for line in _report(done):
        typer.echo(line)


def _report(done: "Float16Result") -> "Iterator[str]":
    total = done.halved + len(done.kept)
    yield f"{done.halved} of {total} nodes compute in float16, with {done.casts} Casts between"
    reasons: dict[str, list[str]] = {}
    for one in done.kept:
        reasons.setdefault(one.why, []).append(one.node)
    for why, names in reasons.items():
        more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
        yield f"  float32 for {why}: {', '.join(names[:_SHOWN])}{more}"
    if done.kept_weights:
        names = [one.node for one in done.kept_weights]
        more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
        yield f"  stored in float32: {', '.join(names[:_SHOWN])}{more}"
    yield f"weights {done.bytes_before} → {done.bytes_after} bytes"
    yield f"outputs {done.outputs_before} → {done.outputs_after} bytes a frame"
    yield f"largest errors: {done.parity.describe()}"
    yield f"measured {done.measured} choices"
    if done.path is not None:
        yield f"wrote {done.path}"


def _document(done: "Float16Result") -> dict[str, object]:
    return {
        "path": str(done.path) if done.path else None,
        "halved": done.halved,
        "kept": [asdict(one) for one in done.kept],
        "kept_weights": [asdict(one) for one in done.kept_weights],
        "casts": done.casts,
        "fields": [asdict(one) for one in done.parity.fields],
        "weights": {"before": done.bytes_before, "after": done.bytes_after},
        "outputs": {"before": done.outputs_before, "after": done.outputs_after},
        "measured": done.measured,
    }
