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
    with np.load(shared("data/checkpoints/duplex_a/golden.npz")) as archive:
        view, image = archive["in_world_view_transform"][number].T, archive[f"img{number}"]
        (width, height), field = archive["in_size"][number], archive["in_FoV"][number]
    focal = np.array([width, height]) / 2 / np.tan(field.astype(np.float64) / 2)
    fx, fy = focal.tolist()
    view_camera = Camera(
        view,
        fx=fx,
        fy=fy,
        cx=float(width) / 2,
        cy=float(height) / 2,
        width=int(width),
        height=int(height),
        near=NEAR,
    )
    return view_camera, image.transpose(1, 2, 0)


def golden_scene(number: int) -> Scene:
    """What the method's own Python gives its rasteriser for that camera."""
    with np.load(shared("data/checkpoints/duplex_a/golden.npz")) as archive:
        camera = {
            name.removeprefix(f"out{number}_"): archive[name]
            for name in archive.files
            if name.startswith((f"out{number}_", "meta_"))
        }
    rows = [camera["means3D"], np.maximum(camera["opacities"], 0), camera["cov6"]]
    turn = camera["anchor_rotations"].astype(np.float64)
    turn[~turn.any(axis=1)] = 1, 0, 0, 0  # cells whose Gaussians are all inert
    ellipsoid = covariance_upper(camera["anchor_scales"].astype(np.float64), turn)
    cells = [camera["anchor_means3D"], camera["vi"][::5], ellipsoid]
    data = SplatData(
        np.concatenate(rows, axis=1).astype(np.float32),
        camera["colors_precomp"],
        "rgb",
        cells=np.concatenate(cells, axis=1).astype(np.float32),
        per_cell=5,
    )
    weighted = WeightedSum(
        background=float(camera["meta_wbg"][0]),
        depth_range=float(camera["meta_sigma"][0]),
        opacity_divisor=float(camera["meta_ET"]),
    )
    return Scene([SplatSet(data, weighted=weighted)])
