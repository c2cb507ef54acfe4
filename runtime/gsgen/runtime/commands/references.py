"""`gsgen references`: draws reference images of a model, and declares them in a copy."""

__all__ = ["references"]

import json
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.contract.commands.options import Config, Memory, Timeout
from gsgen.runtime.commands.options import AsJson

if TYPE_CHECKING:
    from gsgen.runtime.checks.reference_recording import References


def references(
    model: Annotated[Path, typer.Argument(help="The ONNX file.", show_default=False)],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help="The copy of MODEL that declares the pictures; their folder is next to it.",
            show_default=False,
        ),
    ],
    camera: Annotated[
        str | None,
        typer.Option(help="Camera; see `gsgen render`. [default: the probes', or an orbit]"),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option(
            help="Number of pictures, spread over the probes of `gsgen validate`; 16 at most.",
            show_default="3, or all where there are fewer",
            min=1,
        ),
    ] = None,
    width: Annotated[
        int | None,
        typer.Option(
            help="Width in pixels; the height follows from the camera.",
            show_default="640",
            min=16,
            max=4096,
        ),
    ] = None,
    psnr: Annotated[
        float,
        typer.Option(help="Least decibels that a picture must have on another machine.", min=1),
    ] = 50.0,
    force: Annotated[
        bool, typer.Option("--force", help="Replace existing pictures of the copy.")
    ] = False,
    config: Config = None,
    timeout: Timeout = None,
    memory: Memory = None,
    as_json: AsJson = False,
) -> None:
    """Draw reference images of MODEL, and write a copy of it that declares them.

    `gsgen validate --level render` draws them again (rule GB021). Exits 0 if they were written, 2
    if they cannot be or an option is wrong, 4 if MODEL cannot be read.
    """
    from gsgen.contract.commands.progress import clear, progress
    from gsgen.contract.rules.catalogue import installed_rules
    from gsgen.contract.validation.settings_from_options import make_settings
    from gsgen.runtime.checks.reference_recording import record_references

    settings = make_settings(installed_rules(), config=config, timeout=timeout, memory=memory)
    try:
        result = record_references(
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
    for label in result.empty:
        typer.echo(f"note: the picture at {label!r} is empty", err=True)
    _print(result, as_json=as_json)


def _print(result: "References", *, as_json: bool) -> None:
    if as_json:
        document = {
            "model": str(result.model),
            "device": result.device,
            "reference_images": [asdict(image) for image in result.images],
        }
        typer.echo(json.dumps(document, indent=2))
        return
    for image in result.images:
        typer.echo(f"{result.model.parent / image.path}: {image.inputs}")
    quoted_path = shlex.quote(str(result.model))
    typer.echo(
        f"{result.model}: declares them, drawn on {result.device}; "
        f"`gsgen validate {quoted_path} --level render` draws them again"
    )
