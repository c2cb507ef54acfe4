"""Measures the GPU time of each stage of a frame by timestamps."""

__all__ = ["StageClock"]

from typing import Final, final

import numpy as np

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Encoder, PassTimestamps
from gsgen.runtime.gpu.native import timestamp_period

_MAX_STAGES: Final = 64  # stages of a frame; there are about ten
_TIMESTAMP_BYTES: Final = 8  # bytes of a timestamp
_SECONDS_PER_NANOSECOND: Final = 1e-9


@final
class StageClock:
    """GPU timestamps before and after each stage of a frame.

    The timestamps of software drivers may stand still: then every stage takes 0 seconds.

    Args:
        device: A device with timestamps; see ``Device.has_clock``.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        raw = device.raw
        self._query_set = raw.create_query_set(
            label="stage clock", type="timestamp", count=2 * _MAX_STAGES
        )
        self._resolve_buffer = raw.create_buffer(
            label="stage clock",
            size=2 * _MAX_STAGES * _TIMESTAMP_BYTES,
            usage="QUERY_RESOLVE|COPY_SRC",
        )
        self._seconds_per_tick = timestamp_period(raw)
        self._stage_names: list[str] = []

    def begin(self) -> None:
        """Clear the recorded stages of the GPU timer for a new frame."""
        self._stage_names.clear()

    def timestamp_writes(self, stage: str) -> PassTimestamps:
        """Return the ``timestamp_writes`` of the compute or render pass of a stage."""
        index = 2 * len(self._stage_names)
        self._stage_names.append(stage)
        return {
            "query_set": self._query_set,
            "beginning_of_pass_write_index": index,
            "end_of_pass_write_index": index + 1,
        }

    def encode(self, encoder: Encoder) -> None:
        """Encode the copy of all GPU timestamp query results into a readable buffer."""
        if self._stage_names:
            count = 2 * len(self._stage_names)
            encoder.resolve_query_set(self._query_set, 0, count, self._resolve_buffer, 0)

    def seconds(self) -> dict[str, float]:
        """Return the GPU seconds of each stage of the last frame; passes of one name are added."""
        timestamps = self._device.read(self._resolve_buffer, np.uint64, 2 * len(self._stage_names))
        stage_seconds = (
            timestamps[1::2].astype(np.int64) - timestamps[::2].astype(np.int64)
        ) * self._seconds_per_tick
        seconds = dict.fromkeys(self._stage_names, 0.0)
        for name, span in zip(self._stage_names, stage_seconds, strict=True):
            seconds[name] += float(span) * _SECONDS_PER_NANOSECOND
        return seconds
