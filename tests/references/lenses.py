"""Camera models with lenses, by the formulas of the programs that write them.

Each function returns the pixel of a point (x, y, z) in camera space, in float64, and shares nothing
with the renderer. COLMAP's are those of its documentation ("Camera Models"); OpenCV's of "Camera
Calibration and 3D Reconstruction" and of the module fisheye; OpenSfM's of "Geometric Models";
openMVG's of its documentation ("camera"); Metashape's of its manual ("Camera models"); Bundler's of
its user's manual; nerfstudio's of its undistortion (``camera_utils.py``).
"""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from gsgen.runtime.scene.camera import Camera

Pixel = tuple[float, float]
Point = Sequence[float]


def colmap_pixel(model: str, values: Sequence[float], point: Point) -> Pixel:
    """Return the pixel by a camera model of COLMAP, with its parameters in COLMAP's order."""
    has_two_focals = model in ("OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FISHEYE")
    if has_two_focals or model == "THIN_PRISM_FISHEYE":
        fx, fy, cx, cy, *extra = values
    else:
        fx, cx, cy, *extra = values
        fy = fx
    u, v = (
        _fisheye_angles(point) if "FISHEYE" in model else (point[0] / point[2], point[1] / point[2])
    )
    du, dv = _colmap_shift(model, extra, u, v)
    return fx * (u + du) + cx, fy * (v + dv) + cy


def _colmap_shift(model: str, extra: Sequence[float], u: float, v: float) -> Pixel:
    r2 = u * u + v * v
    if model in ("SIMPLE_FISHEYE", "FISHEYE"):
        return 0.0, 0.0
    if model in ("SIMPLE_RADIAL", "SIMPLE_RADIAL_FISHEYE"):
        return u * extra[0] * r2, v * extra[0] * r2
    if model in ("RADIAL", "RADIAL_FISHEYE"):
        radial = extra[0] * r2 + extra[1] * r2**2
        return u * radial, v * radial
    if model == "OPENCV_FISHEYE":
        radial = sum(k * r2 ** (power + 1) for power, k in enumerate(extra))
        return u * radial, v * radial
    if model == "OPENCV":
        k1, k2, p1, p2 = extra
        radial = k1 * r2 + k2 * r2**2
        return _with_tangential(u, v, radial, p1, p2)
    if model == "FULL_OPENCV":
        k1, k2, p1, p2, k3, k4, k5, k6 = extra
        factor = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
        return _with_tangential(u, v, factor - 1, p1, p2)
    assert model == "THIN_PRISM_FISHEYE"
    k1, k2, p1, p2, k3, k4, sx1, sy1 = extra
    radial = k1 * r2 + k2 * r2**2 + k3 * r2**3 + k4 * r2**4
    du, dv = _with_tangential(u, v, radial, p1, p2)
    return du + sx1 * r2, dv + sy1 * r2


def _with_tangential(u: float, v: float, radial: float, p1: float, p2: float) -> Pixel:
    r2 = u * u + v * v
    du = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
    dv = v * radial + 2 * p2 * u * v + p1 * (r2 + 2 * v * v)
    return du, dv


def _fisheye_angles(point: Point) -> Pixel:
    x, y, z = point
    rho = math.hypot(x, y)
    theta = math.atan2(rho, z)
    return (theta * x / rho, theta * y / rho) if rho > 0 else (0.0, 0.0)


def nerfstudio_pixel(values: dict[str, float], point: Point, *, is_fisheye: bool) -> Pixel:
    """Return the pixel by nerfstudio, whose radial polynomial has k1 to k4."""
    x, y = _fisheye_angles(point) if is_fisheye else (point[0] / point[2], point[1] / point[2])
    k1, k2, k3, k4, p1, p2 = (
        values.get(name, 0.0) for name in ("k1", "k2", "k3", "k4", "p1", "p2")
    )
    r = x * x + y * y
    d = 1.0 + r * (k1 + r * (k2 + r * (k3 + r * k4)))
    xd = d * x + 2 * p1 * x * y + p2 * (r + 2 * x * x)
    yd = d * y + 2 * p2 * x * y + p1 * (r + 2 * y * y)
    return values["fl_x"] * xd + values["cx"], values["fl_y"] * yd + values["cy"]


def opensfm_pixel(lens: dict[str, object], point: Point) -> Pixel:
    """Return the pixel by a camera of OpenSfM, whose lengths are shares of the longer side."""
    numbers = {name: value for name, value in lens.items() if isinstance(value, int | float)}
    k1, k2, k3, k4, p1, p2 = (
        numbers.get(name, 0.0) for name in ("k1", "k2", "k3", "k4", "p1", "p2")
    )
    x, y, z = point
    if "fisheye" in str(lens["projection_type"]):
        theta, r = math.atan2(math.hypot(x, y), z), math.hypot(x, y)
        theta_d = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
        xd, yd = theta_d * x / r, theta_d * y / r
    else:
        x, y = x / z, y / z
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)
    longer = max(numbers["width"], numbers["height"])
    fx, fy = (
        numbers.get("focal_x", numbers.get("focal", 0)),
        numbers.get("focal_y", numbers.get("focal", 0)),
    )
    cx, cy = numbers.get("c_x", 0.0), numbers.get("c_y", 0.0)
    return (
        longer * (fx * xd + cx) + numbers["width"] / 2,
        longer * (fy * yd + cy) + numbers["height"] / 2,
    )


def openmvg_pixel(lens: dict[str, object], point: Point) -> Pixel:
    """Return the pixel by an intrinsic of openMVG."""
    x, y, z = point
    x, y = x / z, y / z
    focal, (ppx, ppy) = float(str(lens["focal_length"])), lens["principal_point"]  # type: ignore[misc]
    r2 = x * x + y * y
    if "fisheye" in lens:
        k1, k2, k3, k4 = lens["fisheye"]  # type: ignore[misc]
        r = math.sqrt(r2)
        theta = math.atan(r)
        scale = (theta + k1 * theta**3 + k2 * theta**5 + k3 * theta**7 + k4 * theta**9) / r
        return focal * x * scale + ppx, focal * y * scale + ppy
    if "disto_t2" in lens:
        k1, k2, k3, t1, t2 = lens["disto_t2"]  # type: ignore[misc]
        radial = k1 * r2 + k2 * r2**2 + k3 * r2**3
        tx = t2 * (r2 + 2 * x * x) + 2 * t1 * x * y
        ty = t1 * (r2 + 2 * y * y) + 2 * t2 * x * y
        return focal * (x + x * radial + tx) + ppx, focal * (y + y * radial + ty) + ppy
    coefficients: list[float] = lens.get("disto_k1") or lens["disto_k3"]  # type: ignore[assignment]
    radial = 1 + sum(k * r2 ** (power + 1) for power, k in enumerate(coefficients))
    return focal * x * radial + ppx, focal * y * radial + ppy


def metashape_pixel(
    kind: str, values: dict[str, float], size: tuple[int, int], point: Point
) -> Pixel:
    """Return the pixel by a sensor of Metashape."""
    x, y, z = point
    if kind == "frame":
        x, y = x / z, y / z
    else:
        x, y = x / z, y / z
        r0 = math.hypot(x, y)
        x, y = x * math.atan(r0) / r0, y * math.atan(r0) / r0
    r2 = x * x + y * y
    k1, k2, k3, k4 = (values.get(f"k{number}", 0.0) for number in range(1, 5))
    p1, p2, b1 = (values.get(name, 0.0) for name in ("p1", "p2", "b1"))
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3 + k4 * r2**4
    xd = x * radial + (p1 * (r2 + 2 * x * x) + 2 * p2 * x * y)
    yd = y * radial + (p2 * (r2 + 2 * y * y) + 2 * p1 * x * y)
    u = size[0] * 0.5 + values["cx"] + xd * values["f"] + xd * b1
    return u, size[1] * 0.5 + values["cy"] + yd * values["f"]


def bundler_pixel(focal: float, k1: float, k2: float, size: tuple[int, int], point: Point) -> Pixel:
    """Return the pixel by Bundler, whose camera looks along −z with y up, as has its image."""
    x, y, z = point[0], -point[1], -point[2]
    px, py = -x / z, -y / z
    r2 = px * px + py * py
    factor = 1.0 + k1 * r2 + k2 * r2**2
    return size[0] / 2 + focal * factor * px, size[1] / 2 - focal * factor * py


def lens_pixel(camera: Camera, point: Point) -> Pixel:
    """Return the pixel of a point in camera space by OpenCV's formulas, for a ``Camera``."""
    u, v = lens_pixels(camera, np.array([point]))[0].tolist()
    return u, v


def lens_pixels(camera: Camera, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """Return the pixels of points in camera space by OpenCV's formulas, for a ``Camera``."""
    x, y, z = points.T
    if camera.kind == "fisheye":
        rho = np.hypot(x, y)
        scale = np.where(rho > 0, np.arctan2(rho, z) / np.where(rho > 0, rho, 1), 1)
        u, v = scale * x, scale * y
    else:
        u, v = (x, y) if camera.kind == "orthographic" else (x / z, y / z)
    if camera.distortion is not None:
        (k1, k2, k3, k4), (d1, d2, d3) = camera.distortion.radial, camera.distortion.divisor
        (p1, p2), (s1, s2) = camera.distortion.tangential, camera.distortion.prism
        r2 = u * u + v * v
        factor = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3 + k4 * r2**4
        factor = factor / (1 + d1 * r2 + d2 * r2**2 + d3 * r2**3)
        du = 2 * p1 * u * v + p2 * (r2 + 2 * u * u) + s1 * r2
        dv = 2 * p2 * u * v + p1 * (r2 + 2 * v * v) + s2 * r2
        u, v = u * factor + du, v * factor + dv
    return np.stack([camera.fx * u + camera.cx, camera.fy * v + camera.cy], -1)
