"""The command `gsgen tiles score`: measures SSIM, splats and bytes of each tileset level."""

__all__ = ["score"]

from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.cli.output import echo, echo_json
from gsgen.contract.errors import ConfigInvalid, InputUnreadable
from gsgen.contract.process.atomic_files import atomic_write, refuse_itself
from gsgen.contract.spec.units import MEBIBYTE

if TYPE_CHECKING:
    from gsgen.tiles.scoring.score import TilesetScore


def score(
    tileset: Annotated[
        str,
        typer.Argument(help="tileset.json, its folder, .3tz, or an address.", show_default=False),
    ],
    scene: Annotated[
        Path, typer.Argument(help="The file that it was built from.", show_default=False)
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Where the pictures of all levels go, as PNG.")
    ] = Path("score.png"),
    width: Annotated[int, typer.Option(help="Of a picture.", min=32, max=4096)] = 320,
    height: Annotated[int, typer.Option(help="Of a picture.", min=32, max=4096)] = 240,
    as_json: Annotated[bool, typer.Option("--json", help="Print it as JSON.")] = False,
) -> None:
    """Compare each level of TILESET with SCENE: bytes, splats and SSIM, from three distances.

    Exits 0, 2 for wrong options or where nothing can be drawn with, 4 if a file cannot be read.
    """
    if find_spec("wgpu") is None or find_spec("PIL") is None:
        raise ConfigInvalid(
            "wgpu or pillow is not installed",
            where="gsgen tiles score",
            hint="pip install 'gsgen[runtime]'",
        )
    refuse_itself(output, [Path(tileset), scene])
    from PIL import Image

    from gsgen.cli.progress import clear, progress
    from gsgen.formats import FormatError
    from gsgen.tiles.scoring.score import draw_sheet, score_tileset

    try:
        result = score_tileset(tileset, scene, width=width, height=height, progress=progress)
    except FormatError as error:
        raise InputUnreadable(str(error)) from error
    finally:
        clear()
    with atomic_write(output) as draft:
        Image.fromarray(draw_sheet(result)).save(draft, "png")
    if as_json:
        document = {"splats": result.splats, "levels": [asdict(entry) for entry in result.levels]}
        echo_json(document | {"picture": str(output)})
    else:
        echo(*_score_lines(result, output))


def _score_lines(result: "TilesetScore", output: Path) -> list[str]:
    """Return the scores of a tileset's levels as the lines of a table, finest level first."""
    names = list(result.levels[0].ssim)
    header_line = f"{'level':>5} {'tiles':>7} {'splats':>11} {'share':>7} {'MiB':>9}"
    lines = [f"{header_line}  SSIM " + " ".join(f"{name:>7}" for name in names)]
    for entry in reversed(result.levels):
        values = " ".join(f"{entry.ssim[name]:>7.4f}" for name in names)
        lines.append(
            f"{entry.level:>5} {entry.tiles:>7,} {entry.splats:>11,} "
            f"{entry.splats / result.splats:>7.1%} {entry.bytes / MEBIBYTE:>9.3f}       {values}"
        )
    return [*lines, f"pictures: {output}"]
