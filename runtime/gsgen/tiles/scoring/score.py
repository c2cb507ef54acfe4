"""Compare renderings of each level of a tileset with renderings of its source scene."""

__all__ = [
    "CAMERA_DISTANCES",
    "FIELD_OF_VIEW",
    "NEAR_TILE_SHARE",
    "LevelScore",
    "TilesetScore",
    "cameras_around",
    "draw",
    "draw_sheet",
    "level_cut",
    "score_tileset",
]

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from gsgen.contract.spec.units import MEBIBYTE
from gsgen.formats import PackedRows, PointCloud, Splats
from gsgen.formats.packed import splats_of_rows
from gsgen.formats.shared.origins import join_splats, relative_to
from gsgen.formats.shared.splats import NO_ORIGIN
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.format.tileset import Content, Tile, Tileset
from gsgen.tiles.loading.leaves import open_splats, read_contents
from gsgen.tiles.loading.streamed_sog import SogFiles
from gsgen.tiles.loading.tileset_loader import load_tileset
from gsgen.tiles.scoring.ssim import ssim
from gsgen.tiles.stores.opening import open_store
from gsgen.tiles.stores.store import Store

Picture = Float32[np.ndarray, "h w 3"]

_CAPTION_HEIGHT: Final = 18  # pixels of the caption above a picture on a sheet
_PICTURE_GAP: Final = 4  # pixels between the pictures of a sheet

CAMERA_DISTANCES: Final = {"near": 1.5, "middle": 3.0, "far": 6.0}
"""Name → distance of the camera from the middle, in radii of the scene."""

FIELD_OF_VIEW: Final = 50.0
"""Vertical field of view of the cameras around a scene or a tile, in degrees."""
NEAR_TILE_SHARE: Final = 100
"""Radii of a scene or a tile over the distance of the near plane."""

_AZIMUTH_DEGREES = (20.0, 140.0, 260.0)
_CAMERA_RING_LATITUDE = 20.0
_INNER_FRACTION = 0.9


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LevelScore:
    """The SSIM, splats and bytes of one level of detail.

    Attributes:
        level: How many times the root is refined.
        tiles: Contents that are drawn.
        splats: In all of them.
        bytes: Of all their files.
        ssim: Distance → mean structural similarity to the scene.
    """

    level: int
    tiles: int
    splats: int
    bytes: int
    ssim: dict[str, float]


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TilesetScore:
    """The scores and pictures of all levels of a tileset.

    Attributes:
        splats: Of the scene.
        levels: Coarsest first; the last one has all leaves.
        pictures: Name of a column (``scene``, ``level 0`` …) → distance → rendered picture.
    """

    splats: int
    levels: tuple[LevelScore, ...]
    pictures: dict[str, dict[str, Picture]]


def score_tileset(
    source: str | Path,
    scene: Path,
    *,
    width: int = 320,
    height: int = 240,
    progress: Callable[[str], None] = lambda words: None,
) -> TilesetScore:
    """Render each level of a tileset and its source scene, and compute their SSIM.

    Args:
        source: The tileset.
        scene: The file that it was made of, in the frame of the root tile.
        width: Of the pictures, in pixels.
        height: Of the pictures, in pixels.
        progress: Called with a few words whenever a new stage begins.

    Raises:
        TilesetInvalid: A file of the tileset is missing or wrong.
        FormatError: The scene cannot be read.
        DeviceUnavailable: There is nothing to draw with.
    """
    content = open_splats(scene)
    if isinstance(content, PointCloud):
        raise TilesetInvalid(
            "the file to compare the tileset with holds coloured points",
            location=str(scene),
            expected="splats",
        )
    splats = splats_of_rows(content) if isinstance(content, PackedRows) else content
    renderer = Renderer()
    store, index = open_store(source)
    with store:
        tileset = load_tileset(store, index, name=str(source))
        splats = replace(relative_to(splats, tileset.origin), origin=NO_ORIGIN)  # in the root frame
        cameras = _cameras(splats, tileset.up, width, height)
        progress("drawing the scene")
        expected = _draw(renderer, splats, cameras)
        pictures = {"scene": _first_picture_by_level(expected)}
        levels = []
        sog_files = SogFiles()
        for level in range(_tileset_depth(tileset) + 1):
            progress(f"drawing level {level} of {_tileset_depth(tileset)}")
            level_contents = list(level_cut(tileset.root, level))
            drawn, size = _read(store, tileset, level_contents, sog_files)
            renders = _draw(renderer, drawn, cameras)
            pictures[f"level {level}"] = _first_picture_by_level(renders)
            levels.append(
                LevelScore(
                    level=level,
                    tiles=len(level_contents),
                    splats=len(drawn),
                    bytes=size,
                    ssim={
                        name: _mean_similarity(renders[name], expected[name]) for name in renders
                    },
                )
            )
    return TilesetScore(splats=len(splats), levels=tuple(levels), pictures=pictures)


def level_cut(root: Tile, level: int) -> Iterator[tuple[Tile, Content]]:
    """Yield the tile contents that are drawn if the root is refined a given number of times.

    Tiles without content do not count: they are refined in any case.
    """
    pending = [(root, level)]
    while pending:
        tile, refinement_count = pending.pop()
        is_cut_here = not tile.children or (refinement_count == 0 and bool(tile.contents))
        if is_cut_here or tile.refine == "ADD":
            for content in tile.contents:
                yield tile, content
        if not is_cut_here:
            below = refinement_count - 1 if tile.contents else refinement_count
            pending += [(child, below) for child in reversed(tile.children)]


def _tileset_depth(tileset: Tileset) -> int:
    """Return the number of refinements from the root to the finest tiles."""
    max_depth, pending = 0, [(tileset.root, 0)]
    while pending:
        tile, depth = pending.pop()
        below = depth + bool(tile.contents)
        if tile.children:
            pending += [(child, below) for child in tile.children]
        else:
            max_depth = max(max_depth, depth)
    return max_depth


def _read(
    store: Store, tileset: Tileset, level_contents: list[tuple[Tile, Content]], sog_files: SogFiles
) -> tuple[Splats, int]:
    """Return the splats of tile contents as one set, and the bytes of their files."""
    placed = read_contents(store, tileset, level_contents, sog_files)
    parts = [entry.relative_to_origin(np.zeros(3)) for entry in placed]
    uris = {content.uri for _, content in level_contents}  # tiles may be rows of one file
    size = sum(sog_files.sizes.get(uri) or store.size(uri) for uri in uris)
    if not parts:
        raise TilesetInvalid(
            f"a level of detail of the tileset ({len(level_contents)} tiles) has no splats",
            location=tileset.index,
            expected="contents with KHR_gaussian_splatting",
            fault=Fault.CONTENT,
        )
    return join_splats(parts), size


def _cameras(
    splats: Splats, up: Float64[np.ndarray, " 3"], width: int, height: int
) -> dict[str, list[Camera]]:
    """Return cameras around the middle of the scene, grouped by distance."""
    center = np.median(splats.position.astype(np.float64), axis=0)
    distances = np.linalg.norm(splats.position - center, axis=1)
    radius = max(float(np.quantile(distances, _INNER_FRACTION)), 1e-6)
    return {
        name: cameras_around(
            center, distance * radius, up, size=(width, height), near=radius / NEAR_TILE_SHARE
        )
        for name, distance in CAMERA_DISTANCES.items()
    }


def cameras_around(
    center: Float64[np.ndarray, " 3"],
    distance: float,
    up: Float64[np.ndarray, " 3"],
    *,
    size: tuple[int, int],
    near: float,
) -> list[Camera]:
    """Return three cameras around a point, a little above it."""
    width, height = size
    return [
        Camera.orbit(
            center.tolist(),
            distance,
            azimuth=azimuth,
            elevation=_CAMERA_RING_LATITUDE,
            up=up.tolist(),
            width=width,
            height=height,
            fov_y=FIELD_OF_VIEW,
            near=near,
        )
        for azimuth in _AZIMUTH_DEGREES
    ]


def draw(
    renderer: Renderer, splats: Splats, cameras: list[Camera], alpha: float = 1.0
) -> list[Float32[np.ndarray, "h w 4"]]:
    """Return RGBA pictures of splats from cameras, on black of an alpha."""
    scene, pictures = Scene([SplatData.from_splats(splats)]), []
    for camera in cameras:
        frame = renderer.render(scene, camera, background=(0, 0, 0, alpha))
        assert frame.rgba is not None
        pictures.append(np.clip(frame.rgba, 0, 1))
    return pictures


def _draw(
    renderer: Renderer, splats: Splats, cameras: dict[str, list[Camera]]
) -> dict[str, list[Picture]]:
    return {
        name: [picture[..., :3] for picture in draw(renderer, splats, views)]
        for name, views in cameras.items()
    }


def _first_picture_by_level(pictures: dict[str, list[Picture]]) -> dict[str, Picture]:
    return {name: views[0] for name, views in pictures.items()}


def _mean_similarity(renders: list[Picture], expected: list[Picture]) -> float:
    return float(np.mean([ssim(a, b) for a, b in zip(renders, expected, strict=True)]))


def draw_sheet(score: TilesetScore) -> UInt8[np.ndarray, "h w 3"]:
    """Return a sheet of pictures with SSIM: the scene, then levels of detail, finest first."""
    from PIL import Image, ImageDraw

    levels = {f"level {entry.level}": entry for entry in score.levels}
    columns = ["scene", *reversed(levels)]
    height, width = score.pictures["scene"]["near"].shape[:2]
    size = (
        len(columns) * (width + _PICTURE_GAP) - _PICTURE_GAP,
        len(CAMERA_DISTANCES) * (height + _CAPTION_HEIGHT + _PICTURE_GAP) - _PICTURE_GAP,
    )
    contact_sheet: Any = Image.new("RGB", size, (40, 40, 40))
    draw_context = ImageDraw.Draw(contact_sheet)
    for column, name in enumerate(columns):
        for row, distance in enumerate(CAMERA_DISTANCES):
            x, y = column * (width + _PICTURE_GAP), row * (height + _CAPTION_HEIGHT + _PICTURE_GAP)
            picture = np.rint(score.pictures[name][distance] * 255).astype(np.uint8)
            contact_sheet.paste(Image.fromarray(picture), (x, y + _CAPTION_HEIGHT))
            text = f"{distance}: {score.splats:,} splats"
            if name in levels:
                entry = levels[name]
                text = (
                    f"{name}: {entry.splats:,}, {entry.bytes / MEBIBYTE:.2f} MiB, "
                    f"SSIM {entry.ssim[distance]:.4f}"
                )
            draw_context.text((x + 4, y + 3), text, fill=(240, 240, 240))
    return np.asarray(contact_sheet)
