"""Validation rules of generators of pictures: rows have the places and colours of their pixels."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gsgen.contract._array_types import Float, Int
from gsgen.contract.probing.outputs import ModelOutputs, read_outputs
from gsgen.contract.probing.run_comparison import Behaviour
from gsgen.contract.spec.layout import CULL_OPACITY, OPACITY
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.spherical_harmonics import SH_DC
from gsgen.contract.validation.finding import Statistic, Violation, line_hint
from gsgen.contract.validation.gates import COLORED_ROW_RULES, REPRODUCIBLE
from gsgen.contract.validation.rule import rule

# Rows lie on a lattice if all but one in a hundred are this near to it, in steps, on several lines.
# Middles of pixels, or of blocks of pixels, are half a step from the picture's corner.
_MAX_LATTICE_ERROR, _MIN_LATTICE_SHARE, _MIN_LATTICE_LINES = 0.01, 0.99, 4

# The picture of each row, and the row and the column of its pixel.
_Pixels = tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Int[np.ndarray, " n"]]


@rule("GB070", Severity.ERROR, needs=(*REPRODUCIBLE, "GO001", "GO002", "GO016", "GI033", "GM006"))
def picture_cameras_read_as_declared(behaviour: Behaviour) -> Iterator[Violation]:
    """Gaussians of pictures are in local space, where cameras and lenses of the pictures place them.

    Why:
        Where all cameras of pictures move together, the pixels' Gaussians move with them. Libraries
        differ in the direction of a pose, memory order, axes and the unit of intrinsics: read
        otherwise, the scene lies elsewhere than its cameras.

    Hint:
        `image_view` is world-to-camera with +x right, +y down and +z forward, `image_intrinsics` in
        pixels. Place the pixel (u, v) of depth d at Rᵀ (d K⁻¹ (u, v, 1) − t).
    """
    from gsgen.contract.causes.picture_cameras import (
        TRANSPOSED,
        is_equivariant,
        is_translated_otherwise,
        reading_behind_cameras,
        reading_of_cameras,
        reading_of_lenses,
    )
    from gsgen.contract.probing.behaviour_probes import MOVED_ALONE, MOVED_TOGETHER, OTHER_LENSES
    from gsgen.contract.probing.posed_pictures import picture_pairs

    pairs = {pair.run.probe.label: pair for pair in picture_pairs(behaviour)}
    moved = next((pair for words, pair in pairs.items() if words.endswith(MOVED_TOGETHER)), None)
    if moved is None:
        return
    lens = next((pair for words, pair in pairs.items() if words.endswith(OTHER_LENSES)), moved)
    alone = [(pair.base, pair.other) for words, pair in pairs.items() if MOVED_ALONE in words]
    reading = reading_of_cameras(moved.base, moved.other, (lens.base, lens.other), alone)
    if is_equivariant(moved.base, moved.other):
        reading = reading_of_lenses(lens.base, lens.other)
        reading = reading or reading_behind_cameras(moved.base)
    expected = "rows that follow cameras and lenses as declared"
    where = moved.outputs.rows_label
    if reading is not None:
        actual = f"{reading.rows} Gaussians of the pictures show that {reading.name}"
        hint = reading.hint
        if reading.name == TRANSPOSED:
            views = behaviour.subject.inputs_of("image_view")[0][0].name
            line = line_hint(f"{views} = {views}.transpose(1, 2)", first=True)
            hint = f"{hint} {line}"
        yield Violation.at(where, actual, expected, hint=hint)
    elif is_translated_otherwise(moved.base, moved.other):
        actual = "the Gaussians of each picture turn with its camera, and are moved elsewhere"
        hint = (
            "Place a point c of the camera at Rᵀ (c − t); check the sign of the translation, and undo "
            "any scale or origin that cameras were given for the network."
        )
        yield Violation.at(where, actual, expected, hint=hint)


@rule("GB071", Severity.WARNING, needs=(*REPRODUCIBLE, *COLORED_ROW_RULES, "GI033", "GB070"))
def pictures_come_back(behaviour: Behaviour) -> Iterator[Violation]:
    """Gaussians of a picture have the colours of its pixels, at their middles, each by its camera.

    Why:
        Libraries differ in channels, range and encoding of colours, order and middle of pixels. A
        colour that differs from its pixel's by such a change was made by it; others are left out.

    Hint:
        Pictures are [V, 3, height, width] with red first, sRGB-encoded; pixel (0, 0) has its middle
        at (½, ½). Give each row the place and the colour of the same pixel, and each picture its
        own camera.
    """
    yield from _unused_cameras(behaviour)
    rows = _read_pixel_rows(behaviour)
    if rows is None:
        return
    yield from _half_pixels(rows)
    from gsgen.contract.causes.picture_colors import MIN_DECLARED_ERROR, explain_colors

    reading = explain_colors(_at(rows.pictures, rows.pixels), rows.shown, _other_places(rows))
    if reading is not None:
        line = line_hint("" if rows.outputs.is_sh else reading.line)
        actual = f"half of {len(rows.shown)} rows differ from their pixels: {reading.name}"
        yield Violation.at(
            rows.outputs.color_label,
            actual,
            "the colours of their pixels",
            certainty="possible",
            statistic=Statistic("error over contrast", reading.declared, 0.0, MIN_DECLARED_ERROR),
            hint=f"{reading.hint} {line}".strip(),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _PixelRows:
    """The drawn rows of the base run, and the pixels that they belong to.

    Attributes:
        outputs: The outputs of the base run.
        pictures: Its pictures, from 0 to 1, [v, 3, h, w].
        shown: The encoded colours of the rows, [n, 3].
        pixels: The pixels of the rows: by place where cameras and lenses tell it, or by number.
        numbers: The pixels that the numbers of rows stand for; None if there are more rows or fewer.
        place: Where each row lies in its picture, in pixels, [n, 2]; None without lenses.
    """

    outputs: ModelOutputs
    pictures: Float[np.ndarray, "v 3 h w"]
    shown: Float[np.ndarray, "n 3"]
    pixels: _Pixels
    numbers: _Pixels | None
    place: Float[np.ndarray, "n 2"] | None


def _unused_cameras(behaviour: Behaviour) -> Iterator[Violation]:
    """Yield a violation if the camera of one picture has no effect, and that of another one has."""
    from gsgen.contract.probing.behaviour_probes import MOVED_ALONE, PICTURE_CAMERAS

    runs = [run for run in behaviour.trial_runs(PICTURE_CAMERAS) if MOVED_ALONE in run.probe.label]
    unused = [run for run in runs if run.digest == behaviour.base.digest]
    if unused and len(unused) < len(runs):
        names = [run.probe.label.partition(MOVED_ALONE)[2].split()[0] for run in unused]
        entry = behaviour.subject.inputs_of("image_view")[0][0]
        actual = f"no output changes with the camera of picture {', '.join(names)}"
        expected = "an effect of each picture's camera"
        yield Violation.at(f"input {entry.name}", actual, expected, certainty="possible")


def _read_pixel_rows(behaviour: Behaviour) -> _PixelRows | None:
    images = behaviour.subject.inputs_of("image")
    base = behaviour.base
    outputs = read_outputs(behaviour.subject, base.probe.label, base.outputs)
    packed, color, declared = outputs.gaussians, outputs.appearance, outputs.declared
    if not images or packed is None or color is None or declared is None:
        return None
    image, pictures = images[0][0], base.probe.inputs[images[0][0].name].astype(np.float64)
    low, high = image.range or (0.0, 1.0)
    if pictures.ndim != 4 or pictures.shape[1] != 3:
        return None
    is_drawn = (packed[:, OPACITY] >= CULL_OPACITY) & np.isfinite(color).all(axis=1)
    indices, place = np.flatnonzero(is_drawn[: outputs.count]), None
    numbers = _pixels_by_number(behaviour, outputs, indices, pictures.shape)
    own = _own_pixels(behaviour)
    pixels = numbers
    if own is not None:
        indices, picture, place = own
        height, width = pictures.shape[2:]
        column, row = (np.clip(np.floor(place), 0, (width - 1, height - 1)).astype(int)).T
        pixels, numbers = (picture, row, column), _pixels_by_number(
            behaviour, outputs, indices, pictures.shape
        )  # fmt: skip
    if pixels is None:
        return None
    shown = color[indices, :3].astype(np.float64)
    if outputs.is_sh:
        shown = 0.5 + SH_DC * shown
    if declared.color_space == "linear":
        from gsgen.contract.spec.srgb import srgb_of_linear

        shown = srgb_of_linear(shown)
    return _PixelRows(
        outputs=outputs,
        pictures=(pictures - low) / (high - low),
        shown=shown,
        pixels=pixels,
        numbers=numbers,
        place=place,
    )


def _own_pixels(
    behaviour: Behaviour,
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, "n 2"]] | None:
    """Return rows, their pictures and their places in them, where other lenses leave them there."""
    if not behaviour.subject.inputs_of("image_intrinsics"):
        return None
    from gsgen.contract.causes.picture_cameras import own_pixels
    from gsgen.contract.probing.behaviour_probes import OTHER_LENSES
    from gsgen.contract.probing.posed_pictures import picture_pairs

    for pair in picture_pairs(behaviour):
        if pair.run.probe.label.endswith(OTHER_LENSES):
            own = own_pixels(pair.base, pair.other)
            return None if own is None else (pair.indices, *own)
    return None


def _pixels_by_number(
    behaviour: Behaviour,
    outputs: ModelOutputs,
    indices: Int[np.ndarray, " n"],
    shape: tuple[int, ...],
) -> _Pixels | None:
    """Return the pixels of rows that come picture by picture, and row by row."""
    from gsgen.contract.probing.sandbox_worker import subsample_step

    declared = behaviour.subject.declared_gaussians
    count, _, height, width = shape
    if declared is None or declared.capacity != count * height * width:
        return None
    step = subsample_step(declared.capacity)
    picture, row, column = np.unravel_index(indices * step, (count, height, width))
    return picture, row, column


def _at(pictures: Float[np.ndarray, "v 3 h w"], pixels: _Pixels) -> Float[np.ndarray, "n 3"]:
    picture, row, column = pixels
    return pictures[picture, :, row, column]


def _other_places(rows: _PixelRows) -> dict[str, tuple[Float[np.ndarray, "n 3"], str]]:
    """Return the colours of the pixels at which rows may have been taken by mistake, by its name.

    Where their place is unknown, there are none: rows may come in any order.
    """
    if rows.place is None:
        return {}
    picture, row, column = rows.pixels
    count, _, height, width = rows.pictures.shape
    places: dict[str, tuple[_Pixels, str]] = {
        "they have the colours of the mirrored picture": (
            (picture, row, width - 1 - column),
            "The first column of a picture is the left one, at −x of its camera.",
        ),
        "they have the colours of the picture upside down": (
            (picture, height - 1 - row, column),
            "The first row of a picture is the upper one, at −y of its camera.",
        ),
    }
    if count > 1:
        next_picture = ((picture + 1) % count, row, column)
        hint = "Place the rows of picture k by camera k, with its colours."
        places["they have the colours of the next picture"] = (next_picture, hint)
    if rows.numbers is not None:
        hint = "Let the grid of pixels and the colours run in the same order, row by row."
        number = np.ravel_multi_index(rows.numbers[1:], (height, width))
        across, down = np.unravel_index(number, (width, height))
        by_column = (rows.numbers[0], down, across)
        places["colours run row by row, and positions run in another order"] = (rows.numbers, hint)
        places["colours run column by column, and positions row by row"] = (by_column, hint)
    return {name: (_at(rows.pictures, pixels), hint) for name, (pixels, hint) in places.items()}


def _half_pixels(rows: _PixelRows) -> Iterator[Violation]:
    """Yield a violation if rows lie on the corners of pixels."""
    if rows.place is None:
        return
    offsets = [_lattice_offset(values) for values in rows.place.T]
    if all(offset is not None and offset < _MAX_LATTICE_ERROR for offset in offsets):
        actual = "the rows lie at the corners of pixels, at whole numbers: half a pixel off"
        yield Violation.at(
            rows.outputs.rows_label,
            actual,
            "rows at the middles of pixels",
            certainty="possible",
            hint="Add ½ to the numbers of columns and rows before the intrinsics are applied.",
        )


def _lattice_offset(values: Float[np.ndarray, " n"]) -> float | None:
    """Return how far a lattice of values is from the picture's corner, in steps; None without one."""
    lines = np.unique(np.round(values, 2))
    if len(lines) < _MIN_LATTICE_LINES:
        return None
    step = float(np.median(np.diff(lines)))
    phase = values / step - np.rint(values / step)
    middle = float(np.angle(np.exp(2j * np.pi * phase).mean())) / (2 * np.pi)
    distance = phase - middle
    distance -= np.rint(distance)
    is_on_lattice = np.mean(np.abs(distance) < _MAX_LATTICE_ERROR) >= _MIN_LATTICE_SHARE
    return abs(middle) if is_on_lattice else None
