"""The input values of each frame of a bake, from numbers, arrays, files and ranges."""

__all__ = ["FrameValues", "number_range"]

import math
from collections.abc import Mapping, Sequence
from typing import Final, final

import numpy as np
from jaxtyping import Float64

from gsgen.contract.errors import ConfigInvalid, UnknownName
from gsgen.contract.spec.fields.roles import ROLES
from gsgen.contract.spec.manifest import Input
from gsgen.runtime.playback.input_tracks import Track
from gsgen.runtime.sources.source import GeneratorSource

_MAX_FRAMES: Final = 1_000_000


def number_range(text: str, where: str) -> Float64[np.ndarray, " f"]:
    """Parse an option's value: a number, or a range FIRST:LAST:COUNT that includes both ends."""
    hint = "Give a number, or FIRST:LAST:COUNT such as 0:1:300."
    range_parts = text.split(":")
    try:
        numbers = [float(input_name) for input_name in range_parts[:2]]
        count = int(range_parts[2]) if len(range_parts) == 3 else 1
    except ValueError as error:
        raise ConfigInvalid(
            f"{text!r} is not a number or a range", where=where, hint=hint
        ) from error
    if len(range_parts) not in (1, 3) or not all(map(math.isfinite, numbers)):
        raise ConfigInvalid(f"{text!r} is not a number or a range", where=where, hint=hint)
    if not 1 <= count <= _MAX_FRAMES:
        raise ConfigInvalid(
            f"{text!r} has {count} frames, expected 1 to {_MAX_FRAMES:,}", where=where, hint=hint
        )
    return np.linspace(numbers[0], numbers[-1], count)


@final
class FrameValues:
    """The values of an ONNX generator's inputs in each frame."""

    def __init__(self, source: GeneratorSource, tracks: Sequence[Track]) -> None:
        self._source = source
        self._tracks = [(spec, track) for track in tracks for spec in _inputs_of(source, track)]
        lengths = {
            track.where: track.frames(source.shape(spec.name)) for spec, track in self._tracks
        }
        self.frames = max(lengths.values(), default=1)
        mismatched_inputs = [
            where for where, length in lengths.items() if length not in (1, self.frames)
        ]
        if mismatched_inputs:
            longest_input = max(lengths, key=lambda where: lengths[where])
            raise ConfigInvalid(
                f"has {lengths[mismatched_inputs[0]]} frames, expected 1 or {self.frames} as {longest_input}",
                where=mismatched_inputs[0],
                hint="Give all ranges the same number of frames.",
            )
        for spec, track in self._tracks:
            _require_value_range(spec, track)

    def values_of_frame(self, number: int) -> Mapping[str, object]:
        """Return the input values of frame ``number``, from 0, by tensor name."""
        values: dict[str, object] = {}
        for spec, track in self._tracks:
            value = track.value_at(self._source.shape(spec.name), number, self.frames)
            index = ROLES[spec.role].index
            values[spec.name] = np.rint(value).astype(np.int64) if index else value
        return values

    def time(self, number: int) -> float | None:
        """Return the time input's value in frame ``number`` or its default; None if neither."""
        spec = self._source.time
        if spec is None:
            return None
        if spec.name in self.values_of_frame(number):
            return float(np.asarray(self.values_of_frame(number)[spec.name]).reshape(-1)[0])
        return float(spec.default) if isinstance(spec.default, int | float) else None


def _inputs_of(source: GeneratorSource, track: Track) -> list[Input]:
    matches = source.named(track.input_name)
    if matches:
        return matches
    known_names = {input_name for spec in source.inputs for input_name in (spec.name, spec.role)}
    if track.input_name == "time":
        raise ConfigInvalid(
            f"{source.name} has no time input; its inputs are {', '.join(sorted(known_names)) or 'none'}",
            where=track.where,
            hint="Leave --time out, or set another input with --input NAME=VALUE.",
        )
    raise UnknownName.among("input", track.input_name, known_names, track.where)


def _require_value_range(spec: Input, track: Track) -> None:
    """Raise if a time or an index input is outside the range that the manifest declares."""
    if spec.range is None or not (spec.role == "time" or ROLES[spec.role].index):
        return
    low, high = spec.range
    tolerance = 1e-6 * (high - low)  # a range in decimal text may end one rounding beyond
    values = np.asarray(track.values, np.float64)
    out_of_range = values[
        (values < low - tolerance) | (values > high + tolerance) | ~np.isfinite(values)
    ]
    if out_of_range.size:
        raise ConfigInvalid(
            f"is {out_of_range.flat[0]:g} for input {spec.name}, expected {low:g} to {high:g}",
            where=track.where,
            hint="The manifest declares this range: `gsgen inspect` shows it.",
        )
