"""The command `gsgen tiles info`: counts tiles, splats and bytes of a tileset by level."""

__all__ = ["info"]

import json
from typing import TYPE_CHECKING, Annotated

import typer

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

    described = describe_tileset(tileset)
    if as_json:
        typer.echo(json.dumps(asdict(described), indent=2))
    else:
        typer.echo(_as_text(tileset, described))


def _as_text(name: str, described: "TilesetInfo") -> str:
    """Return a summary of a tileset and a table of its levels, as text."""
    low, high = described.box
    size = " × ".join(f"{b - a:.4g}" for a, b in zip(low, high, strict=True))
    lines = [
        f"{name}: {described.tiles:,} tiles, {described.splats:,} splats "
        f"({described.leaf_splats:,} in leaves), {described.bytes / MEBIBYTE:.2f} MiB, "
        f"SH degree {described.sh_degree}, {described.refine}",
        f"size {size}" + _place(described),
        f"{'level':>5} {'tiles':>8} {'splats':>12} {'MiB':>9} {'B/splat':>8} {'error':>10}",
    ]
    for level in described.levels:
        bytes_per_splat = level.bytes / max(level.splats, 1)
        lines.append(
            f"{level.level:>5} {level.tiles:>8,} {level.splats:>12,} "
            f"{level.bytes / MEBIBYTE:>9.2f} {bytes_per_splat:>8.1f} {level.geometric_error:>10.4g}"
        )
    if described.neural:
        lines.append(f"{described.neural:,} tiles hold a generator")
    return "\n".join(lines)


def _place(described: "TilesetInfo") -> str:
    """Return a tileset's longitude, latitude and height as text; empty if off the globe."""
    import numpy as np

    from gsgen.tiles.format.volumes import geodetic

    origin = np.array(described.transform)[:3, 3]
    if np.linalg.norm(origin) < 1e6:
        return ""
    longitude, latitude, height = geodetic(origin[None])
    east, north = np.degrees(longitude[0]), np.degrees(latitude[0])
    return f", origin at {east:.6f}° E {north:.6f}° N, {height[0]:.1f} m"
