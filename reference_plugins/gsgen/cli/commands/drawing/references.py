"""`gsgen references`: draws reference images of a model, and declares them in a copy."""

__all__ = ["references"]

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gsgen.cli.commands.drawing.options import PrintJsonOption
from gsgen.cli.options import Config, Memory, Timeout
from gsgen.cli.output import echo, echo_json
from gsgen.contract._safe_text import for_shell
from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.spec.fields.json_schema import to_json

if TYPE_CHECKING:
    from gsgen.runtime.checks.reference_recording import References
    from gsgen.runtime.checks.source_pictures import SourcePictures

# Least decibels of pictures that the model itself drew.
_SOURCE_PSNR = 50.0

SourceFolder = Annotated[
    Path | None, typer.Option("--from", help="Folder of pictures that the training code rendered.")
]
SourceCameras = Annotated[
    Path | None,
    typer.Option(help="Their cameras, in the model's space and with the pictures' names."),
]
SourceProbe = Annotated[
    str | None,
    typer.Option(help="Probe that the pictures show, such as time=0.", show_default="first"),
]
PictureWidth = Annotated[
    int | None,
    typer.Option(
        help="Width in pixels; the height follows from the camera.",
        show_default="640",
        min=16,
        max=4096,
    ),
]
LeastDecibels = Annotated[
    float | None,
    typer.Option(
        help="Least decibels that a picture must have.", show_default="50, or 35 with --from", min=1
    ),
]


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
    source: SourceFolder = None,
    cameras: SourceCameras = None,
    probe: SourceProbe = None,
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
    width: PictureWidth = None,
    psnr: LeastDecibels = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace existing pictures of the copy.")
    ] = False,
    config: Config = None,
    timeout: Timeout = None,
    memory: Memory = None,
    as_json: PrintJsonOption = False,
) -> None:
    """Write a copy of MODEL with reference images, drawn by MODEL or by its training code.

    Pictures that MODEL draws show later changes, and freeze a fault that it has now; those of the
    training code (--from with --cameras) show whether it looks like its source. `gsgen validate --level render` draws them again (rule GB021). Exits 0 if they were written, 2
    if they cannot be or an option is wrong, 4 if MODEL cannot be read.
    """
    from gsgen.cli.commands.drawing.input_files import input_files, refuse_inputs
    from gsgen.cli.progress import clear, progress
    from gsgen.contract.rules.catalogue import installed_rules
    from gsgen.contract.validation.settings_from_options import make_settings
    from gsgen.runtime.checks.reference_recording import record_references

    if (source is None) != (cameras is None):
        hint = "Pictures need their cameras: --from FOLDER --cameras FILE."
        raise ConfigInvalid("are only used together", where="--from, --cameras", hint=hint)
    refuse_inputs(output, input_files([cameras] if cameras else [], camera=camera))
    settings = make_settings(installed_rules(), config=config, timeout=timeout, memory=memory)
    if source is not None and cameras is not None:
        given_options = {"probe": probe, "count": count, "psnr": psnr, "force": force}
        options: dict[str, Any] = {
            name: value for name, value in given_options.items() if value is not None
        }
        options["settings"] = settings
        _print_source(_recorded_size(model, output, source, cameras, options), as_json=as_json)
        return
    try:
        result = record_references(
            model,
            output,
            camera=camera,
            count=count,
            width=width,
            psnr=_SOURCE_PSNR if psnr is None else psnr,
            settings=settings,
            force=force,
            progress=progress,
        )
    finally:
        clear()
    for label in result.empty:
        echo(f"note: the picture at {label!r} is empty", err=True)
    note = "note: drawn by the model itself: a fault that it has now is part of the pictures"
    echo(f"{note}; --from FOLDER --cameras FILE takes those of the training code", err=True)
    _print(result, as_json=as_json)


def _recorded_size(
    model: Path, output: Path, folder: Path, cameras: Path, options: dict[str, Any]
) -> "SourcePictures":
    from gsgen.cli.progress import clear, progress
    from gsgen.runtime.checks.source_pictures import record_source_pictures

    try:
        return record_source_pictures(model, output, folder, cameras, progress=progress, **options)
    finally:
        clear()


def _print(result: "References", *, as_json: bool) -> None:
    if as_json:
        document = {
            "model": str(result.model),
            "device": result.device,
            "reference_images": to_json(result.images),
        }
        echo_json(document)
        return
    for image in result.images:
        echo(f"{result.model.parent / image.path}: {image.inputs}")
    quoted_path = for_shell(str(result.model))
    echo(
        f"{result.model}: declares them, drawn on {result.device}; "
        f"`gsgen validate {quoted_path} --level render` draws them again"
    )


def _print_source(pictures: "SourcePictures", *, as_json: bool) -> None:
    for note in pictures.notes:
        echo(f"note: {note}", err=True)
    for name in pictures.unmatched:
        echo(f"note: no camera is named like {name}", err=True)
    if as_json:
        document = {
            "model": str(pictures.model),
            "reference_images": to_json(pictures.images),
            "decibels": list(pictures.decibels),
        }
        echo_json(document)
        return
    for name, image, decibels in zip(
        pictures.names, pictures.images, pictures.decibels, strict=True
    ):
        shortfall_text = (
            "" if decibels >= image.psnr else f", less than the declared {image.psnr:g}"
        )
        echo(f"{pictures.model.parent / image.path}: {name}, {decibels:.1f} dB{shortfall_text}")
    quoted_path = for_shell(str(pictures.model))
    echo(
        f"{pictures.model}: declares them as pictures of its source; "
        f"`gsgen validate {quoted_path} --level render` compares them again"
    )
