"""A tileset in memory: a tree of tiles, independent of files."""

__all__ = [
    "GLOBE_DISTANCES",
    "Z_UP_FROM_Y_UP",
    "Content",
    "RefineMode",
    "Tile",
    "Tileset",
    "is_count",
]

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, final

import numpy as np
from jaxtyping import Float64

from gsgen.formats.shared.origins import Origin
from gsgen.formats.shared.splats import NO_ORIGIN
from gsgen.tiles.format.neural_tile import NeuralTile
from gsgen.tiles.format.volumes import Volume

RefineMode = Literal["ADD", "REPLACE"]

Z_UP_FROM_Y_UP: Final[Float64[np.ndarray, "4 4"]] = np.array(
    [[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]
)
"""Content (glTF) to tile coordinates."""

GLOBE_DISTANCES: Final = (6.25e6, 6.48e6)
"""Metres from the centre of the globe (ECEF) between which a scene stands on it."""


_MAX_COUNT: Final = 1 << 48  # sums of counts stay within 64 bits


def is_count(value: object) -> bool:
    """Return whether metadata is a number of splats or bytes; it may be anything."""
    return isinstance(value, int | np.integer) and 0 <= int(value) <= _MAX_COUNT


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Content:
    """A content file of a tile, with its URI and bounding volume.

    Attributes:
        uri: Relative to the tileset's folder.
        volume: Of the content alone; None where only the tile has one.
        location: Where the uri stands.
        rows: Of a SOG file that are the content; None for a glTF file.
    """

    uri: str
    volume: Volume | None
    location: str
    rows: slice | None = None


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tile:
    """A tile of a tileset, explicit or of an implicit tree.

    Attributes:
        location: The file and the JSON path or the implicit coordinates.
        volume: Bounds of the content and of all tiles below, in the tile's own frame.
        geometric_error: Error where the tile is drawn and those below are not.
        refine: Whether the tiles below replace the content, or add to it.
        transform: From the tile's own frame to that of the root tile; identity for the root.
        contents: The files to draw; more than one where the tileset says so.
        children: The tiles below.
        level: 0 for the root.
        metadata: Properties by name, as far as they are numbers or arrays of them.
        neural: The generator that the tile holds, if it does.
        files: The content's file at each quality, finest first, relative to the tileset's folder;
            empty where the tileset does not tell.
    """

    location: str
    volume: Volume
    geometric_error: float
    refine: RefineMode
    transform: Float64[np.ndarray, "4 4"]
    contents: tuple[Content, ...] = ()
    children: tuple["Tile", ...] = field(default=(), repr=False)
    level: int = 0
    metadata: Mapping[str, Any] = field(default_factory=dict)
    neural: NeuralTile | None = None
    files: tuple[str, ...] = ()

    @property
    def file_sizes(self) -> tuple[int, ...]:
        """Bytes of the content at each quality, finest first; empty where metadata do not tell."""
        sizes = self.metadata.get("bytes")
        entries = sizes if isinstance(sizes, list) else [sizes]  # one quality of implicit tiles
        if len(self.contents) != 1 or not all(map(is_count, entries)):
            return ()
        return tuple(map(int, entries))

    @property
    def is_finest(self) -> bool:
        """Whether the tile's content is drawn at the finest level of detail."""
        return not self.children or self.refine == "ADD"


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tileset:
    """A tree of tiles with the declarations of the tileset's ``tileset.json``.

    Attributes:
        name: The file, address or archive, as the caller gave it.
        index: Path of ``tileset.json`` relative to its folder.
        version: Of 3D Tiles, such as ``1.1``.
        geometric_error: Error where nothing is drawn.
        transform: From the root frame to the globe (ECEF) or the world.
        root: The root tile.
        extensions_used: As declared.
        extensions_required: As declared.
        content_extensions: glTF extensions that ``3DTILES_content_gltf`` declares as required;
            None where the tileset does not declare them.
        metadata: Properties of the tileset by name.
        y_up: Whether contents are y up, which glTF asks for, and have to be turned.
    """

    name: str
    index: str
    version: str
    geometric_error: float
    transform: Float64[np.ndarray, "4 4"]
    root: Tile
    extensions_used: tuple[str, ...] = ()
    extensions_required: tuple[str, ...] = ()
    content_extensions: tuple[str, ...] | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)
    y_up: bool = True

    @property
    def content_axes(self) -> Float64[np.ndarray, "4 4"]:
        """The 4×4 matrix from the frame of a content file to the frame of its tile."""
        return Z_UP_FROM_Y_UP if self.y_up else np.eye(4)

    @property
    def origin(self) -> Origin:
        """The point of the scene that is 0, 0, 0 in the root frame, as the metadata declares it."""
        numbers = self.metadata.get("origin", NO_ORIGIN)
        is_point = isinstance(numbers, list) and len(numbers) == len(NO_ORIGIN)
        if not is_point or not all(isinstance(number, int | float) for number in numbers):
            return NO_ORIGIN
        x, y, z = (float(number) for number in numbers)
        return x, y, z

    @property
    def place_on_globe(self) -> Float64[np.ndarray, " 3"] | None:
        """Where 0, 0, 0 of the scene is on the globe, in its frame (ECEF); None off the globe."""
        low, high = GLOBE_DISTANCES
        place = self.transform[:3, 3] - self.transform[:3, :3] @ self.origin
        return np.asarray(place) if low < np.linalg.norm(place) < high else None

    @property
    def up(self) -> Float64[np.ndarray, " 3"]:
        """The up direction of a tileset's root frame: world z, or away from the globe's centre."""
        place = self.place_on_globe
        up = self.transform[:3, :3].T @ (np.array([0.0, 0.0, 1.0]) if place is None else place)
        return np.asarray(up / np.linalg.norm(up))

    def tiles(self) -> Iterator[Tile]:
        """Yield all tiles of the tileset, each before its children, depth first."""
        pending = [self.root]
        while pending:
            tile = pending.pop()
            yield tile
            pending += reversed(tile.children)

    def pairs(self) -> Iterator[tuple[Tile, Tile]]:
        """Yield every pair of a parent tile and a child tile."""
        for tile in self.tiles():
            for child in tile.children:
                yield tile, child
