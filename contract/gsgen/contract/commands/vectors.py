"""`gsgen vectors`: record what a model gives, for whoever runs it elsewhere."""

__all__ = ["vectors"]

import json
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.contract.commands.options import Config, Memory, Timeout

if TYPE_CHECKING:
    from gsgen.contract.tools.test_vector_files import Recorded


def vectors(
    model: Annotated[Path, typer.Argument(help="The ONNX file.", show_default=False)],
    into: Annotated[
        Path | None,
        typer.Option(
            help="Folder for inputs and outputs, as ONNX's backend runner reads them.",
            show_default="MODEL-vectors",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="The copy of MODEL whose manifest has the digests.",
            show_default="model.onnx in that folder",
        ),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option(
            help="How many, spread over the probes of `gsgen validate`.",
            show_default="3, or all where there are fewer",
            min=1,
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the probe set.", min=0)] = 0,
    force: Annotated[
        bool, typer.Option("--force", help="Replace vectors that the folder has.")
    ] = False,
    config: Config = None,
    timeout: Timeout = None,
    memory: Memory = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Write test vectors of MODEL, and a copy of it that promises them.

    `gsgen validate` runs them again (rule GM012). Exits 0 if they were written, 2 if they cannot
    be or an option is wrong, 4 if no model.
    """
    from gsgen.contract.commands.progress import clear, progress
    from gsgen.contract.rules.catalogue import installed_rules
    from gsgen.contract.tools.test_vector_files import record_vectors
    from gsgen.contract.validation.settings_from_options import make_settings

    settings = make_settings(
        installed_rules(), config=config, timeout=timeout, memory=memory
    )
    folder = into or model.with_name(f"{model.stem}-vectors")
    try:
        made = record_vectors(
            model,
            folder,
            output,
            count=count,
            seed=seed,
            settings=settings,
            force=force,
            progress=progress,
        )
    finally:
        clear()
    _print(made, as_json)


def _print(made: "Recorded", as_json: bool) -> None:
    sets = [made.folder / f"test_data_set_{k}" for k in range(len(made.vectors))]
    if as_json:
        listed = [
            {"folder": str(folder)} | asdict(vector)
            for folder, vector in zip(sets, made.vectors, strict=True)
        ]
        typer.echo(json.dumps({"model": str(made.model), "vectors": listed}, indent=2))
        return
    for folder, vector in zip(sets, made.vectors, strict=True):
        typer.echo(f"{folder}: {vector.inputs}")
    typed = shlex.quote(str(made.model))
    typer.echo(f"{made.model}: promises them; `gsgen validate {typed}` runs them again")
