"""Writes the files of `gsgen samples`: a scene, cameras, an ONNX generator and a motion."""

__all__ = ["SAMPLE_WRITERS", "write_samples"]

import json
from collections.abc import Callable
from filecmp import cmp
from pathlib import Path
from shutil import copyfile
from typing import Final

import numpy as np

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.process.atomic_files import atomic_write
from gsgen.contract.process.drafts import temporary_folder
from gsgen.formats import write_ply
from gsgen.reference_plugins.samples.garden import garden
from gsgen.reference_plugins.samples.sunflower import sunflower_model, write_nods
from gsgen.runtime.scene.camera import Camera

_IMAGE_SIZE = {"width": 960, "height": 540}  # pixels of each camera
_SCENE_DOCUMENT = {
    "gsgen_scene": "1.0",
    "models": ["garden.ply", {"path": "sunflower.onnx", "translate": [1.2, 0, 0.9], "scale": 0.9}],
    "background": "#b9d3ea",
    "camera": "look-at:-1.0,-1.75,3.7,0.1,-0.75,0",
    **_IMAGE_SIZE,
}


def _write_garden(path: Path) -> None:
    write_ply(path, garden())


def _write_cameras(path: Path) -> None:
    """Write six cameras on an arc before the hedge, as JSON of view matrices and focal lengths."""
    cameras = []
    for azimuth in np.radians(np.linspace(-60, 60, 6)):
        camera_position = [3.9 * np.sin(azimuth), -1.75, 3.9 * np.cos(azimuth)]
        camera = Camera.look_at(
            camera_position, [0.0, -0.75, 0.0], fov_y=42.0, width=960, height=540
        )
        lens_fields = {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy")}
        cameras.append({"view": camera.view.tolist(), **lens_fields, **_IMAGE_SIZE})
    path.write_text(json.dumps(cameras, indent=1), "utf-8")


def _write_sunflower(path: Path) -> None:
    path.write_bytes(sunflower_model().SerializeToString())


def _write_scene(path: Path) -> None:
    path.write_text(json.dumps(_SCENE_DOCUMENT, indent=2), "utf-8")


def _write_mesh(path: Path) -> None:
    """Write a low wall of blue stone as an OBJ box, with y down as in the garden."""
    low, high = (-1.75, -0.42, 1.1), (-0.75, 0.0, 1.4)
    corners = [[(low, high)[i >> axis & 1][axis] for axis in range(3)] for i in range(8)]
    faces = ((1, 3, 4, 2), (5, 6, 8, 7), (1, 2, 6, 5), (3, 7, 8, 4), (1, 5, 7, 3), (2, 4, 8, 6))
    lines = [f"v {x} {y} {z} 0.35 0.45 0.6" for x, y, z in corners]
    lines += [f"f {a} {b} {c} {d}" for a, b, c, d in faces]
    path.write_text("\n".join(lines) + "\n", "utf-8")


SAMPLE_WRITERS: Final[dict[str, tuple[str, Callable[[Path], object]]]] = {
    "garden.ply": ("a garden of about 70,000 splats, SH degree 0", _write_garden),
    "cameras.json": ("six cameras around its table", _write_cameras),
    "sunflower.onnx": ("a generator with inputs time and pose", _write_sunflower),
    "nods.npy": ("a motion of the sunflower: 48 poses", write_nods),
    "wall.obj": ("a mesh with vertex colours", _write_mesh),
    "scene.json": ("a scene of the garden and the sunflower", _write_scene),
}
"""Name → description and writer of each sample file."""


def write_samples(folder: Path, *, force: bool = False) -> list[Path]:
    """Write every sample file into ``folder``, and return the paths of the files.

    Args:
        folder: The folder; a file of the same content stays as it is.
        force: Replace files of the same name and other content.

    Raises:
        ConfigInvalid: A file cannot be written there, or one of other content would be overwritten.
    """
    with temporary_folder() as draft_folder:
        for name, (_, write) in SAMPLE_WRITERS.items():
            write(draft_folder / name)
        if not force:
            _refuse_other_content(folder, draft_folder)
        for name in SAMPLE_WRITERS:
            with atomic_write(folder / name) as draft:
                copyfile(draft_folder / name, draft)
    return [folder / name for name in SAMPLE_WRITERS]


def _refuse_other_content(folder: Path, draft_folder: Path) -> None:
    """Raise if the folder has files with the names of samples but other bytes than ``draft_folder``."""
    unexpected_files = [
        name
        for name in SAMPLE_WRITERS
        if (folder / name).is_file() and not cmp(folder / name, draft_folder / name, shallow=False)
    ]
    if unexpected_files:
        raise ConfigInvalid(
            f"{', '.join(unexpected_files)} of other content would be overwritten",
            where=str(folder),
            hint="Name another folder, or replace them with --force.",
        )
