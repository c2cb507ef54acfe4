"""Pinhole, fisheye, orthographic and panoramic cameras in the OpenCV convention, also as JSON."""

__all__ = ["Camera"]

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, fields, replace
from typing import Any, Literal, final, get_args

import numpy as np
from jaxtyping import Float

from gsgen.contract.spec import geometry
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.scene.camera_numbers import (
    require_image_side,
    require_number,
    require_sphere,
    unit_direction,
)
from gsgen.runtime.scene.distortion import Distortion, Points, undistorted_bounds
from gsgen.sdk.binding.camera_inputs import FAR_RATIO, pinhole_projection

DEFAULT_NEAR = 0.01
"""Near plane of a camera without one, in world units."""
DEFAULT_DILATION = 0.3
"""Variance that the pixel filter adds to each projected Gaussian, in pixels² (Kerbl et al. 2023)."""
_ROTATION_TOLERANCE = 1e-3
_UP_DIRECTION = (0.0, -1.0, 0.0)  # +y is down in COLMAP's worlds
_STEEPEST_SLOPE = 1000.0  # of rays that a distorted pinhole draws: 89.94 degrees from its axis
_WIDEST_ANGLE = math.radians(179)  # from a fisheye's axis: behind it is a whole circle of the image

Kind = Literal["pinhole", "fisheye", "orthographic", "panorama"]
"""The projection of a camera."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A camera: +x right, +y down, +z forward; the first pixel's centre is (0.5, 0.5).

    A pinhole projects a point to (fx x/z + cx, fy y/z + cy), an orthographic camera to
    (fx x + cx, fy y + cy): its focal lengths are pixels per world unit. A fisheye projects it to
    (fx θ x/ρ + cx, fy θ y/ρ + cy) with ρ² = x² + y² and the angle θ = atan2(ρ, z) from the axis: its
    focal lengths are pixels per radian. A panorama projects it to
    (fx λ + cx, fy φ + cy) with the longitude λ = atan2(x, z) and, downwards, the latitude
    φ = asin(y/r): its focal lengths are pixels per radian (an equirectangular image). A lens may
    distort the image of a pinhole or a fisheye, before the focal lengths apply.

    Attributes:
        view: World → camera, [4, 4], acting on column vectors; a rotation and a translation.
        fx: Horizontal focal length, in pixels.
        fy: Vertical focal length, in pixels.
        cx: Principal point from the left edge, in pixels.
        cy: Principal point from the upper edge, in pixels.
        width: Image width, in pixels.
        height: Image height, in pixels.
        near: Least distance of drawn Gaussians along +z, in world units; in a fisheye and in a
            panorama the least distance in any direction.
        kind: ``pinhole``, ``fisheye``, ``orthographic`` or ``panorama``.
        dilation: Variance that the pixel filter adds to each projected Gaussian, in pixels². It is
            smaller for pictures that are enlarged later, and not part of a camera file.
        distortion: The lens distortion of a pinhole or a fisheye; None without one. A distortion
            that moves nothing becomes None.

    Raises:
        SceneInvalid: A number is not finite or out of range, or ``view`` is not a rigid transform.
    """

    view: Float[np.ndarray, "4 4"]
    _: KW_ONLY
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    near: float = DEFAULT_NEAR
    kind: Kind = "pinhole"
    dilation: float = DEFAULT_DILATION
    distortion: Distortion | None = None

    def __post_init__(self) -> None:
        view = np.array(self.view, np.float64)
        if view.shape != (4, 4) or not np.isfinite(view).all():
            raise SceneInvalid(
                f"is {view.tolist()}, expected 4 rows of 4 finite numbers", where="camera.view"
            )
        object.__setattr__(self, "view", view)
        for name in ("fx", "fy", "near", "dilation"):
            require_number(name, getattr(self, name), must_be_positive=True)
        for name in ("cx", "cy"):
            require_number(name, getattr(self, name))
        for name in ("width", "height"):
            require_image_side(name, getattr(self, name))
        if self.kind not in get_args(Kind):
            message = f"is {self.kind!r}, expected pinhole, fisheye, orthographic or panorama"
            raise SceneInvalid(message, where="camera.kind")
        if self.distortion is not None and self.kind not in ("pinhole", "fisheye"):
            raise SceneInvalid(
                f"belongs to a camera of kind {self.kind}, expected pinhole or fisheye",
                where="camera.distortion",
            )
        if self.distortion is not None and self.distortion.is_zero:
            object.__setattr__(self, "distortion", None)
        if self.kind == "panorama":
            require_sphere(self.fx, self.fy, self.cy, (self.width, self.height))
        rotation = view[:3, :3]
        with np.errstate(all="ignore"):  # numbers may be so large that they overflow
            orthogonality_error = np.abs(rotation @ rotation.T - np.eye(3)).max()
            is_rotation = orthogonality_error <= _ROTATION_TOLERANCE and np.linalg.det(rotation) > 0
        if not (is_rotation and np.array_equal(view[3], [0, 0, 0, 1])):
            raise SceneInvalid(
                f"is not a rigid transform: {view.tolist()}",
                where="camera.view",
                hint="It maps world to camera and acts on column vectors; its last row is 0 0 0 1.",
            )

    @classmethod
    def look_at(
        cls,
        eye: Sequence[float],
        target: Sequence[float],
        *,
        up: Sequence[float] = _UP_DIRECTION,
        width: int = 1280,
        height: int = 720,
        fov_y: float = 50.0,
        near: float = DEFAULT_NEAR,
    ) -> "Camera":
        """Return the pinhole camera at ``eye`` that looks at ``target``, both in world units.

        Args:
            eye: The camera centre.
            target: The point in the middle of the image.
            up: The world's upward direction.
            width: Image width, in pixels.
            height: Image height, in pixels.
            fov_y: Vertical field of view, in degrees.
            near: Distance of the near plane.

        Raises:
            SceneInvalid: ``eye`` and ``target`` are one point, or a number is out of range.
        """
        if not 0 < fov_y < 180:
            raise SceneInvalid(f"is {fov_y} degrees, expected 0 to 180", where="camera.fov_y")
        require_image_side("height", height)
        position, target_position = np.asarray(eye, np.float64), np.asarray(target, np.float64)
        if not np.linalg.norm(target_position - position) > 0:
            raise SceneInvalid(
                f"looks from {position.tolist()} at {target_position.tolist()}, expected two different points",
                where="camera",
            )
        up_vector = unit_direction("up", up)
        focal = height / 2 / math.tan(math.radians(fov_y) / 2)
        view = geometry.look_at(position, target_position, up_vector)
        return cls(
            view,
            fx=focal,
            fy=focal,
            cx=width / 2,
            cy=height / 2,
            width=width,
            height=height,
            near=near,
        )

    @classmethod
    def orbit(
        cls,
        center: Sequence[float],
        radius: float,
        *,
        azimuth: float = 0.0,
        elevation: float = 0.0,
        up: Sequence[float] = _UP_DIRECTION,
        width: int = 1280,
        height: int = 720,
        fov_y: float = 50.0,
        near: float = DEFAULT_NEAR,
    ) -> "Camera":
        """Return the camera on a sphere around ``center`` that looks at the centre.

        The sphere has a ``radius`` in world units; ``azimuth`` is in degrees around ``up``,
        ``elevation`` in degrees above the horizon; the rest is as in :meth:`look_at`.

        Raises:
            SceneInvalid: A number is out of range.
        """
        require_number("radius", radius, must_be_positive=True)
        axis = unit_direction("up", up)
        side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        side /= np.linalg.norm(side)
        rotation, elevation_radians = math.radians(azimuth), math.radians(elevation)
        level = math.cos(rotation) * np.cross(side, axis) + math.sin(rotation) * side
        offset = math.cos(elevation_radians) * level + math.sin(elevation_radians) * axis
        middle = np.asarray(center, np.float64)
        # Straight above the centre, `up` is the viewing direction: the horizon's direction replaces it.
        up_vector = (
            axis
            if abs(elevation_radians) < math.pi / 2 - 1e-6
            else -math.copysign(1, elevation_radians) * level
        )
        return cls.look_at(
            (middle + radius * offset).tolist(),
            middle.tolist(),
            up=up_vector.tolist(),
            width=width,
            height=height,
            fov_y=fov_y,
            near=near,
        )

    @classmethod
    def panorama(
        cls,
        eye: Sequence[float],
        toward: Sequence[float] = (0.0, 0.0, 1.0),
        *,
        up: Sequence[float] = _UP_DIRECTION,
        width: int = 2048,
        height: int | None = None,
        longitudes: tuple[float, float] = (-180.0, 180.0),
        latitudes: tuple[float, float] = (-90.0, 90.0),
        near: float = DEFAULT_NEAR,
    ) -> "Camera":
        """Return the equirectangular panorama camera at ``eye``, which sees all around.

        The horizon is level: ``toward`` only chooses the direction of the middle column.

        Args:
            eye: The camera centre, in world units.
            toward: A direction, not along ``up``.
            up: The world's upward direction.
            width: Image width, in pixels.
            height: Image height, in pixels; None for square pixels.
            longitudes: Degrees at the left and the right edge; positive is to the right.
            latitudes: Degrees at the lower and the upper edge; positive is up.
            near: Least distance at which Gaussians are drawn.

        Raises:
            SceneInvalid: The angles are not in order or too far apart, ``toward`` is along ``up``,
                or a number is out of range.
        """
        for name, (low, high), most in (
            ("longitudes", longitudes, 360),
            ("latitudes", latitudes, 180),
        ):
            if not 0 < high - low <= most:
                raise SceneInvalid(
                    f"are {low} to {high} degrees, expected ascending angles at most {most} apart",
                    where=f"camera.{name}",
                )
        x_scale = math.radians(longitudes[1] - longitudes[0])
        y_scale = math.radians(latitudes[1] - latitudes[0])
        require_image_side("width", width)
        panorama_height = max(1, round(width * y_scale / x_scale)) if height is None else height
        require_image_side("height", panorama_height)
        fx, fy = width / x_scale, panorama_height / y_scale
        up_vector = unit_direction("up", up)
        forward_direction = unit_direction("toward", toward)
        forward_direction -= up_vector * (up_vector @ forward_direction)
        if not np.linalg.norm(forward_direction) > 1e-6:
            raise SceneInvalid(
                f"is {list(toward)}, expected a direction that is not parallel to up, {list(up)}",
                where="camera.toward",
            )
        view = geometry.look_at(np.zeros(3), forward_direction, up_vector)
        view[:3, 3] = -view[:3, :3] @ np.asarray(eye, np.float64)
        cx, cy = -math.radians(longitudes[0]) * fx, math.radians(latitudes[1]) * fy
        return cls(
            view,
            fx=fx,
            fy=fy,
            cx=cx,
            cy=cy,
            width=width,
            height=panorama_height,
            near=near,
            kind="panorama",
        )

    @classmethod
    def from_json(cls, text: str) -> "Camera":
        """Read a camera from a JSON object with the attributes of ``Camera``.

        Raises:
            SceneInvalid: The text is not a valid camera.
        """
        try:
            document = json.loads(text)
        except json.JSONDecodeError as error:
            raise SceneInvalid(f"is not valid JSON: {error}", where="camera") from error
        return cls.from_dict(document)

    @classmethod
    def from_dict(cls, document: object) -> "Camera":
        """Build a camera from a mapping with the attributes of ``Camera``.

        Raises:
            SceneInvalid: A field is missing, unknown or invalid.
        """
        known_names = _stored_fields()
        if not isinstance(document, Mapping):
            raise SceneInvalid(
                f"is a {type(document).__name__}, expected an object with {', '.join(known_names)}",
                where="camera",
            )
        optional_names = ("near", "kind", "distortion")
        missing = [
            name for name in known_names if name not in document and name not in optional_names
        ]
        unknown_names = [name for name in document if name not in known_names]
        if missing or unknown_names:
            parts = [f"lacks {', '.join(missing)}"] if missing else []
            parts += [f"has unknown {', '.join(map(str, unknown_names))}"] if unknown_names else []
            raise SceneInvalid(
                "; ".join(parts), where="camera", hint=f"Fields: {', '.join(known_names)}."
            )
        values: dict[str, Any] = dict(document)
        try:
            values["view"] = np.array(values["view"], np.float64)
        except (TypeError, ValueError) as error:
            raise SceneInvalid(f"is not a matrix: {error}", where="camera.view") from error
        if values.get("distortion") is not None:
            values["distortion"] = Distortion.from_dict(values["distortion"])
        return cls(**values)

    def to_json(self) -> str:
        """Return the camera as a JSON object."""
        values = {name: getattr(self, name) for name in _stored_fields()}
        values |= {"view": self.view.tolist()}
        del values["distortion"]
        if self.distortion is not None:
            values["distortion"] = self.distortion.to_dict()
        return json.dumps(values, indent=1)

    @property
    def eye(self) -> Float[np.ndarray, "3"]:
        """The camera centre −Rᵀt, in world units, [3]."""
        return np.asarray(-self.view[:3, :3].T @ self.view[:3, 3])

    @property
    def projection(self) -> Float[np.ndarray, "4 4"]:
        """The matrix from camera to clip space, depth 0 to 1, for ONNX generators, [4, 4].

        A panorama and a fisheye have no such matrix: it returns that of a box of 1e5 units around
        the camera, so that models that cull by the view cull nothing, not even points behind the
        camera. That of a distorted pinhole is of the pinhole that sees all of its image.
        """
        if self.kind == "pinhole" and self.distortion is not None:
            return np.asarray(pinhole_projection(self._bounding_pinhole()))
        if self.kind == "pinhole":
            return np.asarray(pinhole_projection(self))
        if self.has_ray_depth:
            box = np.diag([1 / FAR_RATIO, -1 / FAR_RATIO, 0.5 / FAR_RATIO, 1])
            box[2, 3] = 0.5
            return np.asarray(box)
        projection = np.eye(4)
        projection[0, [0, 3]] = 2 * self.fx / self.width, 2 * self.cx / self.width - 1
        projection[1, [1, 3]] = -2 * self.fy / self.height, 1 - 2 * self.cy / self.height
        depth = FAR_RATIO * self.near - self.near
        projection[2, 2:] = 1 / depth, -self.near / depth
        return projection

    @property
    def has_ray_depth(self) -> bool:
        """Whether depths are distances from the camera, as in a fisheye, and not along its axis."""
        return self.kind in ("fisheye", "panorama")

    @property
    def intrinsics(self) -> tuple[object, ...]:
        """All but the pose, the near plane and the dilation, as a key of caches."""
        lens = (self.fx, self.fy, self.cx, self.cy, self.kind, self.distortion)
        return (*lens, self.width, self.height)

    @property
    def ray_limit(self) -> float:
        """How far from the axis rays are drawn: an angle of a fisheye, a slope of a pinhole.

        Farther out the distortion would fold the image over, or is not bounded.
        """
        limit = _WIDEST_ANGLE if self.kind == "fisheye" else _STEEPEST_SLOPE
        return limit if self.distortion is None else self.distortion.fold_radius(limit)

    def plane_points(self, pixels: Points) -> Points:
        """Return points of the image plane without lens and focal length for pixels, [n, 2].

        They are slopes (x/z, y/z) of a pinhole, (x, y) of an orthographic camera, θ (x, y)/ρ of a
        fisheye, longitudes and latitudes of a panorama; beyond the lens, the nearest ones within.
        """
        points = (pixels - [self.cx, self.cy]) / [self.fx, self.fy]
        if self.distortion is None:
            return np.asarray(points)
        return self.distortion.undistorted(points, self.ray_limit)

    def plane_bounds(self) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
        """Return the least and the greatest :meth:`plane_points` of the image."""
        focal, center = np.array([self.fx, self.fy]), np.array([self.cx, self.cy])
        size = np.array([self.width, self.height])
        if self.distortion is None:
            return -center / focal, (size - center) / focal
        low, high = undistorted_bounds(
            self.distortion, self.ray_limit, *((*pair,) for pair in (focal, center, size))
        )
        return np.array(low), np.array(high)

    def half_angle(self) -> float:
        """Return an angle from the axis, in radians, within which a pinhole's or fisheye's image is."""
        low, high = self.plane_bounds()
        radius = min(float(np.linalg.norm(np.maximum(-low, high))), self.ray_limit)
        return radius if self.kind == "fisheye" else math.atan(radius)

    def _bounding_pinhole(self) -> "Camera":
        """Return the pinhole without distortion whose image has all rays of this camera's."""
        low, high = self.plane_bounds()
        fx, fy = np.array([self.width, self.height]) / (high - low)
        cx, cy = -low * [fx, fy]
        return replace(self, fx=fx, fy=fy, cx=cx, cy=cy, distortion=None)

    @property
    def period(self) -> float:
        """The width of a full panorama of 360 degrees, in pixels; 0 for other cameras."""
        return 2 * math.pi * self.fx if self.kind == "panorama" else 0.0

    def flattened(self, distance: float) -> "Camera":
        """Return an orthographic camera that shows objects at a distance in this camera's scale.

        Raises:
            SceneInvalid: The distance is not positive, or the camera is a panorama or a fisheye.
        """
        require_number("distance", distance, must_be_positive=True)
        if self.has_ray_depth:
            raise SceneInvalid(
                f"is {self.kind}, expected pinhole or orthographic for an orthographic view",
                where="camera.kind",
            )
        scale = distance if self.kind == "pinhole" else 1.0
        fx, fy = self.fx / scale, self.fy / scale
        return replace(self, fx=fx, fy=fy, kind="orthographic", distortion=None)

    def panorama_around(self, width: int, height: int) -> "Camera":
        """Return a 360° camera at this camera's position, with this camera's axis in the middle."""
        return Camera(
            self.view,
            fx=width / (2 * math.pi),
            fy=height / math.pi,
            cx=width / 2,
            cy=height / 2,
            width=width,
            height=height,
            near=self.near,
            kind="panorama",
        )

    def scaled(self, width: int, height: int) -> "Camera":
        """Return the camera with the same field of view in an image of another size."""
        x_scale, y_scale = width / self.width, height / self.height
        return replace(
            self,
            fx=self.fx * x_scale,
            fy=self.fy * y_scale,
            cx=self.cx * x_scale,
            cy=self.cy * y_scale,
            width=width,
            height=height,
        )

    def has_shape(self, width: int, height: int) -> bool:
        """Return whether an image of a size has the camera's proportions, to a rounded pixel."""
        difference = abs(width * self.height - height * self.width)
        return difference <= max(self.width, self.height)

    def resized(self, width: int, height: int) -> "Camera":
        """Return the camera in an image of another size and perhaps another shape, unstretched.

        An image of another shape keeps the vertical field of view: it shows less or more at the
        left and right. A panorama fills the image, and its edges are cropped.
        """
        if self.has_shape(width, height):
            return self.scaled(width, height)
        scale = height / self.height
        if self.kind == "panorama":
            scale = max(scale, width / self.width)
        return replace(
            self,
            fx=self.fx * scale,
            fy=self.fy * scale,
            cx=width / 2 + (self.cx - self.width / 2) * scale,
            cy=height / 2 + (self.cy - self.height / 2) * scale,
            width=width,
            height=height,
        )


def _stored_fields() -> list[str]:
    """Return the names of the fields that a camera file has."""
    return [field.name for field in fields(Camera) if field.name != "dilation"]
