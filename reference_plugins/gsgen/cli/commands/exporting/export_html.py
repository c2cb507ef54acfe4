"""`gsgen export html`: writes an HTML page with models, which opens from disk."""

__all__ = ["export_html"]

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from gsgen.cli.commands.drawing import options
from gsgen.cli.output import echo


def export_html(
    models: Annotated[
        list[Path],
        typer.Argument(help="Splat files, generators and scene files.", show_default=False),
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="The page to write.", show_default=False)
    ],
    *,
    background: Annotated[
        str | None, typer.Option(help="black, white, #rrggbb or R,G,B from 0 to 1.")
    ] = None,
    fov: options.FieldOfView = None,
    up: options.Axis = None,
    time: Annotated[
        float | None, typer.Option(help="Fixed time. [default: the time is played]")
    ] = None,
    origin: options.Origin = "auto",
    ort: options.OrtFolder = None,
    three: options.ThreeFolder = None,
) -> None:
    """Write a page that shows MODELS in a browser, in one file that opens from disk.

    Files of splats that no page reads become PLY in it. ONNX Runtime Web is in it where a model is
    a generator: 36 MB. three.js is in it where a scene file has meshes, and with --three, by which
    browsers without WebGPU draw models: 6 MB.

    Exits 2 for wrong options, 4 if a model cannot be read.
    """
    from gsgen.cli.commands.drawing.opening import read_splats
    from gsgen.cli.output import echo_error
    from gsgen.contract.errors import ExitCode
    from gsgen.contract.process.atomic_files import MODEL_SUFFIX, atomic_write, require_page
    from gsgen.formats.shared.origins import parse_origin
    from gsgen.runtime.errors import SceneUnreadable
    from gsgen.runtime.scene.colors import color_of
    from gsgen.runtime.web.onnxruntime_web import ort_folder
    from gsgen.runtime.web.pages import ModelView, files_shown, single_file_page
    from gsgen.runtime.web.three_js import THREE

    require_page(output, models)
    color = None if background is None else color_of(background, "--background")
    view = ModelView(
        background=None if color is None else (color[0], color[1], color[2]),
        fov=fov,
        up=up,
        time=time,
    )
    try:
        files = files_shown(models)
        require_page(output, [file.path for file in files])
        has_generator = any(file.path.suffix.lower() == MODEL_SUFFIX for file in files)
        has_three = three is not None or any(file.is_mesh for file in files)
        page = single_file_page(
            models,
            view,
            ort_folder(ort) if has_generator else None,
            read=partial(read_splats, origin=parse_origin(origin)),
            three=THREE.located(three) if has_three else None,
        )
    except SceneUnreadable as error:
        echo_error(error)
        raise typer.Exit(ExitCode.UNREADABLE) from error
    with atomic_write(output) as draft:
        draft.write_text(page, "utf-8")
    echo(f"wrote {output}: {output.stat().st_size:,} bytes")
