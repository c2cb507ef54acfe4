"""COLMAP's camera models with their parameters, and the records of COLMAP's files."""

__all__ = ["CAMERA_MODELS", "MODEL_NAMES", "PINHOLES", "ColmapImage", "ColmapLens", "parameters"]

from dataclasses import dataclass
from typing import Final, final

from gsgen.contract.errors import ConfigInvalid

CAMERA_MODELS: Final = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "FOV": "fx fy cx cy omega",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
    "THIN_PRISM_FISHEYE": "fx fy cx cy k1 k2 p1 p2 k3 k4 sx1 sy1",
}
"""Parameter names of each camera model; the index of a model is its number in binary files."""

MODEL_NAMES: Final = tuple(CAMERA_MODELS)
PINHOLES: Final = ("SIMPLE_PINHOLE", "PINHOLE")


@final
@dataclass(frozen=True, slots=True)
class ColmapLens:
    """A COLMAP camera: the camera model and intrinsics that several images may share."""

    model: str
    width: int
    height: int
    values: tuple[float, ...]


@final
@dataclass(frozen=True, slots=True)
class ColmapImage:
    """The file name and the pose of a COLMAP image, and the number of its camera.

    The pose is world → camera; the quaternion is w, x, y, z, of any length but 0.
    """

    name: str
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]
    lens: int


def parameters(
    model: str, values: tuple[float, ...], where: str
) -> tuple[float, float, float, float, tuple[float, ...]]:
    """Return fx, fy, cx, cy and the distortion coefficients of a COLMAP camera model."""
    if model not in CAMERA_MODELS or "FISHEYE" in model or model == "FOV":
        raise ConfigInvalid(
            f"the camera model is {model}, expected one that a pinhole approximates",
            where=where,
            hint="COLMAP's image_undistorter converts images to pinhole cameras.",
        )
    names = CAMERA_MODELS[model].split()
    if len(values) != len(names):
        raise ConfigInvalid(
            f"{model} has {len(values)} parameters, expected {len(names)}: {CAMERA_MODELS[model]}",
            where=where,
        )
    by_name = dict(zip(names, values, strict=True))
    fx = by_name.get("fx", by_name.get("f", 0.0))
    fy = by_name.get("fy", by_name.get("f", 0.0))
    distortion = tuple(by_name[name] for name in names if name not in ("f", "fx", "fy", "cx", "cy"))
    return fx, fy, by_name["cx"], by_name["cy"], distortion
