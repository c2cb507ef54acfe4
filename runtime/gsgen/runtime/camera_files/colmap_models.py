"""The camera models of COLMAP: which of their parameters a pinhole has."""

__all__ = ["MODELS", "NAMES", "PINHOLES", "parameters"]

from typing import Final

from gsgen.contract.errors import ConfigInvalid

MODELS: Final = {
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
"""Names of the parameters, in their order; the order of the models is that of their numbers."""

NAMES: Final = tuple(MODELS)
PINHOLES: Final = ("SIMPLE_PINHOLE", "PINHOLE")


def parameters(
    model: str, values: tuple[float, ...], where: str
) -> tuple[float, float, float, float, tuple[float, ...]]:
    """Return fx, fy, cx, cy, and what bends.

    Raises:
        ConfigInvalid: The model is unknown, a fisheye, or has another number of parameters.
    """
    if model not in MODELS or "FISHEYE" in model or model == "FOV":
        raise ConfigInvalid(
            f"has the camera model {model}, which no pinhole can stand for",
            where=where,
            hint="COLMAP's image_undistorter makes pinholes of it.",
        )
    names = MODELS[model].split()
    if len(values) != len(names):
        raise ConfigInvalid(
            f"{model} has {len(values)} parameters, wanted {len(names)}: {MODELS[model]}",
            where=where,
        )
    held = dict(zip(names, values, strict=True))
    fx = held.get("fx", held.get("f", 0.0))
    fy = held.get("fy", held.get("f", 0.0))
    bending = tuple(held[one] for one in names if one not in ("f", "fx", "fy", "cx", "cy"))
    return fx, fy, held["cx"], held["cy"], bending
