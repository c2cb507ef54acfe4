"""Creates the tiles of an implicit tree: a quadtree or octree over one tile's volume.

3D Tiles 1.1, section "Implicit Tiling".
"""

__all__ = ["ImplicitTree", "TileCoordinates", "expand_implicit", "read_implicit"]

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, final

import numpy as np

from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.format.implicit_tiling.property_table import PropertyClass
from gsgen.tiles.format.implicit_tiling.subtree import MAX_BITS, Subtree, tile_count
from gsgen.tiles.format.json_values import JsonDict, JsonObject, shorten
from gsgen.tiles.format.tileset import Content, RefineMode, Tile
from gsgen.tiles.format.uris import resolve_uri
from gsgen.tiles.format.volumes import Box, Region, Sphere, Volume, read_volume

MAX_LEVELS: Final = 24
_AXIS_COUNT_BY_SCHEME: Final = {"QUADTREE": 2, "OCTREE": 3}
_NUMBER_COUNT_BY_VOLUME: Final = {"box": 12, "sphere": 4, "region": 6}


class TileCoordinates(NamedTuple):
    """The level of an implicit tile, and its two or three integer coordinates on that level."""

    level: int
    cell: tuple[int, ...]

    def child(self, index: int) -> "TileCoordinates":
        """Return the coordinates of an implicit tile's child, by the child's number."""
        cell = tuple(value * 2 + (index >> axis & 1) for axis, value in enumerate(self.cell))
        return TileCoordinates(self.level + 1, cell)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImplicitTree:
    """An implicit quadtree or octree of tiles, as the ``implicitTiling`` of a tile declares it.

    Attributes:
        dimensions: 2 for a quadtree, 3 for an octree.
        levels: Of the whole tree.
        subtree_levels: Of one subtree.
        subtree_uri: Template of the subtrees' uris.
        content_uris: Templates of the contents' uris.
        volume: Of the root of the tree.
        geometric_error: Of the root; halves from level to level.
        refine: Of all tiles.
        base: Path of the file that says this.
        location: Where it says this.
        classes: Of the metadata schema.
        file_templates: Templates of the content's uri at each quality; empty where there is one.
    """

    dimensions: int
    levels: int
    subtree_levels: int
    subtree_uri: str
    content_uris: tuple[str, ...]
    volume: Box | Region
    geometric_error: float
    refine: RefineMode
    base: str
    location: str
    classes: dict[str, PropertyClass]
    file_templates: tuple[str, ...] = ()

    @property
    def branching(self) -> int:
        """The number of children of a tile: four in a quadtree, eight in an octree."""
        return int(2**self.dimensions)

    def uri(self, template: str, tile: TileCoordinates, location: str) -> str:
        """Return the path of an implicit tile's file, relative to the tileset's folder."""
        text = template.replace("{level}", str(tile.level))
        for name, value in zip("xyz", tile.cell, strict=False):
            text = text.replace(f"{{{name}}}", str(value))
        return resolve_uri(self.base, text, location)


def read_implicit(
    tile: JsonObject,
    volume: Volume,
    geometric_error: float,
    refine: RefineMode,
    base: str,
    classes: dict[str, PropertyClass],
    file_templates: tuple[str, ...] = (),
) -> ImplicitTree:
    """Parse ``implicitTiling``, a member of a tile's JSON, into an implicit tree."""
    entry = tile.child("implicitTiling")
    subdivision_scheme = entry.values.get("subdivisionScheme")
    if not isinstance(subdivision_scheme, str) or subdivision_scheme not in _AXIS_COUNT_BY_SCHEME:
        entry.refuse("subdivisionScheme", " or ".join(_AXIS_COUNT_BY_SCHEME))
    if isinstance(volume, Sphere):
        raise TilesetInvalid(
            "the volume of the tile is a sphere",
            location=tile.at("boundingVolume"),
            expected="a box or a region, which implicit tiling can divide",
        )
    levels_key = "availableLevels" if "availableLevels" in entry else "maximumLevel"
    levels = entry.whole(levels_key, least=1, most=MAX_LEVELS)
    subtree_levels = entry.whole("subtreeLevels", least=1, most=MAX_LEVELS)
    dimensions = _AXIS_COUNT_BY_SCHEME[subdivision_scheme]
    if tile_count(2**dimensions, subtree_levels) > MAX_BITS:
        entry.refuse("subtreeLevels", f"subtrees of {MAX_BITS:,} tiles or fewer")
    contents = [tile.child("content")] if "content" in tile else []
    contents += tile.objects("contents")
    return ImplicitTree(
        dimensions=dimensions,
        levels=levels + (levels_key == "maximumLevel"),
        subtree_levels=subtree_levels,
        subtree_uri=entry.child("subtrees").text("uri"),
        content_uris=tuple(content.text("uri") for content in contents),
        volume=volume,
        geometric_error=geometric_error,
        refine=refine,
        base=base,
        location=tile.location,
        classes=classes,
        file_templates=file_templates,
    )


def expand_implicit(
    tree: ImplicitTree,
    root: Tile,
    load: Callable[[ImplicitTree, TileCoordinates], Subtree | None],
    count_tiles: Callable[[int, str], None],
) -> Tile:
    """Return the root tile with all tiles of its implicit tree as descendants.

    Args:
        tree: The tree.
        root: The tile that says so; its level, transform and volume go on.
        load: Reads a subtree; None where it cannot be read and the fault was noted.
        count_tiles: Called with the number of tiles of each subtree and a location; raises
            where there are too many.
    """
    origin = TileCoordinates(0, (0,) * tree.dimensions)
    return _expand_subtree(tree, root, origin, load, count_tiles) or root


def _expand_subtree(
    tree: ImplicitTree,
    root: Tile,
    origin: TileCoordinates,
    load: Callable[[ImplicitTree, TileCoordinates], Subtree | None],
    count_tiles: Callable[[int, str], None],
) -> Tile | None:
    subtree = load(tree, origin)
    if subtree is None:
        return None
    if len(subtree.contents) > len(tree.content_uris):
        raise TilesetInvalid(
            f"the subtree has {len(subtree.contents)} contents per tile",
            location=f"{tree.location}, subtree {_tile_label(origin)}",
            expected=f"{len(tree.content_uris)}, as many as the tile has templates",
            fault=Fault.SUBTREE,
        )
    available_tiles = np.flatnonzero(subtree.tiles)
    count_tiles(len(available_tiles), f"{tree.location}, subtree {_tile_label(origin)}")
    rows = {int(index): row for row, index in enumerate(available_tiles)}
    content_rows = [np.cumsum(bits) - 1 for bits in subtree.contents]
    coordinates = _tile_coordinates(tree, origin, available_tiles)
    first_child_index = tile_count(tree.branching, tree.subtree_levels)
    # Tiles stand breadth first: from the last one back, children are built before their parent.
    tiles_by_index: dict[int, Tile] = {}
    for index in reversed([int(entry) for entry in available_tiles]):
        children = [index * tree.branching + 1 + k for k in range(tree.branching)]
        if children[0] < first_child_index:  # within this subtree; else the roots of other subtrees
            below = [tiles_by_index.pop(child) for child in children if child in tiles_by_index]
        else:
            below = list(
                _child_subtree_roots(
                    tree, root, subtree, coordinates[index], children[0] - first_child_index,
                    load, count_tiles,
                )
            )  # fmt: skip
        values = {key: column[rows[index]].tolist() for key, column in subtree.properties.items()}
        contents = _contents(tree, subtree, coordinates[index], index, content_rows)
        tiles_by_index[index] = _tile(
            tree, root, coordinates[index], values, contents, tuple(below)
        )
    return tiles_by_index[0]


def _child_subtree_roots(
    tree: ImplicitTree,
    root: Tile,
    subtree: Subtree,
    parent: TileCoordinates,
    first: int,
    load: Callable[[ImplicitTree, TileCoordinates], Subtree | None],
    count_tiles: Callable[[int, str], None],
) -> Iterator[Tile]:
    """Yield the roots of the child subtrees below a tile of a subtree's last level."""
    for k in range(tree.branching):
        if not subtree.subtrees[first + k]:
            continue
        origin = parent.child(k)
        if origin.level >= tree.levels:
            raise TilesetInvalid(
                f"the subtree begins at level {origin.level}",
                location=f"{tree.location}, subtree {_tile_label(origin)}",
                expected=f"less than the {tree.levels} levels of the tree",
                fault=Fault.SUBTREE,
            )
        tile = _expand_subtree(tree, root, origin, load, count_tiles)
        if tile is not None:
            yield tile


def _tile_coordinates(
    tree: ImplicitTree, origin: TileCoordinates, available_tiles: np.ndarray
) -> dict[int, TileCoordinates]:
    """Return the coordinates of a subtree's tiles, in the order of availability bits."""
    known = {0: origin}
    for index in map(int, available_tiles[1:]):
        parent, k = divmod(index - 1, tree.branching)
        known[index] = known[parent].child(k)
    return known


def _contents(
    tree: ImplicitTree,
    subtree: Subtree,
    tile: TileCoordinates,
    index: int,
    content_rows: list[np.ndarray],
) -> tuple[Content, ...]:
    contents = []
    for number, bits in enumerate(subtree.contents):
        if not bits[index]:
            continue
        location = f"{tree.location}, tile {_tile_label(tile)}"
        volume = None
        if number < len(subtree.content_properties):
            columns = subtree.content_properties[number]
            values = {key: column[content_rows[number][index]] for key, column in columns.items()}
            volume = _declared_volume(values, "CONTENT")
        uri = tree.uri(tree.content_uris[number], tile, location)
        contents.append(Content(uri=uri, volume=volume, location=location))
    return tuple(contents)


def _tile(
    tree: ImplicitTree,
    root: Tile,
    coordinates: TileCoordinates,
    values: JsonDict,
    contents: tuple[Content, ...],
    children: tuple[Tile, ...],
) -> Tile:
    level, cell = coordinates
    if level >= tree.levels:
        raise TilesetInvalid(
            f"tile {_tile_label(coordinates)} is available at level {level}",
            location=tree.location,
            expected=f"less than the {tree.levels} levels of the tree",
            fault=Fault.SUBTREE,
        )
    declared = values.get("TILE_GEOMETRIC_ERROR")
    error = tree.geometric_error / 2.0**level if declared is None else declared
    if np.ndim(error) or not 0 <= error < np.inf:
        raise TilesetInvalid(
            shorten(error),
            location=f"{tree.location}, tile {_tile_label(coordinates)}, TILE_GEOMETRIC_ERROR",
            expected="a finite number, 0 or more",
            fault=Fault.SUBTREE,
        )
    return replace(
        root,
        location=f"{tree.location}, tile {_tile_label(coordinates)}",
        volume=_declared_volume(values, "TILE") or tree.volume.child(cell, level),
        geometric_error=float(error),
        refine=tree.refine,
        contents=contents,
        children=children,
        level=root.level + level,
        metadata=values or root.metadata if not level else values,
        files=tuple(tree.uri(uri, coordinates, tree.location) for uri in tree.file_templates)
        if contents
        else (),
    )


def _declared_volume(values: JsonDict, owner: str) -> Volume | None:
    """Return the bounding volume that the metadata of a tile or content declares, or None."""
    for kind, width in _NUMBER_COUNT_BY_VOLUME.items():
        name = f"{owner}_BOUNDING_{kind.upper()}"
        if name in values:
            numbers = np.atleast_1d(np.asarray(values[name], np.float64))
            entry = {kind: numbers.tolist()}
            if len(numbers) != width:
                raise TilesetInvalid(
                    f"the bounding {kind} has {len(numbers)} numbers",
                    location=f"property with the semantic {name}",
                    expected=str(width),
                    fault=Fault.SUBTREE,
                )
            return read_volume(JsonObject(entry, name, Fault.SUBTREE))
    return None


def _tile_label(tile: TileCoordinates) -> str:
    return f"{tile.level}/{'/'.join(map(str, tile.cell))}"
