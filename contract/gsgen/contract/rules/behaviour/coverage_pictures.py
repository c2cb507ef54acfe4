"""Draws how opaque a picture of packed rows is, and how deep: coarse, and without colours."""

__all__ = ["Lens", "Projected", "draw_coverage", "lens_of_probe", "project", "view_of_probe"]

from typing import NamedTuple

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.probing.probes import Probe, SceneExtent, as_tensor
from gsgen.contract.spec.geometry import look_at, perspective, symmetric
from gsgen.contract.spec.layout import COVARIANCE, OPACITY, POSITION
from gsgen.contract.spec.manifest import GeneratorManifest

# Pixels along each side of a picture; its corners are those of the view, in any shape.
_SIDE = 24
# Splats are widened by this variance, in pixels², so that none falls between pixels.
_BLUR = 0.3
# Rows drawn at a time, and the cosine of directions that count as along the vertical.
_BLOCK_ROWS = 256
# The lens of a model without a projection matrix: 60° wide, 16 : 9 without a viewport.
_FIELD_OF_VIEW, _ASPECT = np.deg2rad(60.0), 16 / 9
# Rows nearer than this share of their distance to the middle of the scene are behind the lens.
_NEAR = 0.02


class Lens(NamedTuple):
    """The parts of a projection matrix that place rows in the picture.

    Attributes:
        x: Half widths of the picture at distance 1, inverted.
        y: Half heights, inverted.
    """

    x: float
    y: float


class Projected(NamedTuple):
    """Rows in front of a camera: their indices, places in the picture, −1 to 1, and depths."""

    indices: np.ndarray
    place: Float[np.ndarray, "n 2"]
    depth: Float[np.ndarray, " n"]


def view_of_probe(manifest: GeneratorManifest, probe: Probe) -> Float[np.ndarray, "4 4"] | None:
    """Return the world→camera matrix of a probe; None if the model takes no camera.

    A model that takes the camera's centre alone is looked at towards the middle of the scene.
    """
    order = manifest.space.matrix_order if manifest.space else "column"
    for entry in manifest.inputs:
        if entry.role == "view":
            return as_tensor(probe.inputs[entry.name], order).astype(np.float64)
    for entry in manifest.inputs:
        if entry.role == "camera_position":
            scene, eye = SceneExtent.from_manifest(manifest), probe.inputs[entry.name].reshape(-1)
            is_middle = np.linalg.norm(eye - scene.center) < _NEAR * scene.radius
            target = eye + np.roll(scene.up, 1) if is_middle else scene.center
            return look_at(eye.astype(np.float64), target, scene.up)
    return None


def lens_of_probe(manifest: GeneratorManifest, probe: Probe) -> Lens:
    """Return the lens of a probe: its projection matrix, or 60° and the aspect of its viewport."""
    order = manifest.space.matrix_order if manifest.space else "column"
    roles = {entry.role: probe.inputs[entry.name] for entry in manifest.inputs}
    aspect = _ASPECT
    if "viewport" in roles:
        width, height = roles["viewport"].reshape(-1)
        aspect = float(width) / max(float(height), 1.0)
    matrix = perspective(_FIELD_OF_VIEW, aspect, 0.01, 1000.0)
    if "projection" in roles:
        matrix = as_tensor(roles["projection"], order).astype(np.float64)
    return Lens(abs(float(matrix[0, 0])), abs(float(matrix[1, 1])))


def project(
    rows: Float[np.ndarray, "n 10"], view: Float[np.ndarray, "4 4"], lens: Lens, near: float
) -> Projected:
    """Return where the centres of rows are in a picture; only of rows beyond a near plane."""
    x, y, z = (rows[:, POSITION] @ view[:3, :3].T + view[:3, 3]).T
    indices = np.flatnonzero(z > near)
    depth = z[indices]
    place = np.stack([lens.x * x[indices] / depth, lens.y * y[indices] / depth], axis=1)
    return Projected(indices, place, depth)


def draw_coverage(
    rows: Float[np.ndarray, "n 10"], view: Float[np.ndarray, "4 4"], lens: Lens, near: float
) -> tuple[Float[np.ndarray, "s s"], Float[np.ndarray, "s s"]]:
    """Draw rows by alpha blending; return the opacity and the mean depth of each pixel.

    Covariances are projected by the local affine approximation (Zwicker et al. 2001, EWA splatting).

    Args:
        rows: Packed rows, float64.
        view: World→camera matrix.
        lens: The lens.
        near: Rows nearer to the camera's plane are left out.
    """
    indices, place, depth = project(rows, view, lens, near)
    order = np.argsort(depth, kind="stable")
    packed, place, depth = rows[indices[order]], place[order], depth[order]
    # The Jacobian of the projection times the camera's rotation, [n, 2, 3].
    jacobian = np.zeros((len(packed), 2, 3))
    jacobian[:, 0, 0], jacobian[:, 1, 1] = lens.x / depth, lens.y / depth
    jacobian[:, :, 2] = -np.clip(place, -1.3, 1.3) / depth[:, None]
    jacobian = jacobian @ view[:3, :3]
    spread = jacobian @ symmetric(packed[:, COVARIANCE]) @ jacobian.transpose(0, 2, 1)
    sharp = _determinants(spread)
    spread += _BLUR * (2 / _SIDE) ** 2 * np.eye(2)
    determinant = _determinants(spread)
    # What is widened is less opaque by as much, so that small rows cover no more than they do.
    opacity = packed[:, OPACITY] * np.sqrt(sharp / determinant)
    conic = np.stack([spread[:, 1, 1], -spread[:, 0, 1], spread[:, 0, 0]], axis=1)
    conic /= determinant[:, None]
    center = (2 * np.arange(_SIDE, dtype=np.float32) + 1) / _SIDE - 1
    place, conic, opacity, depth = (
        array.astype(np.float32) for array in (place, conic, opacity, depth)
    )
    transmittance = np.ones((1, _SIDE * _SIDE), np.float32)
    coverage, depth_sum = np.zeros((2, _SIDE * _SIDE))
    for start in range(0, len(packed), _BLOCK_ROWS):
        block = slice(start, start + _BLOCK_ROWS)
        dx = center[None, None, :] - place[block, 0, None, None]
        dy = center[None, :, None] - place[block, 1, None, None]
        a, b, c = conic[block, :, None, None].transpose(1, 0, 2, 3)
        # Squares of one axis are taken for its pixels alone, not for all pixels of the picture.
        exponent = (-0.5 * a * dx * dx) + (-0.5 * c * dy * dy) - (b * dx) * dy
        alpha = opacity[block, None] * np.exp(exponent).reshape(len(exponent), -1)
        np.minimum(alpha, 0.99, out=alpha)
        # How much light reaches each row, and what is left behind the last one.
        reaching = np.cumprod(np.concatenate([transmittance, 1 - alpha]), axis=0)
        weight = reaching[:-1] * alpha
        coverage += weight.sum(axis=0)
        depth_sum += depth[block] @ weight
        transmittance = reaching[-1:]
    mean_depth = depth_sum / np.maximum(coverage, 1e-12)
    return coverage.reshape(_SIDE, _SIDE), mean_depth.reshape(_SIDE, _SIDE)


def _determinants(matrices: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, " n"]:
    product = matrices[:, 0, 0] * matrices[:, 1, 1]
    return np.asarray(np.maximum(product - matrices[:, 0, 1] ** 2, 1e-300))
