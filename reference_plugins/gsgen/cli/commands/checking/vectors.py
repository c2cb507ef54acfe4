"""The command `gsgen vectors`, which records a model's outputs as test vectors."""

__all__ = ["vectors"]

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.cli.options import Config, Memory, Timeout
from gsgen.cli.output import echo, echo_json
from gsgen.contract._safe_text import for_shell

if TYPE_CHECKING:
    from gsgen.contract.tools.test_vector_files import RecordedVectors


def vectors(
    model: Annotated[Path, typer.Argument(help="The ONNX file.", show_default=False)],
    into: Annotated[
        Path | None,
        typer.Option(
            help="Folder for inputs and outputs, in the layout of ONNX's backend tests.",
            show_default="MODEL-vectors",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="Copy of MODEL with the digests in its manifest.",
            show_default="model.onnx in that folder",
        ),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option(
            help="Number of vectors, evenly spread over the probes of `gsgen validate`.",
            show_default="3, or all if there are fewer",
            min=1,
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the probe set.", min=0)] = 0,
    force: Annotated[
        bool, typer.Option("--force", help="Replace the vectors in the folder.")
    ] = False,
    config: Config = None,
    timeout: Timeout = None,
    memory: Memory = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Write test vectors of MODEL, and a copy of MODEL whose manifest lists them.

    `gsgen validate` runs them again (rule GM012). Exits 0 if they were written, 2 if they cannot
    be written or an option is wrong, 4 if MODEL is not an ONNX model.
    """
    from gsgen.cli.fetched_inputs import is_copy
    from gsgen.cli.progress import clear, progress
    from gsgen.contract.errors import ConfigInvalid
    from gsgen.contract.rules.catalogue import installed_rules
    from gsgen.contract.tools.test_vector_files import record_vectors
    from gsgen.contract.validation.settings_from_options import make_settings

    settings = make_settings(installed_rules(), config=config, timeout=timeout, memory=memory)
    if into is None and is_copy(model):
        hint = "Add --into FOLDER."
        raise ConfigInvalid("is needed for a model at an address", where="--into", hint=hint)
    folder = into or model.with_name(f"{model.stem}-vectors")
    try:
        recorded_vectors = record_vectors(
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
    _print(recorded_vectors, as_json=as_json)


def _print(recorded_vectors: "RecordedVectors", *, as_json: bool) -> None:
    data_set_folders = [
        recorded_vectors.folder / f"test_data_set_{k}" for k in range(len(recorded_vectors.vectors))
    ]
    if as_json:
        file_lines = [
            {"folder": str(folder)} | asdict(vector)
            for folder, vector in zip(data_set_folders, recorded_vectors.vectors, strict=True)
        ]
        echo_json({"model": str(recorded_vectors.model), "vectors": file_lines})
        return
    for folder, vector in zip(data_set_folders, recorded_vectors.vectors, strict=True):
        echo(f"{folder}: {vector.inputs}")
    quoted_model = for_shell(str(recorded_vectors.model))
    echo(
        f"{recorded_vectors.model}: promises them; `gsgen validate {quoted_model}` runs them again"
    )
