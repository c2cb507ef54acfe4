"""Parses ``--input`` into input tracks: the values of one model input in each frame."""

__all__ = ["ARRAY_SUFFIXES", "Track", "counted_pictures", "input_track", "require_pictures"]

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np
from jaxtyping import Shaped

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.process.array_files import ArraysUnreadable, read_array_file
from gsgen.runtime.sources.source import Source

_ACCEPTED_FORMS_HINT: Final = (
    "Give NAME=NUMBER, NAME=A,B,… , NAME=FROM..TO, or NAME=FILE of .npy, .npz or .json."
)

_PICTURE_CAMERA_ROLES: Final = ("image_view", "image_intrinsics")

ARRAY_SUFFIXES: Final = (".npy", ".npz", ".json")
"""Suffixes of files that hold the values of a track."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """The values of one model input over the frames.

    Attributes:
        input_name: The tensor's name, or its role.
        values: One value of the input, or one per frame along the first axis.
        where: The option of the values, for error messages.
        sweep: Whether ``values`` are the first and the last value, with even steps between.
    """

    input_name: str
    values: Shaped[np.ndarray, "..."]
    where: str
    sweep: bool = False

    def frames(self, shape: tuple[int, ...]) -> int:
        """Return the number of frames for which an input track has values; 1 for a constant."""
        if self.sweep or self.values.size == math.prod(shape):
            return 1
        row_size = math.prod(self.values.shape[1:])
        if self.values.ndim and len(self.values) and row_size == math.prod(shape):
            return len(self.values)
        expected = ", ".join(map(str, shape))
        raise ConfigInvalid(
            f"has shape {list(self.values.shape)}, expected [{expected}] or [frames, {expected}] "
            f"for input {self.input_name}",
            where=self.where,
        )

    def value_at(
        self, shape: tuple[int, ...], number: int, frames: int
    ) -> Shaped[np.ndarray, "..."]:
        """Return the value of a model input in one frame of a video.

        A track with fewer values than frames repeats.
        """
        length = self.frames(shape)
        if self.sweep:
            low, high = self.values
            share = number / (frames - 1) if frames > 1 else 0.0
            return np.full(shape, low + (high - low) * share)
        if length == 1:
            return self.values.reshape(shape)
        return np.asarray(self.values[number % length]).reshape(shape)


def input_track(text: str) -> Track:
    """Parse the value of ``--input``, for example ``time=0..1``."""
    input_name, equals_sign, value = text.partition("=")
    where = f"--input {input_name}"
    if not (input_name and equals_sign and value):
        raise ConfigInvalid(
            f"{text!r} has no name or no value", where="--input", hint=_ACCEPTED_FORMS_HINT
        )
    if Path(value).suffix.lower() in ARRAY_SUFFIXES:
        return Track(input_name, read_array(Path(value)), f"{where}={value}")
    first, separator, last = value.partition("..")
    if separator:
        return Track(input_name, _parse_number_list(text, f"{first},{last}"), where, sweep=True)
    return Track(input_name, _parse_number_list(text, value), where)


def _parse_number_list(text: str, part: str) -> Shaped[np.ndarray, " n"]:
    try:
        numbers = [float(input_name) for input_name in part.split(",")]
    except ValueError as error:
        raise ConfigInvalid(
            f"{text!r}: {error}", where="--input", hint=_ACCEPTED_FORMS_HINT
        ) from error
    return integers_if_whole(np.asarray(numbers))


def integers_if_whole(values: Shaped[np.ndarray, "..."]) -> Shaped[np.ndarray, "..."]:
    """Convert an array of whole numbers to integers, which integer inputs need."""
    with np.errstate(invalid="ignore"):
        whole = values.astype(np.int64)
    return whole if np.array_equal(whole, values) else values


def read_array(path: Path) -> Shaped[np.ndarray, "..."]:
    """Read an array from an .npy, an .npz with one array, or a .json of nested lists."""
    try:
        if path.suffix.lower() == ".json":
            array = np.asarray(json.loads(path.read_text("utf-8")))
        else:
            array = _load_only_array(path)
    except ArraysUnreadable as error:
        raise ConfigInvalid(error.message, where=str(path)) from error
    except OSError as error:
        message = f"cannot be read: {error.strerror or error}"
        raise ConfigInvalid(message, where=str(path)) from error
    except (ValueError, EOFError, RecursionError) as error:
        raise ConfigInvalid(f"cannot be read: {error}", where=str(path)) from error
    return numbers_of(array, str(path))


def _load_only_array(path: Path) -> Shaped[np.ndarray, "..."]:
    arrays = read_array_file(path)
    if len(arrays) != 1:
        raise ValueError(f"the .npz has {len(arrays)} arrays, expected one")
    return next(iter(arrays.values()))


def numbers_of(array: Shaped[np.ndarray, "..."], where: str) -> Shaped[np.ndarray, "..."]:
    """Check that an array holds finite numbers; convert an array of whole numbers to integers."""
    if array.dtype.kind not in "iuf" or not array.size:
        message = f"holds {array.dtype} {list(array.shape)}, expected numbers"
        raise ConfigInvalid(message, where=where)
    if not np.isfinite(array).all():
        count = int((~np.isfinite(array)).sum())
        raise ConfigInvalid(
            f"the array has {count} non-finite values, expected finite numbers", where=where
        )
    return integers_if_whole(array)


def require_pictures(sources: Sequence[Source], tracks: Sequence[Track]) -> None:
    """Raise if a scene is computed from pictures that are not given.

    Raises:
        ConfigInvalid: An input of pictures, or of their cameras without a default, has no value.
    """
    for source in sources:
        given = {spec.name for track in tracks for spec in source.named(track.input_name)}
        missing_inputs = [spec for spec in source.inputs if spec.name not in given]
        for spec in missing_inputs:
            if spec.role == "image":
                count = source.shape(spec.name)[0]
                names = ",".join(f"{number}.png" for number in range(1, min(count, 4) + 1))
                raise ConfigInvalid(
                    f"is computed from {counted_pictures(count)}, which are not given",
                    where=source.name,
                    hint=f"Give --image {names}",
                )
            if spec.role in _PICTURE_CAMERA_ROLES and spec.default is None:
                raise ConfigInvalid(
                    f"has no default for the cameras of its pictures, the input {spec.name!r}",
                    where=source.name,
                    hint="Give a file of cameras, such as --image-cameras transforms.json",
                )


def counted_pictures(count: int) -> str:
    """Return a number of pictures in words."""
    return "1 picture" if count == 1 else f"{count} pictures"
