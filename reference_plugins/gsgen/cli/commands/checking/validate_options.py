"""Command-line options that only `gsgen validate` has."""

__all__ = [
    "BaselineFile",
    "Ignore",
    "Jobs",
    "Only",
    "Output",
    "Paths",
    "RequireRules",
    "SeverityOf",
    "Strict",
    "Times",
]

from pathlib import Path
from typing import Annotated

import typer

Paths = Annotated[
    list[Path],
    typer.Argument(
        metavar="PATH…",
        help="ONNX files, folders of them, globs; tilesets (.json, .3tz) and their contents "
        "(.glb, .gltf).",
        show_default=False,
    ),
]
Ignore = Annotated[
    list[str] | None,
    typer.Option(
        help="Rule (id or name) whose findings do not count; repeat or separate by commas."
    ),
]
Only = Annotated[
    list[str] | None,
    typer.Option(help="Check only this rule and those that it needs; repeat or use commas."),
]
RequireRules = Annotated[
    list[str] | None,
    typer.Option(help="Fail unless this rule was checked; repeat or separate by commas."),
]
SeverityOf = Annotated[
    list[str] | None,
    typer.Option(
        help="RULE=SEVERITY, in place of the rule's own severity; repeatable.", metavar="ID=LEVEL"
    ),
]
BaselineFile = Annotated[
    Path | None, typer.Option(help="An earlier JSON report, whose findings do not fail the model.")
]
Output = Annotated[
    Path | None, typer.Option("-o", "--output", help="Write the report to a file instead.")
]
Jobs = Annotated[
    int, typer.Option("-j", "--jobs", help="Number of models to validate at once.", min=1)
]
Strict = Annotated[bool, typer.Option(help="A missing manifest is an error for every target.")]
Times = Annotated[bool, typer.Option(help="Report how long it took; equal inputs then differ.")]
