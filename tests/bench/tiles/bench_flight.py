"""Bytes of a flight: what a good picture of each frame needs, beside the whole scene as SOG.

    python -m pytest tests/bench/tiles/bench_flight.py -o python_files='bench_*.py' \
        -o python_functions='bench_*' -s -q

The guide's town is built with small leaves, and its flight is flown. Each frame takes
the coarsest cut by screen-space error whose picture has SSIM .95 to that of all leaves, at each
quality; a file that an earlier frame needed is there. GSGEN_BENCH_SPLATS sets the size of the
town (1,000,000), GSGEN_BENCH_LEAF its leaves (4,096), GSGEN_BENCH_FRAMES the frames (6).
"""

import functools
import os
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gsgen.contract.spec.geometry import rotation_matrix
from gsgen.formats import read_ply, write_sog
from gsgen.formats.shared.origins import join_splats
from gsgen.formats.shared.splats import Splats
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.tiles.build.build import build_tileset
from gsgen.tiles.build.engines.opening import open_engine
from gsgen.tiles.build.frame import upright_transform
from gsgen.tiles.build.parameters import BuildParameters
from gsgen.tiles.build.progress import SilentProgress
from gsgen.tiles.loading.leaves import read_contents
from gsgen.tiles.loading.tileset_loader import load_tileset
from gsgen.tiles.prediction.poses import Pose
from gsgen.tiles.scoring.ssim import ssim
from gsgen.tiles.selection.cut import cut_tree
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.simulate.tables import read_path
from gsgen.tiles.stores.opening import open_store
from gsgen.tiles.stores.store import Store
from support.measures import print_figure
from support.reports.pages import DOCS, blocks
from support.tiles.level_scenes import picture

GUIDE = DOCS / "guides" / "a-city-in-tiles.md"
COUNT = int(os.environ.get("GSGEN_BENCH_SPLATS", 1_000_000))
FRAMES = int(os.environ.get("GSGEN_BENCH_FRAMES", 6))
LEAF = int(os.environ.get("GSGEN_BENCH_LEAF", 4096))
WIDTH, HEIGHT, FOV_Y = 320, 240, 50.0
QUALITIES = (0, 2, 3, 4)
SSIM_BAR, BYTES_BAR = 0.95, 0.5
ERRORS = (*(512 * 0.96 ** np.arange(130)).tolist(), 0.0)  # pixels, coarsest first


def camera_of(pose: Pose) -> Camera:
    turn = rotation_matrix(pose.quaternion[None])[0].T
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = turn, -turn @ pose.position
    focal = HEIGHT / 2 / np.tan(np.radians(FOV_Y) / 2)
    return Camera(view, fx=focal, fy=focal, cx=WIDTH / 2, cy=HEIGHT / 2, width=WIDTH, height=HEIGHT)


@dataclass
class Ladder:
    """A tileset at one quality, and the tile files that the frames so far have needed."""

    name: str
    store: Store
    index: str
    needed: set[int] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.tileset = load_tileset(self.store, self.index, name=self.name)
        self.tree = TileTree.of_tileset(self.tileset, self.store)
        self.content = functools.cache(self._content)

    def _content(self, row: int) -> Splats | None:
        tile = self.tree.tiles[row]
        parts = [
            placed.relative_to_origin(np.zeros(3))
            for content in tile.contents
            for placed in read_contents(self.store, self.tileset, [(tile, content)])
        ]
        return join_splats(parts) if parts else None

    def drawn(self, camera: Camera, max_error: float) -> list[int]:
        """Rows of the tree that a camera draws; tiles without content have none."""
        cut = cut_tree(self.tree, Frustum.from_camera(camera), max_error)
        shown = cut.selected | (cut.seen & self.tree.is_additive)
        return [int(row) for row in np.flatnonzero(shown) if self.tree.tiles[row].contents]

    def picture(self, renderer: Renderer, camera: Camera, rows: list[int]) -> np.ndarray:
        parts = [content for row in rows if (content := self.content(row)) is not None]
        return picture(renderer, join_splats(parts), camera)

    def bytes_of(self, rows: set[int]) -> int:
        return int(self.tree.size[sorted(rows)].sum())


def coarsest_cut(
    ladder: Ladder, renderer: Renderer, camera: Camera, expected: np.ndarray
) -> tuple[float, list[int], float] | None:
    """Return the error, the tiles and the SSIM of the coarsest cut that is good enough."""
    before: list[int] | None = None
    for max_error in ERRORS:
        rows = ladder.drawn(camera, max_error)
        if rows == before:
            continue
        before = rows
        score = ssim(ladder.picture(renderer, camera, rows), expected)
        if score >= SSIM_BAR:
            return max_error, rows, score
    return None


def bench_bytes_of_the_flight(tmp_path: Path) -> None:
    """Tiles of SSIM .95 over the flight have half the bytes of the scene as SOG, or less."""
    for block in blocks(GUIDE):
        if block.mark in ("town.py", "flight.py"):
            words = [sys.executable, "-c", block.text, str(COUNT)]
            subprocess.run(words, cwd=tmp_path, check=True)
    write_sog(tmp_path / "town.sog", read_ply(tmp_path / "town.ply"))
    whole = (tmp_path / "town.sog").stat().st_size
    parameters = BuildParameters(leaf=LEAF, qualities=QUALITIES, transform=upright_transform())
    with open_engine("serial") as engine:
        build_tileset(
            [tmp_path / "town.ply"],
            tmp_path / "town",
            parameters,
            engine=engine,
            progress=SilentProgress(),
        )
    poses = read_path(tmp_path / "flight.csv")
    chosen = np.linspace(0, len(poses) - 1, FRAMES).round().astype(int)
    renderer = Renderer()
    ladders = []
    for quality in parameters.qualities:
        store, index = open_store(str(tmp_path / "town" / f"tileset-q{quality}.json"))
        ladders.append(Ladder(f"quality {quality}", store, index))
    finest_ladder = ladders[0]
    leaves = finest_ladder.bytes_of(set(np.flatnonzero(finest_ladder.tree.is_leaf).tolist()))
    print_figure(
        f"{COUNT:,} splats, {len(finest_ladder.tree)} tiles; SOG {whole / 1e6:.2f} MB, "
        f"all leaves {leaves / 1e6:.2f} MB; {WIDTH} × {HEIGHT}"
    )
    print_figure("frame: pixels of error, tiles, SSIM, kB that are new, at each quality")
    failed: set[str] = set()
    for number in chosen.tolist():
        camera = camera_of(poses[number])
        expected = finest_ladder.picture(renderer, camera, finest_ladder.drawn(camera, 0))
        columns = []
        for ladder in ladders:
            cut = coarsest_cut(ladder, renderer, camera, expected)
            if cut is None:
                failed.add(ladder.name)
                columns.append(f"{'below .95':30s}")
                continue
            max_error, rows, score = cut
            new = ladder.bytes_of(set(rows) - ladder.needed)
            ladder.needed |= set(rows)
            columns.append(
                f"{max_error:4.1f} px {len(rows):3d} tiles {score:.3f} {new / 1e3:6.0f} kB"
            )
        print_figure(f"{poses[number].time:5.1f} s   " + "   ".join(columns))
    shares = {}
    for ladder in ladders:
        share = ladder.bytes_of(ladder.needed) / whole
        verdict = "some frames below .95" if ladder.name in failed else f"bar {BYTES_BAR:.0%}"
        print_figure(f"{ladder.name}: {share:.1%} of the scene as SOG ({verdict})")
        if ladder.name not in failed:
            shares[ladder.name] = share
    assert min(shares.values()) <= BYTES_BAR
