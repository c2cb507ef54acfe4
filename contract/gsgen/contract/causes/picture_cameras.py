"""How a model of pictures may take their cameras and lenses by mistake, by what its rows do.

A model that places Gaussians along the rays of its pictures keeps them at the same point of each
picture's camera when all cameras move together. In which reading of the matrices they stay is the
reading of the model: as declared, the point is W p of the world→camera matrix W.

1. Cameras: the rows of two runs that differ in one rigid motion of all cameras are brought into the
   camera of each reading, each row by the picture that fits it best.
2. Depth: where the rows stay as declared, they lie before the cameras, or behind all of them.
3. Lenses: rows of two runs that differ in the lenses stay at the same pixel in the model's reading,
   and are spread over the picture.
"""

__all__ = [
    "TRANSPOSED",
    "PosedRows",
    "is_equivariant",
    "is_translated_otherwise",
    "own_pixels",
    "reading_behind_cameras",
    "reading_of_cameras",
    "reading_of_lenses",
]

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Final

import numpy as np

from gsgen.contract._array_types import Float, Int
from gsgen.contract.causes.readings import MAX_INVALID_SHARE, Explanation, share_of

# Rows stay if they move by less than this fraction of the spread of all rows and of their distance,
# or of the picture.
# Right models that place rows along rays have 1e-6, from rounding; networks that look at cameras
# otherwise, too, have 0.01 to 1 in each reading.
TRANSPOSED = "the matrices were read transposed, in the other memory order"
_MAX_RESIDUAL_RATIO = 2e-3
# Fewer rows may fit a wrong reading by chance.
_MIN_ROWS = 16
# About so many rows are tried first: a reading that moves more than this share of them is wrong.
_SCREENED_ROWS, _MAX_SCREENED_SHARE = 512, 0.1
# Where one camera moves and the others stay, so many rows move that lie in the space of one of them.
_MIN_MOVING_SHARE = 0.1
# Pixels of rows are inside the picture within this fraction of it, and are spread over it if most
# of them take up so much of either side; in another unit, they take up a pixel or less.
_PICTURE_SLACK, _MIN_SPREAD, _MAX_OTHER_SPREAD = 0.1, 0.5, 0.25
_SPREAD_QUANTILES = (0.02, 0.98)

Points = Float[np.ndarray, "n 3"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PosedRows:
    """The rows of one run, and the cameras of its pictures.

    Attributes:
        position: Centres of the rows that are compared, [n, 3], float64.
        views: World→camera matrix of each picture, [v, 4, 4].
        lenses: Pinhole matrix of each picture in pixels, [v, 3, 3]; None without that input.
        size: Width and height of the pictures, in pixels.
    """

    position: Points
    views: Float[np.ndarray, "v 4 4"]
    lenses: Float[np.ndarray, "v 3 3"] | None
    size: tuple[int, int]


def is_equivariant(base: PosedRows, moved: PosedRows) -> bool:
    """Return whether the rows move as the cameras do, as far as rows can be told from their motion."""
    share = _moving_share(base, moved, lambda views: views)
    return len(base.position) >= _MIN_ROWS and share <= MAX_INVALID_SHARE


def reading_of_cameras(
    base: PosedRows,
    moved: PosedRows,
    lenses: tuple[PosedRows, PosedRows] | None = None,
    alone: Sequence[tuple[PosedRows, PosedRows]] = (),
) -> Explanation | None:
    """Return the reading in which the rows stay before their cameras; None if as declared, or none.

    Args:
        base: The rows of one run.
        moved: The same rows of a run whose cameras are moved by one rigid motion.
        lenses: Rows of two runs that differ in the lenses alone.
        alone: Rows of pairs of runs that differ in one camera alone.
    """
    count = len(base.position)
    if count < _MIN_ROWS or is_equivariant(base, moved):
        return None
    step = -(-count // _SCREENED_ROWS)
    few = [replace(rows, position=rows.position[::step]) for rows in (base, moved)]
    shares = {
        name: _moving_share(base, moved, read)
        for name, (read, _) in _READINGS.items()
        if _moving_share(few[0], few[1], read) <= _MAX_SCREENED_SHARE
    }
    names = [name for name, share in shares.items() if share <= MAX_INVALID_SHARE]
    # Several readings keep rows under a motion of all cameras: the model's also does under others.
    by_alone = {
        name: float(np.mean([_moving_share(*pair, _READINGS[name][0]) for pair in alone] or [0.0]))
        for name in names
    }
    name = min(names, key=by_alone.__getitem__, default=None)
    # The rows of a template stay, too. Those of a camera's space also stay at their pixels, and those
    # in the space of one of several cameras move when it does not move with the others.
    if name is None or (
        name == _STAYING
        and by_alone[name] < _MIN_MOVING_SHARE
        and not (lenses and _are_at_pixels_of_one_camera(*lenses))
    ):
        return None
    return Explanation(
        kind="space",
        name=name,
        declared=_moving_share(base, moved, lambda views: views),
        fraction=shares[name],
        rows=count,
        hint=_READINGS[name][1],
    )


def reading_behind_cameras(base: PosedRows) -> Explanation | None:
    """Return an explanation if all rows lie behind all cameras of pictures; else None."""
    depth = np.stack([_in_camera_space(view, base.position)[:, 2] for view in base.views])
    is_before = np.any(depth >= 0, axis=0)
    if len(is_before) < _MIN_ROWS or share_of(is_before) > MAX_INVALID_SHARE:
        return None
    name, hint = _OPENGL
    share, count = share_of(is_before), len(is_before)
    return Explanation(kind="space", name=name, declared=1.0, fraction=share, rows=count, hint=hint)


def is_translated_otherwise(base: PosedRows, moved: PosedRows) -> bool:
    """Return whether the rows of each picture turn as the cameras do, and are moved elsewhere."""
    # x' = M x: the matrices of a picture before and after the motion differ by it.
    motion = np.linalg.inv(moved.views[0]) @ base.views[0]
    offsets = moved.position - base.position @ motion[:3, :3].T
    limit = _MAX_RESIDUAL_RATIO * float(np.linalg.norm(np.ptp(base.position, axis=0)))
    # Rows at one point, as those that a mask took there, turn with anything.
    _, points, counts = np.unique(base.position, axis=0, return_inverse=True, return_counts=True)
    rest, is_elsewhere = offsets[counts[points.reshape(-1)] < _MIN_ROWS], False
    count = len(rest)
    for _ in base.views:
        if len(rest) < _MIN_ROWS:
            break
        # The rows of one picture share an offset; those of the others remain.
        is_near = np.linalg.norm(rest - rest[0], axis=1) <= limit
        if np.count_nonzero(is_near) < _MIN_ROWS:
            return False
        is_elsewhere |= bool(np.linalg.norm(rest[0] - motion[:3, 3]) > 2 * limit)
        rest = rest[~is_near]
    return is_elsewhere and len(rest) <= MAX_INVALID_SHARE * count


def reading_of_lenses(base: PosedRows, other: PosedRows) -> Explanation | None:
    """Return the reading of the pinhole matrices in which rows stay at their pixels; None if as declared.

    Args:
        base: The rows of one run.
        other: The same rows of a run that differs in the lenses alone.
    """
    count = len(base.position)
    if count < _MIN_ROWS or not _has_other_lenses(base, other):
        return None
    declared, spread = _pixel_motion(base, other, _as_declared)
    if declared <= MAX_INVALID_SHARE and spread > _MAX_OTHER_SPREAD:
        return None
    for name, (read, hint, *axes) in _LENSES.items():
        share, spread = _pixel_motion(base, other, read, *axes)
        if share <= MAX_INVALID_SHARE and spread >= _MIN_SPREAD:
            return Explanation(
                kind="space", name=name, declared=declared, fraction=share, rows=count, hint=hint
            )
    return None


def own_pixels(
    base: PosedRows, other: PosedRows
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 2"]] | None:
    """Return picture and pixel of each row that stays there under another lens; None unless all do."""
    if not _has_other_lenses(base, other):
        return None
    pixels, later = _pixels(base, _as_declared), _pixels(other, _as_declared)
    residual = np.nan_to_num(np.linalg.norm(pixels - later, axis=2), nan=np.inf)
    picture = residual.argmin(axis=0)
    rows = np.arange(len(picture))
    is_moving = residual[picture, rows] > _MAX_RESIDUAL_RATIO * max(base.size)
    return None if share_of(is_moving) > MAX_INVALID_SHARE else (picture, pixels[picture, rows])


def _are_at_pixels_of_one_camera(base: PosedRows, other: PosedRows) -> bool:
    """Return whether rows stay at their pixels under another lens, before cameras at the origin."""
    if not _has_other_lenses(base, other):
        return False
    views = np.broadcast_to(np.eye(4), base.views.shape)
    first, later = replace(base, views=views), replace(other, views=views)
    share, spread = _pixel_motion(first, later, _as_declared)
    return share <= MAX_INVALID_SHARE and spread >= _MIN_SPREAD


def _has_other_lenses(base: PosedRows, other: PosedRows) -> bool:
    if base.lenses is None or other.lenses is None:
        return False
    return not np.array_equal(base.lenses, other.lenses)


def _moving_share(base: PosedRows, moved: PosedRows, read: "_ReadViews") -> float:
    """Return the share of rows that move before every camera, in a reading of the matrices."""
    is_moving = np.ones(len(base.position), bool)
    for view, moved_view in zip(read(base.views), read(moved.views), strict=True):
        before = _in_camera_space(view, base.position)
        after = _in_camera_space(moved_view, moved.position)
        spread = float(np.linalg.norm(np.ptp(before, axis=0)))
        # A far row, as of the sky, makes the spread large: near rows are held to their distance.
        limit = _MAX_RESIDUAL_RATIO * np.minimum(spread, np.linalg.norm(before, axis=1))
        is_moving &= ~(np.linalg.norm(before - after, axis=1) <= limit)
    return share_of(is_moving)


def _as_declared(lens: Float[np.ndarray, "3 3"], _: tuple[int, int]) -> Float[np.ndarray, "3 3"]:
    return lens


def _pixels(
    rows: PosedRows, read: "_ReadLens", axes: tuple[int, int, int] = (1, 1, 1)
) -> Float[np.ndarray, "v n 2"]:
    """Return the pixel of each row in each picture; NaN of rows behind the camera.

    Args:
        rows: The rows, and the cameras of the pictures.
        read: A reading of the pinhole matrices.
        axes: The signs of the camera's axes in the reading.
    """
    assert rows.lenses is not None
    pixels = []
    for view, lens in zip(rows.views, rows.lenses, strict=True):
        local = _in_camera_space(view, rows.position) * axes
        depth = np.where(local[:, 2:] > np.finfo(float).tiny, local[:, 2:], np.nan)
        pixels.append((local / depth) @ read(lens, rows.size)[:2].T)
    return np.stack(pixels)


def _pixel_motion(
    base: PosedRows, other: PosedRows, read: "_ReadLens", axes: tuple[int, int, int] = (1, 1, 1)
) -> tuple[float, float]:
    """Return the share of rows that change their pixel, or leave the picture, and their spread.

    The spread is the part of the picture's shorter side that most pixels take up.
    """
    pixels, later = _pixels(base, read, axes), _pixels(other, read, axes)
    size = np.array(base.size, float)
    with np.errstate(invalid="ignore"):
        residual = np.abs((pixels - later) / size).max(axis=2)
        is_inside = (np.abs(pixels / size - 0.5) <= 0.5 + _PICTURE_SLACK).all(axis=2)
    residual = np.where(is_inside & np.isfinite(residual), residual, np.inf)
    picture = residual.argmin(axis=0)
    rows = np.arange(len(picture))
    own = pixels[picture, rows][np.isfinite(residual[picture, rows])] / size
    low, high = np.quantile(own, _SPREAD_QUANTILES, axis=0) if len(own) else np.zeros((2, 2))
    share = share_of(~(residual[picture, rows] <= _MAX_RESIDUAL_RATIO))
    return share, float((high - low).min())


Views = Float[np.ndarray, "v 4 4"]
_ReadViews = Callable[[Views], Views]
_ReadLens = Callable[[Float[np.ndarray, "3 3"], tuple[int, int]], Float[np.ndarray, "3 3"]]


def _in_camera_space(view: Float[np.ndarray, "4 4"], points: Points) -> Points:
    return np.asarray(points @ view[:3, :3].T + view[:3, 3])


def _with_parts(
    parts: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
) -> _ReadViews:
    """Return a reading that makes matrices of the rotations R and translations t of all cameras."""

    def read(views: Views) -> Views:
        matrices = np.zeros_like(views)
        matrices[:, :3, :3], translations = parts(views[:, :3, :3], views[:, :3, 3:])
        matrices[:, :3, 3:], matrices[:, 3, 3] = translations, 1
        return matrices

    return read


def _with_centers(move: Callable[[np.ndarray], np.ndarray]) -> _ReadViews:
    """Return a reading that changes the centres of all cameras, [v, 3, 1], and keeps rotations."""
    return _with_parts(lambda r, t: (r, -r @ move(-r.swapaxes(1, 2) @ t)))


def _lengths(vectors: np.ndarray) -> np.ndarray:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(np.maximum(lengths, np.finfo(np.float32).tiny))


def _without_mean(centers: np.ndarray) -> np.ndarray:
    return np.asarray(centers - centers.mean(axis=0))


def _name_of_axes(axes: tuple[int, ...], signs: tuple[int, ...]) -> str:
    return " ".join(
        f"{'−' if sign < 0 else ''}{'xyz'[axis]}" for axis, sign in zip(axes, signs, strict=True)
    )


def _with_axes(axes: tuple[int, ...], signs: tuple[int, ...]) -> _ReadViews:
    """Return a reading whose world has the declared coordinates of these numbers and signs."""
    world = np.zeros((4, 4))
    world[(*axes, 3), range(4)] = (*signs, 1)
    return lambda views: views @ world


_STAYING: Final = "they stay in the space of a picture's camera"
_POINT: Final = "a point c of the camera at Rᵀ (c − t)"
_NORMALISED: Final = (
    "Undo the scale and the origin that cameras were given, for the Gaussians' centres and sizes, "
    f"too: place {_POINT}."
)
# The reading of the matrices → the matrices that the model takes, and the repair of the model. R and
# t are rotation and translation of the world→camera matrix.
_READINGS: Final[dict[str, tuple[_ReadViews, str]]] = {
    "the matrices were taken for camera-to-world": (
        np.linalg.inv,
        f"The matrices are world-to-camera: place {_POINT}, or invert the matrices first.",
    ),
    TRANSPOSED: (
        _with_parts(lambda r, t: (r.swapaxes(1, 2), 0 * t)),
        "Declare the order that the model reads as space.matrix_order, or transpose the matrices "
        "inside the model.",
    ),
    "the translation has the other sign": (
        _with_parts(lambda r, t: (r, -t)),
        f"Place {_POINT}, not at Rᵀ (c + t).",
    ),
    "the translation was taken for the camera's centre": (
        _with_parts(lambda r, t: (r, -r @ t)),
        f"The camera's centre is −Rᵀ t: place {_POINT}.",
    ),
    "the translation was left out": (
        _with_parts(lambda r, t: (r, 0 * t)),
        f"Place {_POINT}, not at Rᵀ c.",
    ),
    "the rotation was inverted": (
        _with_parts(lambda r, t: (r.swapaxes(1, 2), t)),
        f"Place {_POINT}, not at R (c − t).",
    ),
    "the rotation was inverted about the camera's centre": (
        _with_parts(lambda r, t: (r.swapaxes(1, 2), (r @ r).swapaxes(1, 2) @ t)),
        "Turn rays by Rᵀ, and not by R, before the camera's centre −Rᵀ t is added.",
    ),
    "the rotation was left out": (
        _with_parts(lambda r, t: (0 * r + np.eye(3), r.swapaxes(1, 2) @ t)),
        "Turn rays by Rᵀ before the camera's centre −Rᵀ t is added.",
    ),
    "the translation alone was subtracted": (
        _with_parts(lambda r, t: (0 * r + np.eye(3), t)),
        f"Place {_POINT}, not at c − t.",
    ),
    _STAYING: (
        lambda views: np.broadcast_to(np.eye(4), views.shape),
        f"Place {_POINT}, also where a network takes the first camera as its world.",
    ),
    "the cameras' distances from the origin were divided by their mean": (
        _with_parts(lambda r, t: (r, t / _lengths(t).mean())),
        _NORMALISED,
    ),
    "the cameras' distances from the origin were divided by the largest": (
        _with_parts(lambda r, t: (r, t / _lengths(t).max())),
        _NORMALISED,
    ),
    "each camera was moved to the distance 1 from the origin": (
        _with_parts(lambda r, t: (r, t / _lengths(t))),
        _NORMALISED,
    ),
    "the cameras' distances from the origin were divided by that of the first": (
        _with_parts(lambda r, t: (r, t / _lengths(t)[0])),
        _NORMALISED,
    ),
    "the distance between the first two cameras was taken for 1": (
        _with_centers(lambda c: c / _lengths(c[1:2] - c[:1]) if len(c) > 1 else c),
        _NORMALISED,
    ),
    "the mean of the cameras' centres was taken for the origin": (
        _with_centers(_without_mean),
        _NORMALISED,
    ),
    "the cameras' centres were divided by their mean distance from their middle": (
        _with_centers(lambda c: _without_mean(c) / _lengths(_without_mean(c)).mean()),
        _NORMALISED,
    ),
    "the cameras' centres were divided by their largest distance from their middle": (
        _with_centers(lambda c: _without_mean(c) / _lengths(_without_mean(c)).max()),
        _NORMALISED,
    ),
    **{
        f"they are in a world of other axes, {_name_of_axes(axes, signs)}": (
            _with_axes(axes, signs),
            "Bring the centres into the axes of the matrices, which are those of local space: "
            "change the axes of rows and covariances back.",
        )
        for axes in permutations(range(3))
        for signs in product((1, -1), repeat=3)
        if (axes, signs) not in (((0, 1, 2), (1, 1, 1)), ((0, 1, 2), (-1, -1, -1)))
    },
}


def _scaled(rows: Callable[[tuple[int, int]], np.ndarray]) -> _ReadLens:
    """Return a reading in which a model multiplies its matrices by another one first."""
    return lambda lens, size: np.asarray(rows(size) @ lens)


def _with_entries(**entries: tuple[int, int]) -> _ReadLens:
    """Return a reading that takes some of fx, fy, cx, cy from other entries."""
    places = {"fx": (0, 0), "fy": (1, 1), "cx": (0, 2), "cy": (1, 2)} | entries

    def read(lens: Float[np.ndarray, "3 3"], _: tuple[int, int]) -> Float[np.ndarray, "3 3"]:
        fx, fy, cx, cy = (lens[places[key]] for key in ("fx", "fy", "cx", "cy"))
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])

    return read


def _with_middle(lens: Float[np.ndarray, "3 3"], size: tuple[int, int]) -> np.ndarray:
    matrix = lens.copy()
    matrix[:2, 2] = np.array(size) / 2
    return matrix


_OPENGL: Final = (
    "they lie behind the cameras of their pictures, along −z as in OpenGL",
    "Place Gaussians along +z of the picture's camera, with +y down: multiply y and z of the rays "
    "by −1.",
)
# The reading of the pinhole matrices → the matrix that the model takes, the repair, and the signs
# of the camera's axes if they differ.
_LENSES: Final[dict[str, tuple[_ReadLens, str] | tuple[_ReadLens, str, tuple[int, int, int]]]] = {
    _OPENGL[0]: (_as_declared, _OPENGL[1], (1, -1, -1)),
    "they lie behind the cameras of their pictures, along −z": (
        _as_declared,
        "Place Gaussians along +z of the picture's camera: multiply z of the rays by −1.",
        (1, 1, -1),
    ),
    "they lie upside down before the cameras of their pictures": (
        _as_declared,
        "Place Gaussians with +y of the picture's camera down: multiply y of the rays by −1.",
        (1, -1, 1),
    ),
    "they lie mirrored before the cameras of their pictures": (
        _as_declared,
        "Place Gaussians with +x of the picture's camera to the right: multiply x of the rays by "
        "−1.",
        (-1, 1, 1),
    ),
    "the intrinsics were taken for fractions of the picture's width and height": (
        _scaled(lambda size: np.diag([*size, 1.0])),
        "The intrinsics are in pixels: divide them by the picture's width and height inside the "
        "model, if it needs fractions.",
    ),
    "the intrinsics were taken for those of pixels from −1 to 1": (
        _scaled(
            lambda size: np.array(
                [[size[0] / 2, 0, size[0] / 2], [0, size[1] / 2, size[1] / 2], [0, 0, 1]]
            )
        ),
        "The intrinsics are in pixels: divide them by half the picture's width and height, and "
        "subtract 1 from the principal point, inside the model.",
    ),
    "the intrinsics were read transposed": (
        _with_entries(cx=(2, 0), cy=(2, 1)),
        "The intrinsics are stored row-major, in each memory order of the views: cx and cy are "
        "in the last column.",
    ),
    "the focal lengths were exchanged": (
        _with_entries(fx=(1, 1), fy=(0, 0)),
        "fx, the entry of row 0 and column 0, is along the width.",
    ),
    "the coordinates of the principal point were exchanged": (
        _with_entries(cx=(1, 2), cy=(0, 2)),
        "cx, the entry of row 0, is along the width.",
    ),
    "the focal length of the width was taken for both axes": (
        _with_entries(fy=(0, 0)),
        "Divide the pixels of the height by fy, the entry of row 1 and column 1.",
    ),
    "the principal point was taken for the middle of the picture": (
        _with_middle,
        "Subtract cx and cy of the intrinsics from the pixels.",
    ),
}
