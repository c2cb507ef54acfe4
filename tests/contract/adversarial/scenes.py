"""Scenes of several kinds as arrays, before they are packed."""

__all__ = ["KINDS", "Scene", "rows", "scene", "sh_columns", "upper_triangle"]

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

Array = np.ndarray

KINDS = ("surface", "hair", "cloud", "room", "avatar")
C0 = 0.28209479177387814


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """N Gaussians as a training program holds them, after activations.

    Attributes:
        position: Centres.
        opacity: In [0, 1].
        scale: Standard deviations.
        rotation: Unit quaternions (w, x, y, z).
        sh: Coefficients up to degree 3, coefficient-major.
        joint: The joint that each Gaussian hangs on; 0 but for avatars.
    """

    position: Float[Array, "n 3"]
    opacity: Float[Array, " n"]
    scale: Float[Array, "n 3"]
    rotation: Float[Array, "n 4"]
    sh: Float[Array, "n 16 3"]
    joint: Int[Array, " n"]

    @property
    def rgb(self) -> Float[Array, "n 3"]:
        """The colour without its view-dependent part, in [0, 1]."""
        return np.clip(0.5 + C0 * self.sh[:, 0], 0, 1)

    @property
    def count(self) -> int:
        """N."""
        return len(self.position)


# Where the joints of an avatar turn: pelvis, neck, left and right shoulder.
PIVOTS = np.array([[0, 0, 0], [0, -0.5, 0], [0.2, -0.4, 0], [-0.2, -0.4, 0]], np.float64)


def scene(kind: str, statistics: str = "trained", seed: int = 0, n: int = 64) -> Scene:
    """Return a scene of N = ``n`` Gaussians.

    Args:
        kind: One of :data:`KINDS`.
        statistics: ``trained``: scattered as training leaves them. ``synthetic``: regular.
        seed: Of the scatter.
        n: How many Gaussians.
    """
    random = np.random.default_rng([seed, KINDS.index(kind)])
    position, axes, scale, joint = _SHAPES[kind](n, random)
    rotation = _quaternions(axes)
    if statistics == "trained":
        scale = scale * np.exp(random.normal(0, 0.25, scale.shape))
        opacity = 1 / (1 + np.exp(-random.normal(1.6, 1.8, n)))
        wobble = Rotation.from_rotvec(random.normal(0, 0.08, (n, 3)))
        rotation = _wxyz(wobble * Rotation.from_quat(rotation[:, [1, 2, 3, 0]]))
    else:
        opacity = np.full(n, 0.9)
    return Scene(
        position=position,
        opacity=np.clip(opacity, 0.02, 0.99),
        scale=scale,
        rotation=rotation,
        sh=_harmonics(position, statistics, random),
        joint=joint,
    )


def upper_triangle(
    scale: Float[Array, "n 3"], rotation: Float[Array, "n 4"]
) -> Float[Array, "n 6"]:
    """Return xx xy xz yy yz zz of Σ = R S Sᵀ Rᵀ; quaternions are (w, x, y, z)."""
    turn = Rotation.from_quat(rotation[:, [1, 2, 3, 0]]).as_matrix()
    sigma = np.einsum("nij,nj,nkj->nik", turn, scale**2, turn)
    return sigma.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]]


def rows(source: Scene) -> Float[Array, "n 10"]:
    """Return the packed rows of a scene, in float64."""
    sigma = upper_triangle(source.scale, source.rotation)
    return np.concatenate([source.position, source.opacity[:, None], sigma], axis=1)


def sh_columns(source: Scene, degree: int) -> Float[Array, "n c"]:
    """Return coefficients up to ``degree`` as an appearance row holds them."""
    return source.sh[:, : (degree + 1) ** 2].reshape(source.count, -1)


def _harmonics(position: Array, statistics: str, random: np.random.Generator) -> Array:
    """Return smooth colours whose view-dependent part fades with the degree."""
    n = len(position)
    span = max(np.ptp(position, axis=0).max(), 1e-3)
    phase = np.array([0.0, 1.3, 2.1])
    waves = np.sin(
        3 * position @ np.array([[1, 0.4, -0.7], [0.3, 1, 0.2], [-0.5, 0.6, 1]]) / span + phase
    )
    sh = np.zeros((n, 16, 3))
    sh[:, 0] = 1.1 * waves
    if statistics == "trained":
        sh[:, 0] += random.normal(0, 0.15, (n, 3))
        deviation = np.repeat([0, 0.12, 0.06, 0.03], [1, 3, 5, 7])[None, :, None]
        grey = random.normal(size=(n, 16, 1))
        sh += deviation * (grey + 0.25 * random.normal(size=(n, 16, 3)))
    else:
        sh[:, 1:4] += 0.1 * waves[:, None]
    return sh


def _wxyz(rotation: Rotation) -> Array:
    return rotation.as_quat()[:, [3, 0, 1, 2]]


def _quaternions(axes: Array) -> Array:
    """Return (w, x, y, z) of rotations whose third column is ``axes``."""
    third = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    helper = np.where(np.abs(third[:, :1]) < 0.8, [[1.0, 0, 0]], [[0, 1.0, 0]])
    first = np.cross(helper, third)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(third, first)
    return _wxyz(Rotation.from_matrix(np.stack([first, second, third], axis=2)))


def _sphere(n: int) -> Array:
    k = np.arange(n) + 0.5
    polar, azimuth = np.arccos(1 - 2 * k / n), np.pi * (1 + 5**0.5) * k
    return np.stack(
        [np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], 1
    )


def _surface(n: int, random: np.random.Generator) -> tuple[Array, ...]:
    normal = _sphere(n)
    radii = np.array([1.2, 0.9, 1.0])
    scale = np.tile([0.17, 0.14, 0.012], (n, 1))
    normals = normal / radii
    return normal * radii + [0.3, -0.1, 0.2], normals, scale, np.zeros(n, int)


def _hair(n: int, random: np.random.Generator) -> tuple[Array, ...]:
    strands = max(1, n // 8)
    roots = _sphere(2 * strands)[:strands] * 0.3
    index = np.arange(n)
    root = roots[index % strands]
    along = (index // strands + 0.5) / np.ceil(n / strands)
    fall = np.stack([np.zeros(n), along**2, np.zeros(n)], 1)
    position = root * (1 + along[:, None]) + 0.5 * fall
    tangent = root + fall / np.maximum(along, 1e-3)[:, None]
    return position, tangent, np.tile([0.004, 0.004, 0.045], (n, 1)), np.zeros(n, int)


def _cloud(n: int, random: np.random.Generator) -> tuple[Array, ...]:
    position = random.normal(0, 0.8, (n, 3))
    return (
        position,
        random.normal(size=(n, 3)),
        random.uniform(0.1, 0.25, (n, 3)),
        np.zeros(n, int),
    )


def _room(n: int, random: np.random.Generator) -> tuple[Array, ...]:
    wall = np.arange(n) % 6
    axis, side = wall % 3, np.where(wall < 3, -1.0, 1.0)
    half = np.array([2.0, 1.3, 2.5])
    position = random.uniform(-1, 1, (n, 3)) * half
    position[np.arange(n), axis] = side * half[axis]
    normal = np.zeros((n, 3))
    normal[np.arange(n), axis] = -side
    return position, normal, np.tile([0.4, 0.3, 0.02], (n, 1)), np.zeros(n, int)


def _avatar(n: int, random: np.random.Generator) -> tuple[Array, ...]:
    joint = np.arange(n) % 4
    start = np.array([[0, 0.3, 0], [0, -0.55, 0], [0.2, -0.4, 0], [-0.2, -0.4, 0]])[joint]
    end = np.array([[0, -0.45, 0], [0, -0.75, 0], [0.75, -0.4, 0], [-0.75, -0.4, 0]])[joint]
    radius = np.array([0.17, 0.11, 0.06, 0.06])[joint]
    share = ((np.arange(n) // 4 + 0.5) / np.ceil(n / 4))[:, None]
    angle = 2.4 * (np.arange(n) // 4)
    upright = joint < 2
    ring = np.stack([np.cos(angle), np.sin(angle)], 1)
    normal = np.zeros((n, 3))
    normal[:, 2] = ring[:, 1]
    normal[upright, 0] = ring[upright, 0]
    normal[~upright, 1] = ring[~upright, 0]
    position = start + share * (end - start) + radius[:, None] * normal
    return position, normal, np.tile([0.06, 0.05, 0.008], (n, 1)), joint


_SHAPES = {"surface": _surface, "hair": _hair, "cloud": _cloud, "room": _room, "avatar": _avatar}
