"""Writes the content files of a tile, and describes the written tile."""

__all__ = ["Tile", "leaf_splats", "tile_from_json", "write_leaf", "write_level"]

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, cast, final

import numpy as np
from jaxtyping import UInt64

from gsgen.formats import Splats
from gsgen.formats.merging.levels import Level, geometric_error, stored_degree
from gsgen.formats.merging.mixture import Mixture
from gsgen.formats.merging.splat_mixtures import mixture_of, splats_of
from gsgen.tiles.build.files import write_bytes
from gsgen.tiles.build.plan import Plan, coordinates_of, depth_of
from gsgen.tiles.build.spill import Rows
from gsgen.tiles.format.implicit_tiling.writing import implicit_uri
from gsgen.tiles.format.index import ContentRecord, content_uri
from gsgen.tiles.format.json_values import JsonDict
from gsgen.tiles.gltf.encoding import write_content

_LEAST_SHIFT: Final = 1 / 1024  # of a cell


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Tile:
    """A tile whose content files are written, with all its descendants.

    Attributes:
        location: Its octree cell, as 1 followed by the Morton code.
        extra: 0, or the number of a leaf of large splats among those of the same cell.
        splats: Of its content.
        sh_degree: Of its content.
        cell: Side of the cells that its splats were merged in, in scene units; 0 for a leaf.
        squared_shift: How far merging has moved the splats of the leaves, in scene units².
        contents: A file for each quality, finest first.
        children: Tiles that replace it, in order of their cells.
    """

    location: int
    extra: int = 0
    splats: int
    sh_degree: int
    cell: float
    squared_shift: float = 0.0
    contents: tuple[ContentRecord, ...]
    children: tuple["Tile", ...] = ()

    def as_json(self) -> JsonDict:
        """Return the tile and its descendants as a JSON object."""

        def plain(items: list[tuple[str, Any]]) -> JsonDict:
            return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in items}

        return asdict(self, dict_factory=plain)


def tile_from_json(value: Mapping[str, Any]) -> Tile:
    """Return a tile from the JSON of :meth:`Tile.as_json`."""
    contents = (
        ContentRecord(**{**item, "low": np.array(item["low"]), "high": np.array(item["high"])})
        for item in value["contents"]
    )
    children = (tile_from_json(child) for child in value["children"])
    return Tile(**{**value, "contents": tuple(contents), "children": tuple(children)})


def leaf_splats(plan: Plan, rows: Rows) -> Splats:
    """Return rows of a partition as splats, with the flags of the scenes."""
    names = ("position", "rotation", "log_scale", "logit_opacity", "sh")
    arguments: JsonDict = {name: np.ascontiguousarray(rows[name]) for name in names}
    return Splats(
        **arguments, antialiased=plan.antialiased, color_space=cast(Any, plan.color_space)
    )


def write_leaf(
    plan: Plan, rows: Rows, codes: UInt64[np.ndarray, " n"], location: int, extra: int = 0
) -> tuple[Tile, Mixture]:
    """Write a leaf tile's splats as content files; return the tile, and Gaussians to merge."""
    splats = leaf_splats(plan, rows)
    tile = _write(plan, splats, location, extra=extra, cell=0.0)
    return tile, mixture_of(splats, codes)


def write_level(plan: Plan, level: Level, location: int, children: list[Tile]) -> Tile:
    """Write merged splats as the content files of a parent tile."""
    flags: JsonDict = {"antialiased": plan.antialiased, "color_space": plan.color_space}
    splats = replace(splats_of(level.mixture, stored_degree(level.mixture)), **flags)
    cell = plan.cube.side / (1 << level.depth)
    # Shifts of level above level are independent: their squares add. A tile that replaces others
    # has an error, even where merging moves nothing.
    shift = level.squared_shift + max(child.squared_shift for child in children)
    shift = max(shift, (_LEAST_SHIFT * cell) ** 2)
    return _write(plan, splats, location, cell=cell, squared_shift=shift, children=tuple(children))


def _write(
    plan: Plan,
    splats: Splats,
    location: int,
    *,
    cell: float,
    squared_shift: float = 0.0,
    extra: int = 0,
    children: tuple[Tile, ...] = (),
) -> Tile:
    low, high = splats.position.min(axis=0), splats.position.max(axis=0)
    center = (low.astype(np.float64) + high) / 2
    contents: list[ContentRecord] = []
    degree = splats.degree
    for quality in plan.parameters.qualities:
        encoded = write_content(splats, center, codec=plan.parameters.codec, quality=quality)
        digest = hashlib.sha256(encoded.data).hexdigest()
        depth, cell_index = depth_of(location), coordinates_of(location)
        if plan.parameters.implicit:
            path = implicit_uri(depth, cell_index, len(contents))
        else:
            path = content_uri(depth, cell_index, encoded.data)
        write_bytes(Path(plan.output) / path, encoded.data)
        content = ContentRecord(
            uri=path,
            size=len(encoded.data),
            sha256=digest,
            low=encoded.low,
            high=encoded.high,
            worth=round(encoded.worth, 4),
            error=geometric_error(squared_shift + encoded.squared_shift),
        )
        contents.append(content)
        degree = encoded.sh_degree
    return Tile(
        location=location,
        extra=extra,
        splats=len(splats),
        sh_degree=degree,
        cell=cell,
        squared_shift=squared_shift,
        contents=tuple(contents),
        children=children,
    )
