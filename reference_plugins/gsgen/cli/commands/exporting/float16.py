"""`gsgen float16`: convert a model to float16 within its declared tolerances."""

__all__ = ["float16"]

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.cli.model_options import DryRun, PrintJsonOption, copy_of, exit_at_error, first_names
from gsgen.cli.output import echo, echo_json
from gsgen.cli.progress import progress

if TYPE_CHECKING:
    from collections.abc import Iterator

    from gsgen.sdk.float16.convert_model import Float16Result
    from gsgen.sdk.float16.precision_policy import RetainedFloat32


_MAX_NAMES = 6


def float16(
    model: Annotated[
        Path, typer.Argument(help="The ONNX file, with a manifest.", show_default=False)
    ],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="The float16 copy.")] = None,
    keep_outputs: Annotated[
        bool, typer.Option("--keep-outputs", help="Keep outputs in float32.")
    ] = False,
    budget: Annotated[
        int, typer.Option(help="Maximum number of measured choices of nodes.", min=4)
    ] = 200,
    timeout: Annotated[
        float, typer.Option(help="Time limit in seconds for running the copy.", min=0.1)
    ] = 120.0,
    dry_run: DryRun = False,
    as_json: PrintJsonOption = False,
) -> None:
    """Write a float16 copy of MODEL; nodes whose rounding error is too large stay float32.

    Exits 0 if the copy keeps the tolerances, 1 if no copy does (then nothing is written), 4 if
    MODEL is not a model.
    """
    from gsgen.contract.process.limits import Limits
    from gsgen.sdk.float16.convert_model import write_float16

    output = copy_of(output, dry_run=dry_run)
    with exit_at_error():
        result = write_float16(
            model,
            output,
            outputs=not keep_outputs,
            budget=budget,
            limits=Limits(seconds=timeout),
            progress=progress,
        )
    if as_json:
        echo_json(_document(result))
        return
    for line in _report(result):
        echo(line)


def _report(result: "Float16Result") -> "Iterator[str]":
    total = result.converted_count + len(result.retained)
    yield f"{result.converted_count} of {total} nodes compute in float16, with {result.casts} Casts between"
    reasons: dict[str, list[str]] = {}
    for entry in result.retained:
        reasons.setdefault(entry.reason, []).append(entry.node)
    for reason, names in reasons.items():
        yield f"  float32 for {reason}: {first_names(names, _MAX_NAMES)}"
    if result.retained_weights:
        names = [entry.node for entry in result.retained_weights]
        yield f"  stored in float32: {first_names(names, _MAX_NAMES)}"
    yield f"weights {result.bytes_before} → {result.bytes_after} bytes"
    yield f"outputs {result.outputs_before} → {result.outputs_after} bytes per frame"
    yield f"largest errors: {result.parity.describe()}"
    yield f"measured {result.measured} choices"
    if result.path is not None:
        yield f"wrote {result.path}"


def _entry_document(entry: "RetainedFloat32") -> dict[str, object]:
    return {"node": entry.node, "why": entry.reason, "excess": entry.excess}


def _document(result: "Float16Result") -> dict[str, object]:
    return {
        "path": str(result.path) if result.path else None,
        "halved": result.converted_count,
        "kept": [_entry_document(entry) for entry in result.retained],
        "kept_weights": [_entry_document(entry) for entry in result.retained_weights],
        "casts": result.casts,
        "fields": [asdict(field_error) for field_error in result.parity.fields],
        "weights": {"before": result.bytes_before, "after": result.bytes_after},
        "outputs": {"before": result.outputs_before, "after": result.outputs_after},
        "measured": result.measured,
    }
