"""The score of a film: what each model is fed in each frame."""

__all__ = ["AnimatedInputs", "Timeline"]

from collections.abc import Sequence
from typing import Protocol, final

import numpy as np
from jaxtyping import Int64, Shaped

from gsgen.contract.errors import ConfigInvalid, UnknownName
from gsgen.contract.spec.manifest import Input
from gsgen.contract.spec.roles import ROLES
from gsgen.runtime.playback.input_tracks import Track
from gsgen.runtime.sources.source import Values


class AnimatedInputs(Protocol):
    """What can be fed: a source, or a post-process model."""

    @property
    def inputs(self) -> Sequence[Input]:
        """What may be fed to it."""

    def named(self, word: str) -> list[Input]:
        """Return the inputs that a word means."""

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an input."""


@final
class Timeline:
    """Values for each model and each frame.

    What no track names moves by itself where there are several frames: a time goes through its
    range, and a frame number counts.

    Args:
        takers: Who is fed.
        tracks: What they are fed.
        time: Of all frames; None to go through the range.

    Raises:
        ConfigInvalid: A time is asked of models that have none, or a track does not fit.
        UnknownName: No model has the input of a track.
    """

    def __init__(
        self,
        takers: Sequence[AnimatedInputs],
        tracks: Sequence[Track],
        time: float | None = None,
    ) -> None:
        self._takers, self._tracks, self._time = list(takers), list(tracks), time
        if time is not None and not any(_of_role(taker, "time") for taker in takers):
            raise ConfigInvalid("no scene has a time", where="--time")
        self._lengths = [self._length(track) for track in tracks]

    def _length(self, track: Track) -> int:
        """Return how many values a track has, as those who take it see it."""
        shapes = [
            taker.shape(spec.name)
            for taker in self._takers
            for spec in taker.named(track.word)
        ]
        if not shapes:
            known = {
                word
                for taker in self._takers
                for spec in taker.inputs
                for word in (spec.name, spec.role)
            }
            raise UnknownName.among("input", track.word, known, track.where)
        return max(track.frames(shape) for shape in shapes)

    @property
    def frames(self) -> int:
        """For how many frames there are values: those of the longest track, or 1."""
        return max(self._lengths, default=1)

    @property
    def moving(self) -> bool:
        """Whether models are fed other values in other frames of a film."""
        sweeps = any(track.sweep for track in self._tracks)
        playing = any(self._playing(taker) for taker in self._takers)
        return self.frames > 1 or sweeps or playing

    def values(self, number: int, frames: int) -> list[Values]:
        """Return what each model is fed.

        Args:
            number: Of the frame, from 0.
            frames: Of the film.
        """
        return [self._values(taker, number, frames) for taker in self._takers]

    def _values(self, taker: AnimatedInputs, number: int, frames: int) -> Values:
        values: dict[str, object] = {}
        if frames > 1:
            for spec, ends in self._playing(taker):
                values[spec.name] = _moment(spec, ends, number, frames)
        if self._time is not None:
            values |= {spec.name: self._time for spec in _of_role(taker, "time")}
        for track in self._tracks:
            for spec in taker.named(track.word):
                value = track.at(taker.shape(spec.name), number, frames)
                counting = track.sweep and ROLES[spec.role].index
                values[spec.name] = _counting(value) if counting else value
        return values

    def _playing(self, taker: AnimatedInputs) -> list[tuple[Input, tuple[float, float]]]:
        """Return what goes on by itself, from where to where: times, else frame numbers."""
        fixed_names = {
            spec.name for track in self._tracks for spec in taker.named(track.word)
        }
        if self._time is not None:
            fixed_names |= {spec.name for spec in _of_role(taker, "time")}
        times, numbers = (
            [spec for spec in _of_role(taker, role) if spec.name not in fixed_names]
            for role in ("time", "frame_index")
        )
        return [(spec, spec.range) for spec in times or numbers if spec.range is not None]


def _of_role(taker: AnimatedInputs, role: str) -> list[Input]:
    return [spec for spec in taker.inputs if spec.role == role]


def _counting(value: Shaped[np.ndarray, "..."]) -> Int64[np.ndarray, "..."]:
    """Return numbers that a sweep went through as what counts things takes."""
    return np.asarray(np.rint(value), np.int64)


def _moment(spec: Input, ends: tuple[float, float], number: int, frames: int) -> object:
    """Return the time of a frame, or its number; a loop ends just before its beginning."""
    low, high = ends
    if spec.role == "frame_index":
        return int(low + number % (high - low + 1))
    steps = frames if spec.loop else frames - 1
    return low + (high - low) * number / steps
