"""The command `gsgen card`: writes a model card for a model's repository."""

__all__ = ["card"]

from pathlib import Path
from typing import Annotated

import typer

from gsgen.cli.output import echo, echo_text
from gsgen.contract._safe_text import for_shell
from gsgen.contract.errors import ExitCode


def card(
    model: Annotated[Path, typer.Argument(help="The ONNX file.", show_default=False)],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="Markdown file to write, such as README.md; a picture is written beside it.",
            show_default="stdout",
        ),
    ] = None,
    target: Annotated[str, typer.Option(help="Consumer to validate for.")] = "core",
) -> None:
    """Write a model card of MODEL: description, inputs, a picture, and the validation verdict.

    The Markdown has the front matter of the Hugging Face Hub; nothing is uploaded.

    Exits 0 if MODEL conforms, 1 if it does not, 2 if it has no valid manifest or an option is
    wrong, 4 if it is not an ONNX model.
    """
    from gsgen.cli.output import write_text
    from gsgen.cli.progress import clear, progress
    from gsgen.contract.errors import ConfigInvalid
    from gsgen.contract.model.inspected_model import inspect_model
    from gsgen.contract.model.model_file import open_model
    from gsgen.contract.process.atomic_files import atomic_write, is_device, refuse_model
    from gsgen.contract.spec.targets import load_target
    from gsgen.contract.tools.model_card import model_card
    from gsgen.contract.tools.pictures import with_picture
    from gsgen.contract.validation.settings import Settings
    from gsgen.contract.validator import validate
    from gsgen.runtime.checks.probe_picture import draw_probe

    if output is not None:
        refuse_model(output, [model])
    settings = Settings(target=load_target(target))
    subject = inspect_model(open_model(model), settings.target, settings.limits)
    manifest = subject.parsed.manifest if subject.parsed is not None else None
    if manifest is None:
        raise ConfigInvalid(
            "the model has no valid manifest, from which a model card is written",
            where=str(model),
            hint=f"gsgen validate {for_shell(str(model))} --level static",
        )
    progress(f"validating {model.name}")
    try:
        report = validate(model, settings)
        if output is not None and not is_device(output):
            report = with_picture(report, settings, draw_probe)
    finally:
        clear()
    png = report.picture.png if report.picture is not None else None
    picture = output.with_suffix(".png").name if output is not None and png else ""
    text = model_card(report, manifest, model.name, picture)
    if output is None:
        echo_text(text, end="")
    else:
        if png:
            with atomic_write(output) as draft:
                (draft.parent / picture).write_bytes(png)
                draft.write_text(text, "utf-8", errors="backslashreplace")
        else:
            write_text(output, text)
        reason = report.picture.problem if report.picture is not None else ""
        echo(f"{output}: {report.verdict}{'' if picture else f'; no picture: {reason}'}")
    raise typer.Exit(ExitCode.SUCCESS if report.verdict == "conforms" else ExitCode.FAILURE)
