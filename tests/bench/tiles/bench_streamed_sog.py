"""Streamed SOG: ours beside splat-transform's, and both beside a tileset of the same town.

    python -m pytest tests/bench/tiles/bench_streamed_sog.py -o python_files='bench_*.py' \
        -o python_functions='bench_*' -s -q

``scripts/fetch.sh splat-transform`` fetches the converter. Its levels are made by one run each, and
put together by another. Pictures are those of a cut, refined until they have SSIM 0.95: streamed SOG
by the levels' errors, as `gsgen view` draws them, and tilesets at their coarsest files. Bytes are
those of all files that the drawn tiles are in, since a viewer fetches files whole.
"""

import os
import resource
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np

from gsgen.formats import read_ply
from gsgen.formats.shared.origins import join_splats
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.tiles.loading.leaves import place_content, read_contents
from gsgen.tiles.loading.streamed_sog import SogFiles
from gsgen.tiles.loading.tileset_loader import load_tileset
from gsgen.tiles.scoring.ssim import ssim
from gsgen.tiles.selection.cut import cut_tree
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.stores.opening import open_store
from support.measures import print_figure
from support.reports.pages import DOCS, blocks
from support.tiles.level_scenes import picture
from support.web.packages import package, require_node

COUNT = os.environ.get("GSGEN_BENCH_SPLATS", "1000000")
GUIDE = DOCS / "guides" / "a-city-in-tiles.md"
SIZE = (320, 240)
WANTED_SSIM = 0.95
TILESET_BAR, BYTES_BAR, CPU_BAR = 0.6, 1.1, 0.5
EYES = ((6.0, -1.7, -6.0), (-50.0, -18.0, 40.0), (-150.0, -90.0, 130.0))
TARGETS = ((60.0, -1.0, -50.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
_LEVELS = 4


def cpu_seconds(command: list[str], folder: Path) -> float:
    """Run a command; return the CPU seconds of it and its children."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def made_by_splat_transform(folder: Path) -> float:
    """Write ``theirs/lod-meta.json`` of town.ply in a folder; return the CPU seconds."""
    tool = package("splat-transform-3.7.0", needs_node=True) / "bin/cli.mjs"
    command = [require_node(), str(tool), "-w"]
    seconds, parts = 0.0, ["town.ply", "-l", "0"]
    for level in range(1, _LEVELS):
        share = ["town.ply", "--decimate", f"{100 / 4**level:g}%", f"level{level}.ply"]
        seconds += cpu_seconds([*command, *share], folder)
        parts += [f"level{level}.ply", "-l", str(level)]
    (folder / "theirs").mkdir()
    return seconds + cpu_seconds([*command, *parts, "theirs/lod-meta.json"], folder)


def written_bytes(folder: Path, names: set[str]) -> int:
    """Return the bytes of contents, and of the images beside those that are a meta.json."""
    files = {
        file
        for name in names
        for file in (
            (folder / name).parent.iterdir() if name.endswith("meta.json") else [folder / name]
        )
    }
    return sum(file.stat().st_size for file in files)


def bytes_to_ssim(index: Path, references: list[np.ndarray], renderer: Renderer) -> list[int]:
    """Return the bytes with which each camera's picture has the wanted SSIM."""
    store, name = open_store(index)
    tileset = load_tileset(store, name)
    tree, sog_files = TileTree.of_tileset(tileset, store), SogFiles()

    @cache
    def splats(row: int) -> list:
        tile, parts = tree.tiles[row], []
        for entry in tile.contents:
            if entry.rows is None:
                parts += read_contents(store, tileset, [(tile, entry)])
                continue
            rows = sog_files.read(entry, lambda file, limit: store.read(file, limit=limit))
            parts += place_content(tileset, tile, entry, rows)
        return [placed.relative_to_origin(np.zeros(3)) for placed in parts]

    sizes = []
    for eye, target, reference in zip(EYES, TARGETS, references, strict=True):
        camera = camera_at(eye, target)
        for error in (*(400 * 0.7 ** np.arange(16)), 0.0):
            cut = cut_tree(tree, Frustum.from_camera(camera), error)
            drawn = [row for row in np.flatnonzero(cut.selected) if tree.tiles[row].contents]
            drawn_splats = join_splats([part for row in drawn for part in splats(int(row))])
            if ssim(picture(renderer, drawn_splats, camera), reference) >= WANTED_SSIM:
                break
        seen = [row for row in np.flatnonzero(cut.seen) if tree.tiles[row].contents]
        names = {entry.uri for row in seen for entry in tree.tiles[row].contents}
        sizes.append(written_bytes(index.parent, names))
    return sizes


def camera_at(eye: tuple[float, float, float], target: tuple[float, float, float]) -> Camera:
    """Return a camera in the frame of the scene, which is that of the tilesets' roots, too."""
    return Camera.look_at(eye, target, up=(0, -1, 0), width=SIZE[0], height=SIZE[1])


def bench_streamed_sog(tmp_path: Path) -> None:
    """Build time, bytes, and bytes to a picture of SSIM 0.95."""
    script = next(block.text for block in blocks(GUIDE) if block.mark == "town.py")
    subprocess.run([sys.executable, "-c", script, COUNT], cwd=tmp_path, check=True)
    gsgen = [sys.executable, "-m", "gsgen.cli", "tiles", "build", "town.ply", "--engine", "serial"]
    seconds = {
        "sog": cpu_seconds([*gsgen, "-o", "sog", "--codec", "sog"], tmp_path),
        "tiles": cpu_seconds([*gsgen, "-o", "tiles"], tmp_path),
        "theirs": made_by_splat_transform(tmp_path),
    }
    scene, renderer = read_ply(tmp_path / "town.ply"), Renderer()
    pairs = zip(EYES, TARGETS, strict=True)
    references = [picture(renderer, scene, camera_at(*pair)) for pair in pairs]
    indices = {
        "sog": tmp_path / "sog/lod-meta.json",
        "tiles": tmp_path / "tiles/tileset-q4.json",
        "theirs": tmp_path / "theirs/lod-meta.json",
    }
    needed = {name: bytes_to_ssim(index, references, renderer) for name, index in indices.items()}
    whole = {
        name: sum(file.stat().st_size for file in (tmp_path / name).rglob("*") if file.is_file())
        for name in ("sog", "theirs")
    }
    for name, sizes in needed.items():
        kilobytes = ", ".join(f"{size / 1e3:.0f}" for size in sizes)
        print_figure(f"{name}: {seconds[name]:.1f} CPU-s; to SSIM {WANTED_SSIM}: {kilobytes} kB")
    share = max(a / b for a, b in zip(needed["tiles"], needed["theirs"], strict=True))
    byte_share, cpu_share = whole["sog"] / whole["theirs"], seconds["sog"] / seconds["theirs"]
    print_figure(f"tileset to SSIM {WANTED_SSIM} beside theirs: {share:.2f} (bar {TILESET_BAR})")
    print_figure(f"bytes beside theirs: {byte_share:.2f} (bar {BYTES_BAR})")
    print_figure(f"CPU beside theirs: {cpu_share:.2f} (bar {CPU_BAR})")
    assert share <= TILESET_BAR
    assert byte_share <= BYTES_BAR
    assert cpu_share <= CPU_BAR
