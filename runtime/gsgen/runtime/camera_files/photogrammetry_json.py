"""Reads the cameras of two photogrammetry programs that write JSON: OpenSfM and openMVG.

1. OpenSfM, ``reconstruction.json``: ``rotation`` (axis-angle) and ``translation`` map world →
   camera, in the axes of ``Camera``; focal lengths and principal points are fractions of the
   longer side, the latter from the image's middle (OpenSfM's documentation, "Geometric Models").
2. openMVG, ``sfm_data.json``: ``rotation`` maps world → camera, ``center`` is the camera centre;
   intrinsics are in pixels. A view without a pose was not located.

Both have the distortions of OpenCV (openMVG's ``Camera_Pinhole_Brown.hpp``, ``Camera_Pinhole_Fisheye.hpp``).
"""

__all__ = ["is_openmvg", "is_opensfm", "read_openmvg", "read_opensfm"]

import math
from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files.fields import (
    Fields,
    camera_at,
    coefficients,
    distortion_at,
    matrix,
    number,
    pixel_count,
    require_object,
    text,
    unused_fields,
)
from gsgen.runtime.camera_files.file import CameraFile, NamedCamera
from gsgen.runtime.camera_files.poses import view_from_opencv

_LENS_KINDS: Final = {
    "perspective": "pinhole",
    "brown": "pinhole",
    "simple_radial": "pinhole",
    "radial": "pinhole",
    "fisheye": "fisheye",
    "fisheye_opencv": "fisheye",
}
_LENS_COEFFICIENTS: Final = ("k1", "k2", "k3", "k4", "p1", "p2")
_OPENMVG_DISTORTIONS: Final = {
    "disto_k1": ("k1",),
    "disto_k3": ("k1", "k2", "k3"),
    "disto_t2": ("k1", "k2", "k3", "p1", "p2"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
_SPHERICAL_TYPES: Final = ("spherical", "equirectangular")
_PRINCIPAL_POINT_FIELDS: Final = {"c_x", "c_y"}


def is_opensfm(document: object) -> bool:
    """Return whether a JSON document is a reconstruction.json of OpenSfM."""
    first = document[0] if isinstance(document, list) and document else None
    return isinstance(first, dict) and {"cameras", "shots"} <= first.keys()


def read_opensfm(document: list[Any], path: str) -> CameraFile:
    """Read the shots of the first reconstruction of OpenSfM; others have coordinates of their own."""
    reconstruction = require_object(document[0], path)
    lenses = {
        name: Fields(require_object(lens, f"{path}, camera {name!r}"))
        for name, lens in require_object(reconstruction["cameras"], path).items()
    }
    shots = {
        name: Fields(require_object(shot, f"{path}, shot {name!r}"))
        for name, shot in require_object(reconstruction["shots"], path).items()
    }
    if not shots:
        raise ConfigInvalid("has no shots, expected at least one", where=path)
    cameras = []
    for name, shot in shots.items():
        where = f"{path}, shot {name!r}"
        lens = lenses.get(text(shot, "camera", ""))
        if lens is None:
            raise ConfigInvalid(
                f"refers to camera {shot.get('camera')!r}, expected one of {sorted(lenses)[:8]}",
                where=where,
            )
        cameras.append(NamedCamera(name, _shot_camera(shot, lens, where)))
    notes = unused_fields(path, [*lenses.values(), *shots.values()])
    if len(document) > 1:
        notes += (
            f"{path}: the first of {len(document)} reconstructions is used; each has "
            "coordinates of its own",
        )
    return CameraFile(
        path=path, format="reconstruction.json of OpenSfM", cameras=tuple(cameras), notes=notes
    )


def _shot_camera(shot: Fields, lens: Fields, where: str) -> Any:
    width, height = pixel_count(lens, "width", where), pixel_count(lens, "height", where)
    longer_side = max(width, height)
    kind = text(lens, "projection_type", "perspective")
    values: dict[str, Any] = {}
    view = np.eye(4)
    view[:3, :3] = _axis_angle_matrix(matrix(shot, "rotation", (3,), where))
    view[:3, 3] = matrix(shot, "translation", (3,), where)
    if kind in _SPHERICAL_TYPES:
        values |= {"fx": width / (2 * math.pi), "fy": height / math.pi, "kind": "panorama"}
    elif kind in _LENS_KINDS:
        names = ("focal", "focal") if "focal" in lens else ("focal_x", "focal_y")
        fx, fy = (number(lens, name, where) * longer_side for name in names)
        lens_coefficients = coefficients(lens, _LENS_COEFFICIENTS, where)
        values = {"fx": fx, "fy": fy, "kind": _LENS_KINDS[kind]}
        values["distortion"] = distortion_at(where, lens_coefficients)
    else:
        raise _unsupported_lens(kind, (*_LENS_KINDS, *_SPHERICAL_TYPES), where)
    cx, cy = (
        number(lens, name, where) * longer_side if name in lens else 0.0
        for name in sorted(_PRINCIPAL_POINT_FIELDS)
    )
    size: dict[str, Any] = {"width": width, "height": height}
    return camera_at(where, view=view, cx=width / 2 + cx, cy=height / 2 + cy, **values, **size)


def _axis_angle_matrix(vector: np.ndarray) -> np.ndarray:
    """Return the matrix [3, 3] of an axis times an angle in radians (Rodrigues' formula)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    cross_matrix = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(
        np.eye(3)
        + math.sin(angle) * cross_matrix
        + (1 - math.cos(angle)) * cross_matrix @ cross_matrix
    )


def is_openmvg(document: object) -> bool:
    """Return whether a JSON document is an sfm_data.json of openMVG."""
    return isinstance(document, dict) and {"views", "intrinsics", "extrinsics"} <= document.keys()


def read_openmvg(document: Mapping[str, Any], path: str) -> CameraFile:
    """Read the located views of an sfm_data.json of openMVG."""
    lenses = {key: Fields(lens) for key, lens in _records(document["intrinsics"], path)}
    poses = {key: Fields(pose) for key, pose in _records(document["extrinsics"], path)}
    views = [Fields(view) for _, view in _records(document["views"], path)]
    cameras = []
    for index, view in enumerate(views):
        where = f"{path}, view {index}"
        pose, lens = poses.get(view.get("id_pose")), lenses.get(view.get("id_intrinsic"))
        name = text(view, "filename", str(index))
        if pose is not None and lens is not None:
            cameras.append(NamedCamera(name, _view_camera(pose, lens, where)))
    if not cameras:
        raise ConfigInvalid(
            f"has {len(views)} views, none of them with a pose and intrinsics, expected at least one",
            where=path,
        )
    notes = unused_fields(path, lenses.values())
    if len(cameras) < len(views):
        notes += (f"{path}: {len(views) - len(cameras)} of {len(views)} views have no pose",)
    return CameraFile(
        path=path, format="sfm_data.json of openMVG", cameras=tuple(cameras), notes=notes
    )


def _view_camera(pose: Fields, lens: Fields, where: str) -> Any:
    axes = matrix(pose, "rotation", (3, 3), where)
    view = view_from_opencv(axes.T, matrix(pose, "center", (3,), where))
    if "focal_length" not in lens:
        raise _unsupported_lens("spherical", ("pinhole", "fisheye"), where)
    values = dict[str, float]()
    for field, names in _OPENMVG_DISTORTIONS.items():
        if field in lens:
            values |= zip(names, matrix(lens, field, (len(names),), where).tolist(), strict=True)
    cx, cy = matrix(lens, "principal_point", (2,), where).tolist()
    focal = number(lens, "focal_length", where)
    width, height = pixel_count(lens, "width", where), pixel_count(lens, "height", where)
    return camera_at(
        where,
        view=view,
        fx=focal,
        fy=focal,
        cx=cx,
        cy=cy,
        width=width,
        height=height,
        kind="fisheye" if "fisheye" in lens else "pinhole",
        distortion=distortion_at(where, values),
    )


def _records(entries: object, path: str) -> Iterable[tuple[object, dict[str, Any]]]:
    """Yield key and fields of each record in a list that the library cereal wrote."""
    if not isinstance(entries, list):
        raise ConfigInvalid(f"has {str(entries)[:60]!r}, expected a list of records", where=path)
    for entry in entries:
        record = require_object(entry, path)
        fields = require_object(record.get("value"), path)
        while isinstance(inner := fields.get("ptr_wrapper", fields.get("data")), dict):
            fields = inner
        yield record.get("key"), fields


def _unsupported_lens(kind: str, supported_types: tuple[str, ...], where: str) -> ConfigInvalid:
    return ConfigInvalid(
        f"has a camera of type {kind}, expected one of {', '.join(supported_types)}",
        where=where,
        hint="Undistort the pictures first, and give the cameras of the undistorted pictures.",
    )
