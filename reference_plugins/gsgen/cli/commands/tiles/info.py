"""The command `gsgen tiles info`: counts tiles, splats and bytes of a tileset by level."""

__all__ = ["info"]

from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.cli.commands.tiles.quality_text import quality_text
from gsgen.cli.output import echo, echo_json
from gsgen.contract.spec.units import MEBIBYTE

if TYPE_CHECKING:
    from gsgen.tiles.loading.info import TilesetInfo


def info(
    tileset: Annotated[
        str,
        typer.Argument(
            help="tileset.json, its folder, a .3tz archive, or an address (http, https).",
            show_default=False,
        ),
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print it as JSON.")] = False,
) -> None:
    """Print the numbers of tiles, splats and bytes of TILESET at each level.

    Exits 0, or 4 if TILESET or a file of it cannot be read.
    """
    from dataclasses import asdict

    from gsgen.tiles.loading.info import describe_tileset

    tileset_info = describe_tileset(tileset)
    if as_json:
        echo_json(asdict(tileset_info))
    else:
        echo(*_tileset_lines(tileset, tileset_info))


def _tileset_lines(name: str, tileset_info: "TilesetInfo") -> list[str]:
    """Return a summary of a tileset and a table of its levels, as lines of text."""
    low, high = tileset_info.box
    size = " × ".join(f"{b - a:.4g}" for a, b in zip(low, high, strict=True))
    lines = [
        f"{name}: {tileset_info.tiles:,} tiles, {tileset_info.splats:,} splats "
        f"({tileset_info.leaf_splats:,} in leaves), {tileset_info.bytes / MEBIBYTE:.2f} MiB, "
        f"SH degree {tileset_info.sh_degree}, {tileset_info.refine}",
        f"size {size}" + _place_text(tileset_info),
        f"{'level':>5} {'tiles':>8} {'splats':>12} {'MiB':>9} {'B/splat':>8} {'error':>10}",
    ]
    for level in tileset_info.levels:
        bytes_per_splat = level.bytes / max(level.splats, 1)
        lines.append(
            f"{level.level:>5} {level.tiles:>8,} {level.splats:>12,} "
            f"{level.bytes / MEBIBYTE:>9.2f} {bytes_per_splat:>8.1f} {level.geometric_error:>10.4g}"
        )
    if tileset_info.quality_bytes:
        lines.append(quality_text(tileset_info.quality_bytes, tileset_info.leaf_splats))
    if tileset_info.neural:
        lines.append(f"{tileset_info.neural:,} tiles hold a generator")
    return lines


def _place_text(tileset_info: "TilesetInfo") -> str:
    """Return a tileset's longitude, latitude and height as text; empty if off the globe."""
    import numpy as np

    from gsgen.tiles.format.tileset import GLOBE_DISTANCES
    from gsgen.tiles.format.volumes import geodetic

    origin = np.array(tileset_info.transform)[:3, 3]
    if not GLOBE_DISTANCES[0] < np.linalg.norm(origin) < GLOBE_DISTANCES[1]:
        return ""
    longitude, latitude, height = geodetic(origin[None])
    east_degrees, north_degrees = np.degrees(longitude[0]), np.degrees(latitude[0])
    return f", origin at {east_degrees:.6f}° E {north_degrees:.6f}° N, {height[0]:.1f} m"
