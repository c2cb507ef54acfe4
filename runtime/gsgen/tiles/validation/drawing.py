"""Draws a tileset's root and largest leaf, and compares tiles with those that replace them.

The root and the leaf with the most splats are drawn from three cameras around each. The root and
the parent of that leaf are compared with the tiles that replace them, from the distance at which
a viewer changes from one to the other. Rules of level ``render`` check the results.
"""

__all__ = ["ComparedLevels", "DrawnTile", "DrawnTileset", "draw_tileset"]

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Float32, Float64

from gsgen.formats.shared.splats import Splats
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.tiles.format.tileset import Content, Tile, Tileset
from gsgen.tiles.gltf.placement import PlacedSplats, join_placed
from gsgen.tiles.loading.leaves import read_contents
from gsgen.tiles.scoring.score import (
    FIELD_OF_VIEW,
    NEAR_TILE_SHARE,
    cameras_around,
    draw,
    level_cut,
)
from gsgen.tiles.scoring.ssim import ssim
from gsgen.tiles.stores.store import Store

TILE_VISIBLE_RULE: Final = "GT021"
LEVELS_AGREE_RULE: Final = "GT022"
MAX_DRAWN_SPLATS: Final = 1_000_000
"""Tiles with more splats are not drawn: the time and the memory of a validation are bounded."""
REFINEMENT_PIXELS: Final = 16.0
"""Pixels of geometric error at which viewers change from a tile to its children."""

_CAMERA_DISTANCE_RADII: Final = 2.5  # radii of the tile, with which it fills the picture
_PICTURE_SIZE_LIMITS: Final = (64, 512)  # the smallest and largest picture, in pixels
_WINDOW_PIXELS: Final = 16  # pixels: the smallest part of a picture that is compared
_RgbaImage = Float32[np.ndarray, "h w 4"]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnTile:
    """The result of drawing the splats of one tile.

    Attributes:
        uri: Of the content.
        splats: How many it has.
        covered: The highest alpha of any pixel of any picture, in [0, 1].
    """

    uri: str
    splats: int
    covered: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedLevels:
    """The similarity of a tile's picture to the picture of its child tiles.

    Attributes:
        location: Of the parent tile.
        children: How many contents replace it.
        pixels: Geometric error of the parent in the pictures.
        ssim: Mean over the pictures, of the parts that either covers.
    """

    location: str
    children: int
    pixels: float
    ssim: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnTileset:
    """The results of drawing a tileset, which the rules of level ``render`` check.

    Attributes:
        tiles: The root and a leaf, or the only content.
        levels: Parents that were compared with their children.
        skipped: Id of a rule that cannot be checked, as a tile has too many splats → the reason.
    """

    tiles: tuple[DrawnTile, ...]
    levels: tuple[ComparedLevels, ...]
    skipped: Mapping[str, str]


def draw_tileset(tileset: Tileset, store: Store, counts: dict[str, int]) -> DrawnTileset:
    """Draw the root and a leaf of a tileset, and compare parents with their children.

    Args:
        tileset: With valid contents.
        store: Where its files lie.
        counts: Uri of a content → its number of splats.

    Raises:
        DeviceUnavailable: There is nothing to draw with.
        TilesetInvalid: A file cannot be read again.
    """
    tile_renderer = _TileRenderer(tileset, store, counts)
    content_tiles = [tile for tile in tileset.tiles() if tile_renderer.count(_contents_of(tile))]
    if not content_tiles:
        return DrawnTileset(tiles=(), levels=(), skipped={})
    leaves = [tile for tile in content_tiles if not tile.children]
    leaf = max(
        leaves, key=lambda tile: tile_renderer.count(_contents_of(tile)), default=content_tiles[-1]
    )
    parents = {id(child): parent for parent, child in tileset.pairs()}
    coarse_tiles = [
        tile for tile in (content_tiles[0], parents.get(id(leaf))) if _is_replaced_tile(tile)
    ]
    tiles = [tile_renderer.draw(tile) for tile in _distinct_tiles([content_tiles[0], leaf])]
    levels = [tile_renderer.compare(tile) for tile in _distinct_tiles(coarse_tiles)]
    return DrawnTileset(
        tiles=tuple(entry for entry in tiles if entry is not None),
        levels=tuple(entry for entry in levels if entry is not None),
        skipped=tile_renderer.skipped,
    )


def _contents_of(tile: Tile) -> list[tuple[Tile, Content]]:
    return [(tile, content) for content in tile.contents]


def _is_replaced_tile(tile: Tile | None) -> bool:
    return bool(tile and tile.children and tile.contents and tile.refine == "REPLACE")


def _distinct_tiles(tiles: Iterable[Tile | None]) -> Iterator[Tile]:
    """Yield each distinct tile of a list once, in order, and skip entries that are None."""
    seen: set[int] = set()
    for tile in tiles:
        if tile is not None and id(tile) not in seen:
            seen.add(id(tile))
            yield tile


@final
class _TileRenderer:
    """Draws tiles of a tileset, and records tiles that have too many splats."""

    def __init__(self, tileset: Tileset, store: Store, counts: dict[str, int]) -> None:
        self._tileset, self._store, self._counts = tileset, store, counts
        self._renderer = Renderer()
        self.skipped: dict[str, str] = {}

    def count(self, cut: list[tuple[Tile, Content]]) -> int:
        """Return the number of splats in the content files of tiles."""
        return sum(self._counts.get(content.uri, 0) for _, content in cut)

    def draw(self, tile: Tile) -> DrawnTile | None:
        """Draw the contents of a tile; return None if they have too many splats."""
        cut = _contents_of(tile)
        if self._is_too_large(TILE_VISIBLE_RULE, cut):
            return None
        parts = self._read(cut)
        view = _View.looking_at_bounds(parts, self._tileset.up)
        pictures = self._pictures(
            join_placed(parts, view.center), view.cameras(_CAMERA_DISTANCE_RADII)
        )
        return DrawnTile(
            uri=tile.contents[0].uri,
            splats=self.count(cut),
            covered=max(float(picture[..., 3].max()) for picture in pictures),
        )

    def compare(self, parent: Tile) -> ComparedLevels | None:
        """Compare pictures of a tile and its children; return None for too many splats."""
        cut = list(level_cut(parent, 1))
        if self._is_too_large(LEVELS_AGREE_RULE, _contents_of(parent), cut):
            return None
        parent_parts, child_parts = self._read(_contents_of(parent)), self._read(cut)
        if not child_parts:
            return None
        scale = float(np.cbrt(np.linalg.det(parent.transform[:3, :3])))
        view = _View.looking_at_bounds(
            parent_parts + child_parts, self._tileset.up, error=parent.geometric_error * scale
        )
        pairs = zip(
            self._pictures(join_placed(parent_parts, view.center), view.cameras(view.distance)),
            self._pictures(join_placed(child_parts, view.center), view.cameras(view.distance)),
            strict=True,
        )
        return ComparedLevels(
            location=parent.location,
            children=len(cut),
            pixels=view.pixels,
            ssim=float(np.mean([_picture_similarity(a, b) for a, b in pairs])),
        )

    def _is_too_large(self, rule: str, *level_cuts: list[tuple[Tile, Content]]) -> bool:
        """Return whether tiles have too many splats to draw; if so, note that a rule is skipped."""
        count = max(map(self.count, level_cuts))
        if count > MAX_DRAWN_SPLATS:
            tile = level_cuts[0][0][0]
            self.skipped[rule] = (
                f"{tile.location}: {count:,} splats, and {MAX_DRAWN_SPLATS:,} are drawn at most"
            )
        return count > MAX_DRAWN_SPLATS

    def _read(self, cut: list[tuple[Tile, Content]]) -> list[PlacedSplats]:
        return read_contents(self._store, self._tileset, cut)

    def _pictures(self, splats: Splats, cameras: list[Camera]) -> list[_RgbaImage]:
        return draw(self._renderer, splats, cameras, alpha=0.0)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _View:
    """The centre, distance and image size of cameras around some splats.

    Attributes:
        center: Middle of the splats, in the root frame.
        radius: Distance of the farthest centre from the middle.
        up: Upward direction of the root frame.
        size: Width and height of the pictures.
        distance: Of the camera from the middle, in radii.
        pixels: Of the geometric error at that distance.
    """

    center: Float64[np.ndarray, " 3"]
    radius: float
    up: Float64[np.ndarray, " 3"]
    size: int
    distance: float
    pixels: float

    @classmethod
    def looking_at_bounds(
        cls, parts: list[PlacedSplats], up: Float64[np.ndarray, " 3"], error: float = 0.0
    ) -> "_View":
        """Return a view from the distance at which viewers load finer tiles for a geometric error.

        The splats fill the picture if its size is within limits. Beyond the upper one they are
        seen from as near; below the lower one, from farther away.
        """
        positions = np.concatenate([part.positions() for part in parts])
        reach = max(float(np.exp(np.median(part.splats.log_scale.max(axis=1)))) for part in parts)
        low, high = positions.min(axis=0), positions.max(axis=0)
        radius = max(float(np.linalg.norm(high - low)) / 2 + 2 * reach, 1e-6)
        half_tangent = math.tan(math.radians(FIELD_OF_VIEW) / 2)
        share = error / radius
        size = (
            _PICTURE_SIZE_LIMITS[1]
            if not share
            else 2 * half_tangent * _CAMERA_DISTANCE_RADII * REFINEMENT_PIXELS / share
        )
        size = int(min(max(size, _PICTURE_SIZE_LIMITS[0]), _PICTURE_SIZE_LIMITS[1]))
        focal = size / 2 / half_tangent
        distance = max(_CAMERA_DISTANCE_RADII, share * focal / REFINEMENT_PIXELS)
        return cls(
            center=(low + high) / 2,
            radius=radius,
            up=up,
            size=size,
            distance=distance,
            pixels=share * focal / distance,
        )

    def cameras(self, distance: float) -> list[Camera]:
        """Return cameras around the origin, at a distance in multiples of the splats' radius."""
        return cameras_around(
            np.zeros(3),
            distance * self.radius,
            self.up,
            size=(self.size, self.size),
            near=self.radius / NEAR_TILE_SHARE,
        )


def _picture_similarity(a: _RgbaImage, b: _RgbaImage) -> float:
    """Return the SSIM of two pictures, in the rectangle that the splats of either cover."""
    covered_mask = (a[..., 3] > 0) | (b[..., 3] > 0)
    rows, columns = (_covered_slice(np.asarray(covered_mask.any(axis=axis))) for axis in (1, 0))
    return ssim(a[rows, columns, :3], b[rows, columns, :3])


def _covered_slice(covered_mask: np.ndarray) -> slice:
    """Return the range of covered pixels along an axis, at least as long as the SSIM window."""
    indices = np.flatnonzero(covered_mask)
    first, last = (int(indices[0]), int(indices[-1])) if len(indices) else (0, 0)
    missing = max(_WINDOW_PIXELS - (last + 1 - first), 0)
    first = max(first - missing, 0)
    return slice(first, max(last + 1, first + _WINDOW_PIXELS))
