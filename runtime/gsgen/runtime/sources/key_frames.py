"""The timeline of scene files: key frames, which go from one value to the next, and sound."""

__all__ = ["DEFAULT_FPS", "EASINGS", "Animation", "KeyFrames", "SceneSound", "Span"]

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, final

import numpy as np
from jaxtyping import Float64

DEFAULT_FPS: Final = 25.0
"""Frames per second, without a rate of the caller, a manifest or a scene file."""

EASINGS: Final[Mapping[str, Callable[[float], float]]] = {
    "linear": lambda share: share,
    "ease-in": lambda share: share**2,
    "ease-out": lambda share: 1 - (1 - share) ** 2,
    "ease-in-out": lambda share: share**2 * (3 - 2 * share),
    "hold": lambda share: 0.0,
}
"""How far a value is between two key frames, of the share of the time that has passed."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class KeyFrames:
    """Values at moments, and how each goes over into the next.

    Attributes:
        times: Seconds of the key frames, ascending.
        values: The numbers of each, [keys, numbers].
        easings: A key of ``EASINGS`` for the way from each to the next.
    """

    times: tuple[float, ...]
    values: Float64[np.ndarray, "keys numbers"]
    easings: tuple[str, ...]

    def at(self, seconds: float) -> Float64[np.ndarray, " numbers"]:
        """Return the numbers at a time; before the first and after the last they stand still."""
        following = next((i for i, time in enumerate(self.times) if time > seconds), None)
        if following is None or following == 0:
            return np.asarray(self.values[-1 if following is None else 0])
        first, last = self.times[following - 1], self.times[following]
        share = EASINGS[self.easings[following - 1]]((seconds - first) / (last - first))
        before, after = self.values[following - 1], self.values[following]
        return np.asarray(before + (after - before) * share)


@final
@dataclass(frozen=True, slots=True)
class Span:
    """How long a timeline is, and how it is played.

    Attributes:
        seconds: Its length.
        fps: Frames per second.
        loop: Whether its end is its start again.
    """

    seconds: float
    fps: float = DEFAULT_FPS
    loop: bool = False

    @property
    def frames(self) -> int:
        """The number of frames of a video of the timeline."""
        return max(1, round(self.seconds * self.fps) + (not self.loop))

    def seconds_of(self, number: int, frames: int) -> float:
        """Return the time of frame ``number``, from 0; loops leave out the end."""
        steps = frames if self.loop else frames - 1
        return self.seconds * number / steps if steps else 0.0


@final
@dataclass(frozen=True, slots=True, eq=False)
class Animation:
    """The timeline that a source of Gaussians follows, with key frames of its inputs.

    Attributes:
        span: The timeline.
        keys: Key frames by tensor name.
    """

    span: Span
    keys: Mapping[str, KeyFrames] = field(default_factory=dict)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SceneSound:
    """A recording that plays with a timeline, on which it keeps its place.

    Attributes:
        path: The recording; a WAV file for films.
        start: Seconds of the timeline at which it begins; below 0, its beginning is cut off.
        captions: A WebVTT file, whose times are those of the recording; None without.
    """

    path: Path
    start: float = 0.0
    captions: Path | None = None
