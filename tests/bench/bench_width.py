"""Far coordinates: how many millimetres each way from a file to a picture, film or file loses.

A scene of map coordinates is drawn with a camera in map coordinates, and compared with the same
scene at zero, moved there in float64. A shift of the picture is measured by its gradient: the
least-squares displacement between both pictures, in millimetres at the distance of the scene.
Files are compared by their positions.

    .venv/bin/python tests/bench/bench_width.py
"""

import argparse
import io
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from gsgen.formats import Splats, open_splats, write_ply
from gsgen.formats.shared.origins import in_file_coordinates
from gsgen.formats.shared.splats import NO_ORIGIN
from support.commands import gsgen_here
from support.far_scenes import FAR_FILES, far_splats, write_scene_file

DISTANCE, FOV, SIZE = 6.0, 40.0, 256
DIRECTION = np.array([0.6, -0.35, -0.7])


def gsgen(folder: Path, *words: str) -> None:
    """Run a command in a folder; raise with its messages if it fails."""
    completed = gsgen_here(*words, cwd=folder)
    if completed.code:
        raise RuntimeError(f"gsgen {' '.join(words)}: {completed.err}")


def camera_words(target: np.ndarray) -> list[str]:
    """Return the options of a camera that looks at a point in the coordinates of the file."""
    eye = target + DISTANCE * DIRECTION / np.linalg.norm(DIRECTION)
    numbers = ",".join(f"{value:.17g}" for value in (*eye, *target))
    size = ["--width", str(SIZE), "--height", str(SIZE), "--fov", str(FOV)]
    return ["--camera", f"look-at:{numbers}", *size]


def draw(folder: Path, scene: Path, target: np.ndarray, name: str) -> np.ndarray:
    """Return the picture of a scene, as floats."""
    output = folder / f"{name}.npy"
    gsgen(folder, "render", str(scene), "-o", str(output), *camera_words(target))
    return np.asarray(np.load(output)[..., :3], np.float64)


def shift(picture: np.ndarray, expected: np.ndarray) -> float:
    """Return the displacement between two pictures, in millimetres at the scene's distance."""
    down, right = np.gradient(expected, axis=(0, 1))
    slopes = np.stack([down.ravel(), right.ravel()], axis=1)
    pixels, *_ = np.linalg.lstsq(slopes, (picture - expected).ravel(), rcond=None)
    pixel_size = 2 * DISTANCE * np.tan(np.radians(FOV) / 2) / SIZE
    return float(1000 * pixel_size * np.linalg.norm(pixels))


def position_error(path: Path, expected: Splats) -> float:
    """Return the largest error of the positions of a file, in millimetres."""
    splats = open_splats(path)
    assert isinstance(splats, Splats)
    actual, wanted = (np.sort(in_file_coordinates(item), axis=0) for item in (splats, expected))
    return float(1000 * np.abs(actual - wanted).max())


def film_frames(path: Path) -> list[np.ndarray]:
    """Return the frames of a folder of pictures, as floats."""
    return [np.load(file)[..., :3].astype(np.float64) for file in sorted(path.glob("*.npy"))]


def measure(folder: Path, origin: tuple[float, float, float]) -> list[tuple[str, float, float]]:
    """Return the error of each way in millimetres: its name, of the picture, of the positions."""
    splats = far_splats(origin)
    near = replace(splats, origin=NO_ORIGIN)
    write_ply(folder / "zero.ply", near)
    expected = draw(folder, folder / "zero.ply", np.zeros(3), "zero")
    target = np.array(origin)
    files = {name: write(folder, splats) for name, write in FAR_FILES.items()}
    rows = []
    for index, (name, path) in enumerate(files.items()):
        picture = draw(folder, path, target, str(index))
        rows.append((name, shift(picture, expected), position_error(path, splats)))
    scene = write_scene_file(folder, splats)
    rows.append(("scene file", shift(draw(folder, scene, target, "scene"), expected), 0.0))
    source = str(files["PLY of doubles"])
    for name, steps in {
        "PLY → PLY": ["a.ply"],
        "PLY → GLB → PLY": ["b.glb", "b.ply"],
        "GLB → PLY → GLB": ["c.ply", "c.glb"],
    }.items():
        current = str(files["GLB, far node"]) if name.startswith("GLB") else source
        for step in steps:
            gsgen(folder, "convert", current, step)
            current = str(folder / step)
        picture = draw(folder, Path(current), target, "converted")
        rows.append((name, shift(picture, expected), position_error(Path(current), splats)))
    for codec in ("khr", "spz"):
        tiles = folder / f"tiles-{codec}"
        words = ["--engine", "serial", "--codec", codec]
        gsgen(folder, "tiles", "build", source, "-o", str(tiles), *words)
        gsgen(folder, "convert", str(tiles / "tileset.json"), f"{codec}.ply")
        picture = draw(folder, tiles / "tileset.json", target, codec)
        error = position_error(folder / f"{codec}.ply", splats)
        rows.append((f"tiles ({codec})", shift(picture, expected), error))
    films = []
    for path, name in ((files["PLY of doubles"], "far"), (folder / "zero.ply", "near")):
        size = ["--width", str(SIZE), "--height", str(SIZE)]
        words = ["--camera", f"orbit:20,10,{DISTANCE}", "--frames", "5"]
        gsgen(folder, "render", str(path), "-o", str(folder / name), *words, *size)
        films.append(sorted((folder / name).glob("*")))
    from PIL import Image

    frames = [
        [
            np.asarray(Image.open(io.BytesIO(file.read_bytes())).convert("RGB"), float) / 255
            for file in film
        ]
        for film in films
    ]
    rows.append(("film", max(shift(far, zero) for far, zero in zip(*frames, strict=True)), 0.0))
    from gsgen.runtime.web.pages import model_bytes

    (folder / "page.ply").write_bytes(model_bytes(files["PLY of doubles"]))
    page = open_splats(folder / "page.ply")
    assert isinstance(page, Splats)
    chosen = open_splats(files["PLY of doubles"])
    assert isinstance(chosen, Splats)
    relative = np.abs(page.position + np.asarray(chosen.origin) - in_file_coordinates(splats)).max()
    rows.append(("page (its PLY)", 0.0, float(1000 * relative)))
    return rows


def main() -> None:
    """Print one line per way, and the largest error."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--origin", default="448262.53,5411932.27,512.75")
    options = parser.parse_args()
    x, y, z = map(float, options.origin.split(","))
    with tempfile.TemporaryDirectory() as folder:
        rows = measure(Path(folder), (x, y, z))
    print(f"{'way':<22}{'picture, mm':>14}{'positions, mm':>16}")
    for name, picture, position in rows:
        print(f"{name:<22}{picture:>14.4f}{position:>16.4f}")
    print(f"largest: {max(max(row[1:]) for row in rows):.4f} mm")


if __name__ == "__main__":
    main()
