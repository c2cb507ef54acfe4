"""What Duplex-GS gives its rasteriser for the example checkpoint, and the pictures that this makes."""

import numpy as np

from gsgen.contract.spec.geometry import covariance_upper
from gsgen.contract.spec.manifest import WeightedSum
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from support.commands import shared

BACKDROP = (0.1, 0.2, 0.3, 1.0)
NEAR = 0.2


def golden_view(number: int) -> tuple[Camera, np.ndarray]:
    """One of the two cameras, and its picture over :data:`BACKDROP`."""
    with np.load(shared("data/checkpoints/duplex_a/golden.npz")) as held:
        view, image = held["in_world_view_transform"][number].T, held[f"img{number}"]
        (width, height), field = held["in_size"][number], held["in_FoV"][number]
    focal = np.array([width, height]) / 2 / np.tan(field.astype(np.float64) / 2)
    middle = (float(width) / 2, float(height) / 2)
    seen_by = Camera(view, *focal.tolist(), *middle, int(width), int(height), near=NEAR)
    return seen_by, image.transpose(1, 2, 0)


def golden_scene(number: int) -> Scene:
    """What the method's own Python gives its rasteriser for that camera."""
    with np.load(shared("data/checkpoints/duplex_a/golden.npz")) as held:
        own = {
            name.removeprefix(f"out{number}_"): held[name]
            for name in held.files
            if name.startswith((f"out{number}_", "meta_"))
        }
    rows = [own["means3D"], np.maximum(own["opacities"], 0), own["cov6"]]
    turn = own["anchor_rotations"].astype(np.float64)
    turn[~turn.any(axis=1)] = 1, 0, 0, 0  # cells whose Gaussians are all inert
    ellipsoid = covariance_upper(own["anchor_scales"].astype(np.float64), turn)
    cells = [own["anchor_means3D"], own["vi"][::5], ellipsoid]
    data = SplatData(
        np.concatenate(rows, axis=1).astype(np.float32),
        own["colors_precomp"],
        "rgb",
        cells=np.concatenate(cells, axis=1).astype(np.float32),
        per_cell=5,
    )
    weighted = WeightedSum(
        background=float(own["meta_wbg"][0]),
        depth_range=float(own["meta_sigma"][0]),
        opacity_divisor=float(own["meta_ET"]),
    )
    return Scene([SplatSet(data, weighted=weighted)])
