"""Reads COLMAP's cameras.txt and images.txt: one line per camera, two per image."""

__all__ = ["images", "lenses"]

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files.colmap_models import ColmapImage, ColmapLens

_MAX_LINE_LENGTH: Final = 1 << 26  # characters of a line: an image may have a million points


def lenses(path: Path) -> dict[int, ColmapLens]:
    """Read the intrinsics in COLMAP's cameras.txt, by camera number."""
    lens_by_number = {}
    for number, line in _read_lines(path):
        if not line or line.startswith("#"):
            continue
        words, where = line.split(), f"{path}, line {number}"
        if len(words) < 5:
            raise ConfigInvalid(
                f"the line has {len(words)} words, expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS",
                where=where,
            )
        lens_number, width, height = _parse_integers([words[0], *words[2:4]], where)
        if lens_number in lens_by_number:
            raise ConfigInvalid(f"defines camera {lens_number} a second time", where=where)
        lens_by_number[lens_number] = ColmapLens(
            words[1], width, height, _parse_floats(words[4:], where)
        )
    return lens_by_number


def images(path: Path) -> list[ColmapImage]:
    """Read COLMAP's images.txt: per image a line of pose, camera and name, and a line of points.

    The second line holds ``X Y POINT3D_ID`` of each point, or nothing. Comments may be anywhere.
    """
    records: list[ColmapImage] = []
    is_points_line = False
    for number, line in _read_lines(path):
        where = f"{path}, line {number}"
        if line.startswith("#"):
            continue
        if is_points_line:
            _require_points(line, records[-1].name, where)
            is_points_line = False
        elif line:
            records.append(_image(line, where))
            is_points_line = True
    return records


def _image(line: str, where: str) -> ColmapImage:
    words = line.split(maxsplit=9)
    if len(words) < 10:
        raise ConfigInvalid(
            f"the line has {len(words)} words, expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME",
            where=where,
        )
    pose = _parse_floats(words[1:8], where)
    _, lens = _parse_integers([words[0], words[8]], where)
    return ColmapImage(words[9], pose[:4], pose[4:], lens)


def _require_points(line: str, image_name: str, where: str) -> None:
    """Raise if the line after an image is not a list of points: triples of numbers, or empty."""
    words = line.split()
    try:
        numbers = np.array(words, np.float64)
        is_list = not len(words) % 3 and bool((numbers[2::3] == np.floor(numbers[2::3])).all())
    except ValueError:
        is_list = False
    if not is_list:
        shown_line = line if len(line) < 80 else line[:77] + "…"
        raise ConfigInvalid(
            f"the line after image {image_name!r} is {shown_line!r}, expected its 2D points as triples "
            "X Y POINT3D_ID, or an empty line",
            where=where,
            hint="Each image of images.txt has two lines; the second is empty without points.",
        )


def _read_lines(path: Path) -> Iterator[tuple[int, str]]:
    try:
        with open(path, encoding="utf-8", errors="replace") as file:
            number = 0
            while line := file.readline(_MAX_LINE_LENGTH):
                number += 1
                if len(line) == _MAX_LINE_LENGTH:
                    raise ConfigInvalid(
                        f"line {number} has more than {_MAX_LINE_LENGTH:,} characters",
                        where=str(path),
                    )
                yield number, line.strip()
    except OSError as error:
        raise ConfigInvalid(f"cannot be read: {error.strerror}", where=str(path)) from error


def _parse_floats(words: list[str], where: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(word) for word in words)
    except ValueError as error:
        raise ConfigInvalid(f"the line has {words}, expected numbers", where=where) from error
    if not all(map(math.isfinite, numbers)):
        raise ConfigInvalid(f"the line has {words}, expected finite numbers", where=where)
    return numbers


def _parse_integers(words: list[str], where: str) -> list[int]:
    try:
        return [int(word) for word in words]
    except ValueError as error:
        raise ConfigInvalid(f"the line has {words}, expected integers", where=where) from error
