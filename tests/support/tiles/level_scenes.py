"""Scenes, views and the published ways to thin out splats, for the benchmark of tile levels."""

import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from gsgen.contract.spec.spherical_harmonics import basis
from gsgen.formats import Splats
from gsgen.formats.merging.mixture import surface_area
from gsgen.formats.shared.quantities import logit, rotations, sigmoid
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData

SHARED = Path(os.environ.get("GSGEN_SHARED", "shared"))
C0 = 0.5 / math.sqrt(math.pi)


def knot(count: int = 60_000, degree: int = 3, seed: int = 0) -> Splats:
    """A torus knot (2, 3) of flat splats, textured, with a highlight that moves with the view."""
    rng = np.random.default_rng(seed)
    t, v = rng.uniform(0, 2 * np.pi, (2, count))
    tube = 0.32

    def curve(t):
        ring = 2 + np.cos(3 * t)
        return np.stack([ring * np.cos(2 * t), ring * np.sin(2 * t), np.sin(3 * t)], -1) / 2

    tangent = curve(t + 1e-4) - curve(t - 1e-4)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, [0.3, 0.5, 0.8])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(tangent, side)
    normal = np.cos(v)[:, None] * side + np.sin(v)[:, None] * up
    position = curve(t) + tube * normal
    horizontal = np.cross(normal, tangent)
    frame = np.stack([tangent, horizontal, normal], axis=2)
    spacing = math.sqrt(2 * math.pi * tube * 10 / count)  # of splats on the tube
    scale = spacing * np.exp(rng.normal(0, 0.3, (count, 3))) * [1.3, 1.3, 0.15]
    base = 0.5 + 0.35 * np.stack(
        [np.sin(9 * t), np.sin(3 * v + 5 * t), np.cos(12 * t - 2 * v)], axis=1
    )
    base *= rng.uniform(0.95, 1.05, (count, 1))
    sh = np.zeros((count, (degree + 1) ** 2, 3))
    sh[:, 0] = (base - 0.5) / C0
    if degree:  # a lobe about the mirrored light
        light = np.array([0.5, -0.7, 0.5]) / np.linalg.norm([0.5, -0.7, 0.5])
        mirrored = 2 * (normal @ light)[:, None] * normal - light
        lobe = basis(-mirrored, degree)[:, 1:] * 0.35
        sh[:, 1:] += lobe[:, :, None] * np.array([1, 0.95, 0.8])
    opacity = rng.beta(6, 1.5, count)
    return Splats(
        position=position.astype(np.float32),
        rotation=rotations(frame),
        log_scale=np.log(scale).astype(np.float32),
        logit_opacity=logit(opacity),
        sh=sh.astype(np.float32),
    )


def garden() -> tuple[Splats, np.ndarray, np.ndarray]:
    """The points of a real capture as balls of the distance to their neighbours."""
    with np.load(SHARED / "data" / "garden" / "test_garden.npz") as data:
        points, colors = data["means3d"].astype(np.float32), data["colors"] / 255
        views, k = data["viewmats"].astype(np.float64), data["Ks"].astype(np.float64)
    distance = cKDTree(points).query(points, 4)[0][:, 1:]
    scale = np.sqrt(np.square(distance).mean(axis=1)).clip(1e-4, np.quantile(distance, 0.99))
    count = len(points)
    splats = Splats(
        position=points,
        rotation=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        log_scale=np.repeat(np.log(scale)[:, None], 3, axis=1).astype(np.float32),
        logit_opacity=logit(np.full(count, 0.8)),
        sh=((colors - 0.5) / C0).astype(np.float32)[:, None, :],
    )
    return splats, views, k


@dataclass(frozen=True)
class Judge:
    """Pictures of a scene from near, middle and far, to compare others with."""

    renderer: Renderer
    cameras: dict[str, list[Camera]]
    pictures: dict[str, list[np.ndarray]]

    @classmethod
    def of(cls, renderer: Renderer, splats: Splats, cameras: dict[str, list[Camera]]) -> "Judge":
        pictures = {
            name: [picture(renderer, splats, camera) for camera in group]
            for name, group in cameras.items()
        }
        return cls(renderer, cameras, pictures)

    def score(self, splats: Splats) -> dict[str, float]:
        from gsgen.tiles.scoring.ssim import ssim

        return {
            name: float(
                np.mean(
                    [
                        ssim(picture(self.renderer, splats, camera), expected)
                        for camera, expected in zip(group, self.pictures[name], strict=True)
                    ]
                )
            )
            for name, group in self.cameras.items()
        }


def picture(renderer: Renderer, splats: Splats, camera: Camera) -> np.ndarray:
    frame = renderer.render(Scene([SplatData.from_splats(splats)]), camera, background=(0, 0, 0, 1))
    assert frame.rgba is not None
    return np.clip(frame.rgba[..., :3], 0, 1)


def knot_cameras(size: tuple[int, int] = (320, 240), views: int = 3) -> dict[str, list[Camera]]:
    """Cameras around the knot: it fills the picture, two thirds of it, a third."""
    cameras: dict[str, list[Camera]] = {}
    for name, distance in (("near", 3.6), ("middle", 6.0), ("far", 10.0)):
        cameras[name] = []
        for index in range(views):
            angle = 2 * np.pi * index / views + 0.4
            eye = distance * np.array([np.cos(angle), -0.45, np.sin(angle)]) / 1.1
            cameras[name].append(
                Camera.look_at(tuple(eye), (0.0, 0.0, 0.0), fov_y=50, width=size[0], height=size[1])
            )
    return cameras


def garden_cameras(splats: Splats, views: np.ndarray, k: np.ndarray) -> dict[str, list[Camera]]:
    """The cameras of the capture at half its size, then 1.5 and 4 depths of the scene behind."""
    cameras: dict[str, list[Camera]] = {}
    for name, back in (("near", 0.0), ("middle", 1.5), ("far", 4.0)):
        cameras[name] = []
        for view, inner in zip(views, k, strict=True):
            moved = view.copy()
            depth = (view[:3, :3] @ splats.position.T.astype(np.float64) + view[:3, 3:])[2]
            moved[2, 3] += back * np.median(depth)
            fx, fy, cx, cy = inner[0, 0], inner[1, 1], inner[0, 2], inner[1, 2]
            camera = Camera(
                moved, fx=fx / 2, fy=fy / 2, cx=cx / 2, cy=cy / 2, width=324, height=210
            )
            cameras[name].append(camera)
    return cameras


def in_cells(splats: Splats, side: float) -> tuple[Splats, np.ndarray]:
    """Return splats sorted by cells of a lattice, and the first row of each cell."""
    cells = np.floor(splats.position.astype(np.float64) / side).astype(np.int64)
    order = np.lexsort(cells.T)
    cells = cells[order]
    new = np.concatenate([[True], (cells[1:] != cells[:-1]).any(axis=1)])
    return _rows(splats, order), np.flatnonzero(new)


def _rows(splats: Splats, index: np.ndarray) -> Splats:
    names = ("position", "rotation", "log_scale", "logit_opacity", "sh")
    return Splats(**{name: getattr(splats, name)[index] for name in names})


def random_grown(splats: Splats, count: int, seed: int = 1) -> Splats:
    """Some splats at random, grown so that their surfaces add up to those of all."""
    index = np.sort(np.random.default_rng(seed).permutation(len(splats))[:count])
    return _grown(splats, index, math.sqrt(len(splats) / count))


def largest(splats: Splats, count: int) -> Splats:
    """The splats with the greatest opacity times surface."""
    mass = sigmoid(splats.logit_opacity) * surface_area(np.exp(splats.log_scale))
    return _grown(splats, np.sort(np.argsort(-mass, kind="stable")[:count]), 1.0)


def _grown(splats: Splats, index: np.ndarray, factor: float) -> Splats:
    return Splats(
        position=splats.position[index],
        rotation=splats.rotation[index],
        log_scale=splats.log_scale[index] + np.float32(math.log(factor)),
        logit_opacity=splats.logit_opacity[index],
        sh=splats.sh[index],
    )


def tilesplat(splats: Splats, starts: np.ndarray) -> Splats:
    """Merge runs of splats by equation 2 of TileSplat.

    Centres and colours are means weighted by opacity, the rotation is Markley's mean, the scale
    half of the box of all μ ± s, the opacity Σα²/Σα.
    """
    alpha = np.maximum(sigmoid(splats.logit_opacity).astype(np.float64), 1e-9)
    total = np.add.reduceat(alpha, starts)
    scale = np.exp(splats.log_scale.astype(np.float64))

    def mean(values):
        return np.add.reduceat(alpha[:, None] * values, starts) / total[:, None]

    rotated_axes = splats.rotation[:, :, None].astype(np.float64) * splats.rotation[:, None, :]
    _, vectors = np.linalg.eigh(mean(rotated_axes.reshape(-1, 16)).reshape(-1, 4, 4))
    high = np.maximum.reduceat(splats.position + scale, starts)
    low = np.minimum.reduceat(splats.position - scale, starts)
    opacity = np.add.reduceat(alpha**2, starts) / total
    sh = mean(splats.sh.reshape(len(splats), -1)).reshape(-1, *splats.sh.shape[1:])
    return Splats(
        position=mean(splats.position).astype(np.float32),
        rotation=vectors[:, :, -1].astype(np.float32),
        log_scale=np.log((high - low) / 2).astype(np.float32),
        logit_opacity=logit(np.minimum(opacity, 0.999999)),
        sh=sh.astype(np.float32),
    )
