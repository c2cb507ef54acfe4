"""Tracks: what an input is fed frame after frame, as people type it."""

__all__ = ["Track", "input_track"]

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np
from jaxtyping import Shaped

from gsgen.contract.errors import ConfigInvalid

_FORMS: Final = (
    "Give NAME=NUMBER, NAME=A,B,… , NAME=FROM..TO, or NAME=FILE of .npy, .npz or .json."
)
_SUFFIXES: Final = (".npy", ".npz", ".json")


@final
@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Values of one input.

    Attributes:
        word: The tensor's name, or its role.
        values: One value of the input, or one after the other along the first axis.
        where: What an error calls it.
        sweep: ``values`` is where a film begins and where it ends; between them it goes evenly.
    """

    word: str
    values: Shaped[np.ndarray, "..."]
    where: str
    sweep: bool = False

    def frames(self, shape: tuple[int, ...]) -> int:
        """Return for how many frames there are values; 1 where one is for all.

        Raises:
            ConfigInvalid: They do not fill an input of that shape.
        """
        if self.sweep or self.values.size == math.prod(shape):
            return 1
        row_size = math.prod(self.values.shape[1:])
        if self.values.ndim and len(self.values) and row_size == math.prod(shape):
            return len(self.values)
        expected = ", ".join(map(str, shape))
        raise ConfigInvalid(
            f"has shape {list(self.values.shape)}, and input {self.word} takes [{expected}], "
            f"or [frames, {expected}]",
            where=self.where,
        )

    def at(
        self, shape: tuple[int, ...], number: int, frames: int
    ) -> Shaped[np.ndarray, "..."]:
        """Return the value of a frame; a track that is shorter than the film repeats.

        Args:
            shape: Of the input.
            number: Of the frame, from 0.
            frames: Of the film.
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
    """Read what a user typed for ``--input``.

    Raises:
        ConfigInvalid: It is none of the forms, or a file that cannot be read.
    """
    word, sign, value = text.partition("=")
    where = f"--input {word}"
    if not (word and sign and value):
        raise ConfigInvalid(
            f"{text!r} has no name or no value", where="--input", hint=_FORMS
        )
    if Path(value).suffix.lower() in _SUFFIXES:
        return Track(word, read_array(Path(value)), f"{where}={value}")
    first, dots, last = value.partition("..")
    if dots:
        return Track(word, _numbers(text, f"{first},{last}"), where, sweep=True)
    return Track(word, _numbers(text, value), where)


def _numbers(text: str, part: str) -> Shaped[np.ndarray, " n"]:
    try:
        numbers = [float(word) for word in part.split(",")]
    except ValueError as error:
        raise ConfigInvalid(f"{text!r}: {error}", where="--input", hint=_FORMS) from error
    return whole_if_so(np.asarray(numbers))


def whole_if_so(values: Shaped[np.ndarray, "..."]) -> Shaped[np.ndarray, "..."]:
    """Return whole numbers as integers, so that inputs that count things take them."""
    with np.errstate(invalid="ignore"):
        whole = values.astype(np.int64)
    return whole if np.array_equal(whole, values) else values


def read_array(path: Path) -> Shaped[np.ndarray, "..."]:
    """Read the array of an .npy, of an .npz that has no other, or of a .json of nested lists.

    Raises:
        ConfigInvalid: It cannot be read, or holds no numbers.
    """
    try:
        if path.suffix.lower() == ".json":
            array = np.asarray(json.loads(path.read_text("utf-8")))
        else:
            array = _loaded(path)
    except OSError as error:
        message = f"cannot be read: {error.strerror or error}"
        raise ConfigInvalid(message, where=str(path)) from error
    except (ValueError, EOFError, RecursionError) as error:
        raise ConfigInvalid(f"cannot be read: {error}", where=str(path)) from error
    return numbers_of(array, str(path))


def _loaded(path: Path) -> Shaped[np.ndarray, "..."]:
    with path.open("rb") as file:
        array = np.load(file, allow_pickle=False)
        if isinstance(array, np.ndarray):
            return array
        if len(array.files) != 1:
            raise ValueError(f"it has {len(array.files)} arrays, wanted one")
        return np.asarray(array[array.files[0]])


def numbers_of(array: Shaped[np.ndarray, "..."], where: str) -> Shaped[np.ndarray, "..."]:
    """Return an array of finite numbers, whole ones as integers.

    Raises:
        ConfigInvalid: It is none.
    """
    if array.dtype.kind not in "iuf" or not array.size:
        message = f"holds {array.dtype} {list(array.shape)}, wanted numbers"
        raise ConfigInvalid(message, where=where)
    if not np.isfinite(array).all():
        count = int((~np.isfinite(array)).sum())
        raise ConfigInvalid(f"has {count} numbers that are not finite", where=where)
    return whole_if_so(array)
