"""`gsgen references`: record what a model looks like, for whoever draws it elsewhere."""

__all__ = ["references"]

import json
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.contract.commands.options import Config, Memory, Timeout

if TYPE_CHECKING:
    from gsgen.runtime.checks.reference_recording import References


def references(
    model: Annotated[Path, typer.Argument(help="The ONNX file.", show_default=False)],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help="The copy of MODEL that declares the pictures; they go to a folder beside it.",
            show_default=False,
        ),
    ],
    camera: Annotated[
        str | None,
        typer.Option(
            help="As for render. [default: the probes', or from where everything is seen]"
        ),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option(
            help="How many, spread over the probes of `gsgen validate`; 16 at most.",
            show_default="3, or all where there are fewer",
            min=1,
        ),
    ] = None,
    width: Annotated[
        int | None,
        typer.Option(
            help="Pixels; the height follows from the camera.",
            show_default="640",
            min=16,
            max=4096,
        ),
    ] = None,
    psnr: Annotated[
        float,
        typer.Option(
            help="Least decibels that a picture drawn elsewhere must have.", min=1
        ),
    ] = 50.0,
    force: Annotated[
        bool, typer.Option("--force", help="Replace pictures that the copy has.")
    ] = False,
    config: Config = None,
    timeout: Timeout = None,
    memory: Memory = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Draw reference images of MODEL, and write a copy of it that declares them.

    `gsgen validate --level render` draws them again (rule GB021). Exits 0 if they were written, 2
    if they cannot be or an option is wrong, 4 if no model.
    """
    from gsgen.contract.commands.progress import clear, progress
    from gsgen.contract.rules.catalogue import installed_rules
    from gsgen.contract.validation.settings_from_options import make_settings
    from gsgen.runtime.checks.reference_recording import record_references

    settings = make_settings(
        installed_rules(), config=config, timeout=timeout, memory=memory
    )
    try:
        recorded = record_references(
            model,
            output,
            camera=camera,
            count=count,
            width=width,
            psnr=psnr,
            settings=settings,
            force=force,
            progress=progress,
        )
    finally:
        clear()
    for label in recorded.empty:
        typer.echo(f"note: nothing is seen at {label!r}", err=True)
    _print(recorded, as_json)


def _print(recorded: "References", as_json: bool) -> None:
    if as_json:
        listed = [asdict(image) for image in recorded.images]
        document = {
            "model": str(recorded.model),
            "device": recorded.device,
            "reference_images": listed,
        }
        typer.echo(json.dumps(document, indent=2))
        return
    for image in recorded.images:
        typer.echo(f"{recorded.model.parent / image.path}: {image.inputs}")
    typed = shlex.quote(str(recorded.model))
    typer.echo(
        f"{recorded.model}: declares them, drawn on {recorded.device}; "
        f"`gsgen validate {typed} --level render` draws them again"
    )
