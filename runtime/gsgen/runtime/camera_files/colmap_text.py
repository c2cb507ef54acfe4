"""Reads COLMAP's cameras.txt and images.txt: one line per camera, two per image."""

__all__ = ["images", "lenses"]

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files.colmap_models import ColmapImage, ColmapLens

_LONGEST: Final = 1 << 26  # characters of a line: an image may have a million points


def lenses(path: Path) -> dict[int, ColmapLens]:
    """Read the intrinsics in COLMAP's cameras.txt, by camera number."""
    by_number = {}
    for number, line in _lines(path):
        if not line or line.startswith("#"):
            continue
        words, where = line.split(), f"{path}, line {number}"
        if len(words) < 5:
            raise ConfigInvalid(
                f"the line has {len(words)} words, expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS",
                where=where,
            )
        lens_number, width, height = _integers([words[0], *words[2:4]], where)
        by_number[lens_number] = ColmapLens(words[1], width, height, _numbers(words[4:], where))
    return by_number


def images(path: Path) -> list[ColmapImage]:
    """Read COLMAP's images.txt: per image a line of pose, camera and name, and a line of points."""
    records = []
    points = False  # whether the next line holds the points of an image
    for number, line in _lines(path):
        if points or not line or line.startswith("#"):
            points = False
            continue
        points = True
        words, where = line.split(maxsplit=9), f"{path}, line {number}"
        if len(words) < 10:
            raise ConfigInvalid(
                f"the line has {len(words)} words, expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME",
                where=where,
            )
        pose = _numbers(words[1:8], where)
        _, lens = _integers([words[0], words[8]], where)
        records.append(ColmapImage(words[9], pose[:4], pose[4:], lens))
    return records


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    try:
        with open(path, encoding="utf-8", errors="replace") as file:
            number = 0
            while line := file.readline(_LONGEST):
                number += 1
                if len(line) == _LONGEST:
                    raise ConfigInvalid(
                        f"line {number} has more than {_LONGEST:,} characters", where=str(path)
                    )
                yield number, line.strip()
    except OSError as error:
        raise ConfigInvalid(f"cannot be read: {error.strerror}", where=str(path)) from error


def _numbers(words: list[str], where: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(word) for word in words)
    except ValueError as error:
        raise ConfigInvalid(f"the line has {words}, expected numbers", where=where) from error
    if not all(map(math.isfinite, numbers)):
        raise ConfigInvalid(f"the line has {words}, expected finite numbers", where=where)
    return numbers


def _integers(words: list[str], where: str) -> list[int]:
    try:
        return [int(word) for word in words]
    except ValueError as error:
        raise ConfigInvalid(f"the line has {words}, expected integers", where=where) from error
