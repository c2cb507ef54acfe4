"""The projections that kernels are specialised for, as constants of shaders."""

__all__ = ["Projection", "projection_constants", "projection_of"]

from typing import Literal

from gsgen.runtime.scene.camera import Camera

Projection = Literal["plane", "distorted", "fisheye", "panorama"]
"""Where splats are projected to: a plane, also through a distorted lens; a panorama draws a splat up
to three times, around its seam."""


def projection_of(camera: Camera) -> Projection:
    """Return the projection of a camera's kernels."""
    if camera.kind == "fisheye" or camera.kind == "panorama":
        return camera.kind
    return "plane" if camera.distortion is None else "distorted"


def projection_constants(projection: Projection) -> dict[str, bool]:
    """Return the constants of shaders that project Gaussians or cells."""
    return {
        "DISTORTED": projection == "distorted",
        "FISHEYE": projection == "fisheye",
        "PANORAMA": projection == "panorama",
    }
