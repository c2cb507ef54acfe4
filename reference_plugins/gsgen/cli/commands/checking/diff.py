"""The command `gsgen diff`, which compares two models."""

__all__ = ["diff"]

import math
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from gsgen.cli.output import echo, echo_json
from gsgen.contract.errors import ExitCode


def diff(
    first: Annotated[Path, typer.Argument(help="An ONNX file.", show_default=False)],
    second: Annotated[
        Path, typer.Argument(help="The ONNX file to compare with.", show_default=False)
    ],
    tolerance: Annotated[
        float,
        typer.Option(help="Largest absolute difference of outputs that counts as equal.", min=0.0),
    ] = 0.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Compare the declarations, the graphs and the outputs of two ONNX models.

    Exits 0 if they are equal, 1 if they differ, 4 if a file is not an ONNX model.
    """
    from gsgen.contract.tools.model_diff import compare_models

    fact_differences, outputs, reason = compare_models(first, second)
    differing_outputs = [output for output in outputs if output.largest > tolerance]
    code = ExitCode.FAILURE if fact_differences or differing_outputs or reason else ExitCode.SUCCESS
    if as_json:
        document = {
            "facts": [asdict(fact_difference) for fact_difference in fact_differences],
            "outputs": [
                asdict(output) | {"largest": _finite_or_none(output.largest)} for output in outputs
            ],
            "not_compared": reason or None,
        }
        echo_json(document)
        raise typer.Exit(code)
    for fact_difference in fact_differences:
        echo(
            f"{fact_difference.kind}  {fact_difference.name}: {fact_difference.first} → {fact_difference.second}"
        )
    for output in outputs:
        is_same_model = (
            "equal bits"
            if output.largest == 0
            else (
                f"differ by up to {output.largest:.3g}, in {output.rows:,} rows (worst: {output.probe})"
            )
        )
        echo(f"output  {output.role}: {is_same_model}")
    if reason:
        echo(f"outputs were not compared: {reason}")
    if code == ExitCode.SUCCESS:
        echo("no difference")
    raise typer.Exit(code)


def _finite_or_none(number: float) -> float | None:
    """Return a number, or None for infinity and NaN, which JSON cannot represent."""
    return number if math.isfinite(number) else None
