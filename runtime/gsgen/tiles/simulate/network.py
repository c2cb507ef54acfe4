"""A simulated network: a rate that varies over time, shared by a few connections."""

__all__ = ["ByteDelivery", "RateTrace", "SimulatedLink", "VirtualClock"]

import math
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float64, Int64

_TRANSFER_EPSILON_BYTES = 1e-6  # of a byte


@final
class VirtualClock:
    """A clock for simulations, whose time stands still until the simulation advances it."""

    def __init__(self, start: float) -> None:
        self.time = start

    def now(self) -> float:
        """Return the simulated time, in seconds."""
        return self.time


@final
@dataclass(frozen=True, slots=True, eq=False)
class RateTrace:
    """The data rate of a network over time, in steps: each rate holds until the next time.

    Attributes:
        times: In seconds, ascending.
        rates: In bytes a second, 0 or more; the first holds before its time too, the last for ever.
    """

    times: Float64[np.ndarray, " n"]
    rates: Float64[np.ndarray, " n"]

    def rate(self, time: float) -> float:
        """Return the simulated network's data rate at a time, in bytes per second."""
        index = int(np.searchsorted(self.times, time, side="right")) - 1
        return float(self.rates[max(index, 0)])

    def next_change(self, time: float) -> float:
        """Return the next time at which the simulated data rate changes; infinite if never."""
        index = int(np.searchsorted(self.times, time, side="right"))
        if index == 0 and len(self.times) > 1:
            index = 1
        return float(self.times[index]) if index < len(self.times) else math.inf


@final
@dataclass(frozen=True, slots=True)
class ByteDelivery:
    """A tile that a simulated network link has delivered completely."""

    tile: int
    time: float


@final
@dataclass(slots=True)
class _PendingTransfer:
    tile: int
    start: float
    remaining: float


@final
class SimulatedLink:
    """A simulated network link: requests wait for the round trip, then share the rate equally.

    Args:
        clock: The time of requests.
        trace: The rate.
        size: Bytes of each tile.
        rtt: Seconds from a request to the first byte.
        connections: How many requests may run at once.
    """

    def __init__(
        self,
        clock: VirtualClock,
        trace: RateTrace,
        size: Int64[np.ndarray, " n"],
        *,
        rtt: float,
        connections: int,
    ) -> None:
        self._clock, self._rate_trace, self._size = clock, trace, size
        self._round_trip_seconds, self._connections = rtt, connections
        self._transfers: list[_PendingTransfer] = []

    @property
    def free_request_count(self) -> int:
        """Return how many more tile requests the simulated network link accepts now."""
        return self._connections - len(self._transfers)

    def request(self, tile: int) -> None:
        """Begin to fetch a tile over the simulated network link."""
        start = self._clock.now() + self._round_trip_seconds
        self._transfers.append(_PendingTransfer(tile, start, float(self._size[tile])))

    def progress(self, tile: int) -> float:
        """Return the fraction of a requested tile's bytes that were received so far."""
        return 1 - self._transfer(tile).remaining / max(float(self._size[tile]), 1.0)

    def cancel(self, tile: int) -> int:
        """Cancel a simulated request; return the number of bytes that were received."""
        transfer = self._transfer(tile)
        self._transfers.remove(transfer)
        return round(float(self._size[tile]) - transfer.remaining)

    def _transfer(self, tile: int) -> _PendingTransfer:
        return next(entry for entry in self._transfers if entry.tile == tile)

    def advance(self, end_time: float) -> ByteDelivery | None:
        """Advance the simulated clock to the next delivery of a tile, or to a given time.

        Returns:
            The delivery, or None where the clock reached ``end_time`` without one.
        """
        while True:
            now = self._clock.now()
            # 1. Deliver a transfer that is complete.
            active_transfers = [entry for entry in self._transfers if entry.start <= now]
            completed_transfers = [
                entry for entry in active_transfers if entry.remaining <= _TRANSFER_EPSILON_BYTES
            ]
            if completed_transfers:
                self._transfers.remove(completed_transfers[0])
                return ByteDelivery(completed_transfers[0].tile, now)
            if now >= end_time:
                return None
            # 2. Find the next moment at which a rate changes, or a transfer begins or ends.
            share = self._rate_trace.rate(now) / max(len(active_transfers), 1)
            waiting_starts = [entry.start for entry in self._transfers if entry.start > now]
            moment = min([end_time, self._rate_trace.next_change(now), *waiting_starts])
            if active_transfers and share > 0:
                least = min(entry.remaining for entry in active_transfers)
                moment = min(moment, max(now + least / share, math.nextafter(now, math.inf)))
            # 3. Move all transfers to that moment; until then each has an equal share of the rate.
            for entry in active_transfers:
                received_bytes = share * (moment - now)
                remaining_bytes = entry.remaining - received_bytes
                # Rounding of a late time may leave a part of a byte.
                entry.remaining = (
                    0.0 if remaining_bytes <= 2 * share * math.ulp(moment) else remaining_bytes
                )
            self._clock.time = moment
