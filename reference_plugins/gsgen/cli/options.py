"""Command-line options that several gsgen commands share: name, default and help text."""

__all__ = [
    "OPTION_ORDER",
    "Config",
    "FailOn",
    "LevelName",
    "Memory",
    "PrintJsonOption",
    "Seed",
    "TargetName",
    "Timeout",
]

from pathlib import Path
from typing import Annotated

import typer

OPTION_ORDER = "gsgen.option_order"
"""Key of ``Context.meta`` with the names of the parameters in the order typed, with repetitions."""

LevelName = Annotated[
    str | None,
    typer.Option(
        help="How far to go: static, values, behaviour, live or render.", show_default="behaviour"
    ),
]
TargetName = Annotated[
    str | None,
    typer.Option(
        help="Consumer to validate for: core, webgpu, visionary, gsgen.", show_default="core"
    ),
]
FailOn = Annotated[
    str | None,
    typer.Option(help="Lowest severity that fails: error, warning or info.", show_default="error"),
]
PrintJsonOption = Annotated[
    bool, typer.Option("--json", help="Print as JSON: the same as --format json.")
]
Config = Annotated[
    Path | None,
    typer.Option(
        help="Configuration file.", show_default="./gsgen.toml, or [tool.gsgen] of ./pyproject.toml"
    ),
]
Timeout = Annotated[
    float | None,
    typer.Option(
        help="Time limit for all runs of a model, in seconds.", show_default="120", min=0.1
    ),
]
Memory = Annotated[
    int | None,
    typer.Option(help="Memory limit for running a model, in MiB.", show_default="2048", min=64),
]
Seed = Annotated[int | None, typer.Option(help="Seed of the probe set.", min=0)]
