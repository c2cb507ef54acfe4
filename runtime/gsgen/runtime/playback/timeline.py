"""The timeline of a playback: the input values of each model in each frame."""

__all__ = ["AnimatedInputs", "Timeline", "camera_time_tracks"]

from collections.abc import Sequence
from typing import Protocol, final

import numpy as np
from jaxtyping import Int64, Shaped

from gsgen.contract.errors import ConfigInvalid, UnknownName
from gsgen.contract.spec.fields.roles import ROLES
from gsgen.contract.spec.manifest import Input
from gsgen.runtime.playback.camera_options import Viewpoint
from gsgen.runtime.playback.input_tracks import Track
from gsgen.runtime.sources.key_frames import Animation, Span
from gsgen.runtime.sources.source import Values


class AnimatedInputs(Protocol):
    """A model whose inputs a timeline sets: a source of Gaussians, or a post-process model."""

    @property
    def inputs(self) -> Sequence[Input]:
        """The model inputs that a caller may set."""

    @property
    def animation(self) -> Animation | None:
        """The timeline of a scene file that the inputs follow; None without."""

    def named(self, input_name: str) -> list[Input]:
        """Return the model inputs with this tensor name, or else with this input role."""

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an input tensor."""


@final
class Timeline:
    """The input values of each model in each frame.

    Over several frames, inputs without a track advance by themselves: a time goes through its
    range, and a frame number counts. In a scene with a timeline, key frames precede them.

    Attributes:
        tracks: Values that the user gave.
    """

    def __init__(
        self, models: Sequence[AnimatedInputs], tracks: Sequence[Track], time: float | None = None
    ) -> None:
        self._models, self.tracks, self._time = list(models), list(tracks), time
        if time is not None and not any(_inputs_of_role(model, "time") for model in models):
            raise ConfigInvalid(
                f"the time is {time}, but no scene has a time input",
                where="--time",
                hint="Leave the option out.",
            )
        self._track_lengths = [self._track_length(track) for track in tracks]

    def _track_length(self, track: Track) -> int:
        """Return the number of frames of an input track, by the shapes of the track's inputs."""
        shapes = [
            model.shape(spec.name)
            for model in self._models
            for spec in model.named(track.input_name)
        ]
        if not shapes:
            known_names = {
                input_name
                for model in self._models
                for spec in model.inputs
                for input_name in (spec.name, spec.role)
            }
            raise UnknownName.among("input", track.input_name, known_names, track.where)
        return max(track.frames(shape) for shape in shapes)

    @property
    def frames(self) -> int:
        """The number of frames of the longest input track (values per frame); 1 without tracks."""
        return max(self._track_lengths, default=1)

    @property
    def span(self) -> Span | None:
        """The timeline of the first scene file that has one; None without."""
        animations = (model.animation for model in self._models)
        return next((animation.span for animation in animations if animation), None)

    @property
    def is_animated(self) -> bool:
        """Whether the value of any model input differs between the frames of a video."""
        has_sweep = any(track.sweep for track in self.tracks)
        has_advancing_input = any(self._advancing_inputs(model) for model in self._models)
        return self.frames > 1 or has_sweep or has_advancing_input or self.span is not None

    def values(self, number: int, frames: int) -> list[Values]:
        """Return the input values of each model in frame ``number``, from 0, of ``frames``."""
        return [self._values(model, number, frames) for model in self._models]

    def _values(self, model: AnimatedInputs, number: int, frames: int) -> Values:
        values: dict[str, object] = {}
        if model.animation is not None:
            values |= self._animated_values(model, model.animation, number, frames)
        elif frames > 1:
            for spec, ends in self._advancing_inputs(model):
                values[spec.name] = _time_value_of_frame(spec, ends, number, frames)
        if self._time is not None:
            values |= {spec.name: self._time for spec in _inputs_of_role(model, "time")}
        for track in self.tracks:
            for spec in model.named(track.input_name):
                value = track.value_at(model.shape(spec.name), number, frames)
                is_counter = track.sweep and ROLES[spec.role].index
                values[spec.name] = _round_to_integers(value) if is_counter else value
        return values

    def _animated_values(
        self, model: AnimatedInputs, animation: Animation, number: int, frames: int
    ) -> Values:
        """Return the values of key frames; times without any go through their range once."""
        seconds = animation.span.seconds_of(number, frames)
        share = seconds / animation.span.seconds
        values: dict[str, object] = {}
        for spec, (low, high) in self._advancing_inputs(model):
            if spec.role == "frame_index":  # each number lasts as long as the others
                values[spec.name] = int(min(low + (high - low + 1) * share, high))
            else:
                values[spec.name] = low + (high - low) * share
        roles = {spec.name: spec.role for spec in model.inputs}
        for name, keys in animation.keys.items():
            numbers = keys.at(seconds).reshape(model.shape(name))
            is_index = ROLES[roles[name]].index
            values[name] = _round_to_integers(np.floor(numbers + 0.5)) if is_index else numbers
        return values

    def _advancing_inputs(self, model: AnimatedInputs) -> list[tuple[Input, tuple[float, float]]]:
        """Return a model's inputs of time or frame number, which advance where no value is given."""
        fixed_names = {spec.name for track in self.tracks for spec in model.named(track.input_name)}
        if self._time is not None:
            fixed_names |= {spec.name for spec in _inputs_of_role(model, "time")}
        times, numbers = (
            [spec for spec in _inputs_of_role(model, role) if spec.name not in fixed_names]
            for role in ("time", "frame_index")
        )
        return [(spec, spec.range) for spec in times or numbers if spec.range is not None]


def _inputs_of_role(model: AnimatedInputs, role: str) -> list[Input]:
    return [spec for spec in model.inputs if spec.role == role]


def _round_to_integers(value: Shaped[np.ndarray, "..."]) -> Int64[np.ndarray, "..."]:
    """Round interpolated values for an integer input, such as a frame number."""
    return np.asarray(np.rint(value), np.int64)


def _time_value_of_frame(
    spec: Input, ends: tuple[float, float], number: int, frames: int
) -> object:
    """Return the time or frame number of a video frame; loops leave out the end of the range."""
    low, high = ends
    if spec.role == "frame_index":
        return int(low + number % (high - low + 1))
    steps = frames if spec.loop else frames - 1
    return low + (high - low) * number / steps


def camera_time_tracks(
    view: Viewpoint,
    models: Sequence[AnimatedInputs],
    tracks: Sequence[Track] = (),
    time: float | None = None,
) -> tuple[list[Track], tuple[str, ...]]:
    """Return the tracks of a camera file's times, and notes on times that are not used.

    ``tracks`` and ``time`` of the caller take precedence: with a time among them, those of the
    camera file are left out.
    """
    if not view.times or time is not None:
        return [], ()
    if not any(spec.role == "time" for model in models for spec in model.inputs):
        return [], ("not used: the times of the cameras, because no scene has a time input",)
    set_roles = {
        spec.role for track in tracks for model in models for spec in model.named(track.input_name)
    }
    if "time" in set_roles:
        return [], ()
    return [Track("time", np.array(view.times), "--camera")], ()
