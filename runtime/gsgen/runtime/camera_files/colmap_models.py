"""COLMAP's camera models with their parameters, and the records of COLMAP's files."""

__all__ = [
    "CAMERA_MODELS",
    "MODEL_NAMES",
    "ColmapImage",
    "ColmapLens",
    "intrinsics",
    "unsupported_model",
]

from dataclasses import dataclass
from typing import Any, Final, final

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files.fields import distortion_at

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
    "RAD_TAN_THIN_PRISM_FISHEYE": "fx fy cx cy k0 k1 k2 k3 k4 k5 p0 p1 s0 s1 s2 s3",
    "SIMPLE_DIVISION": "f cx cy k",
    "DIVISION": "fx fy cx cy k",
    "SIMPLE_FISHEYE": "f cx cy",
    "FISHEYE": "fx fy cx cy",
    "EUCM": "fx fy cx cy alpha beta",
}
"""Parameter names of each camera model that is a lens in front of a plane."""

MODEL_NAMES: Final = (*CAMERA_MODELS, "EQUIRECTANGULAR")
"""The names of all camera models, in the order of their numbers in binary files."""
_NOT_DRAWN: Final = ("FOV", "RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION", "DIVISION", "EUCM")
_OPENCV_NAMES: Final = {"k": "k1", "sx1": "s1", "sy1": "s2"}


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


def unsupported_model(model: str, where: str) -> ConfigInvalid:
    """Return the error for a camera model of COLMAP that the renderer does not draw."""
    drawn_models = [name for name in CAMERA_MODELS if name not in _NOT_DRAWN]
    return ConfigInvalid(
        f"the camera model is {model}, expected one of {', '.join(drawn_models)}",
        where=where,
        hint="COLMAP's image_undistorter converts images to pinhole cameras.",
    )


def intrinsics(model: str, values: tuple[float, ...], where: str) -> dict[str, Any]:
    """Return the attributes of ``Camera`` that a COLMAP camera model and its parameters determine."""
    if model not in CAMERA_MODELS or model in _NOT_DRAWN:
        raise unsupported_model(model, where)
    names = CAMERA_MODELS[model].split()
    if len(values) != len(names):
        raise ConfigInvalid(
            f"{model} has {len(values)} parameters, expected {len(names)}: {CAMERA_MODELS[model]}",
            where=where,
        )
    by_name = {
        _OPENCV_NAMES.get(name, name): value for name, value in zip(names, values, strict=True)
    }
    focal = by_name.get("f", 0.0)
    return {
        "fx": by_name.get("fx", focal),
        "fy": by_name.get("fy", focal),
        "cx": by_name["cx"],
        "cy": by_name["cy"],
        "kind": "fisheye" if "FISHEYE" in model else "pinhole",
        "distortion": distortion_at(where, by_name, is_rational=model == "FULL_OPENCV"),
    }
