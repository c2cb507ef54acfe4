"""Simulates a slow or failing network: limits the rate, delays and fails responses."""

__all__ = ["FailureRule", "NetworkFaults", "parse_failure"]

import random
import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Lock
from typing import Literal, final

from gsgen.contract.errors import ConfigInvalid

Failure = int | Literal["cut", "stall"]
_FAILURE_PATTERN = re.compile(r"^(\d{3}|cut|stall):([0-9.]+)$")


@final
@dataclass(frozen=True, slots=True)
class FailureRule:
    """A kind of simulated network failure, and the fraction of responses that fail so.

    Attributes:
        failure: The status; ``cut`` ends the answer half way, ``stall`` sends nothing.
        share: Of all requests, in [0, 1].
    """

    failure: Failure
    share: float


def parse_failure(text: str) -> FailureRule:
    """Parse a simulated network failure and its probability, such as ``404:0.01``.

    Raises:
        ConfigInvalid: It says something else.
    """
    match = _FAILURE_PATTERN.match(text)
    share = float(match[2]) if match and match[2].count(".") <= 1 and match[2] != "." else 2.0
    failure = match[1] if match else ""
    status = failure.isdigit() and 400 <= int(failure) <= 599
    if not (0 <= share <= 1 and (status or failure in ("cut", "stall"))):
        raise ConfigInvalid(
            repr(text),
            where="--fail",
            hint="Write a status from 400 to 599, cut or stall, and a share: 404:0.01.",
        )
    if failure == "cut":
        return FailureRule("cut", share)
    return FailureRule("stall" if failure == "stall" else int(failure), share)


@final
@dataclass(slots=True, kw_only=True)
class NetworkFaults:
    """Simulated rate, latency and failures of responses; safe to use from many threads.

    Attributes:
        bytes_per_second: Of all answers together; None for as fast as it goes.
        latency: Seconds before an answer begins.
        failures: Shares of answers that fail.
        seed: Of the choice which fail.
        clock: Gives seconds; tests give their own.
        sleep: Waits for seconds.
    """

    bytes_per_second: float | None = None
    latency: float = 0.0
    failures: tuple[FailureRule, ...] = ()
    seed: int = 0
    clock: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep
    _lock: Lock = field(default_factory=Lock)
    _random_source: random.Random = field(init=False)
    _link_free_time: float = 0.0

    def __post_init__(self) -> None:
        self._random_source = random.Random(self.seed)

    def choose(self) -> Failure | None:
        """Return the simulated failure of the next response; None if it succeeds."""
        with self._lock:
            value = self._random_source.random()
        for rule in self.failures:
            if value < rule.share:
                return rule.failure
            value -= rule.share
        return None

    def wait_to_begin(self) -> None:
        """Wait for the simulated latency before a response begins."""
        if self.latency > 0:
            self.sleep(self.latency)

    def wait_to_send(self, count: int) -> None:
        """Wait until the simulated network link has carried a response's next bytes."""
        if self.bytes_per_second is None:
            return
        with self._lock:
            now = self.clock()
            self._link_free_time = max(self._link_free_time, now) + count / self.bytes_per_second
            wait = self._link_free_time - now
        self.sleep(wait)
