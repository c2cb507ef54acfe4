"""Processes that judge mutants side by side; one that hangs or dies is replaced, and told of."""

__all__ = ["Pool"]

import contextlib
import json
import os
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

# A case may use the five seconds that ONNX Runtime has, and as much again three times over.
LIMIT = 20.0
_START = 120.0


@dataclass(slots=True)
class _Hand:
    """One process: what it is busy with, and since when."""

    process: "subprocess.Popen[bytes]"
    errors: IO[bytes]
    since: float
    case: int | None = None
    ready: bool = False
    text: bytes = b""

    def stop(self) -> int:
        """End it and all that it started; return its exit status."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        return self.process.wait()


@dataclass(slots=True)
class Pool:
    """Workers for the cases of one seed.

    Attributes:
        seed: The seed.
        jobs: How many processes.
        worker: The module that each runs.
        limit: Seconds that a case may take.
    """

    seed: int
    jobs: int
    worker: str = "fuzz.worker"
    limit: float = LIMIT
    _todo: list[int] = field(default_factory=list)
    _deadline: float = 0.0
    _ready: selectors.BaseSelector = field(default_factory=selectors.DefaultSelector)

    def judged(self, todo: Sequence[int], deadline: float) -> Iterator[dict[str, Any]]:
        """Judge the cases ``todo`` and yield what became of each, until ``deadline``."""
        self._todo, self._deadline = list(reversed(todo)), deadline
        hands = [self._hire() for _ in range(min(self.jobs, len(todo)))]
        try:
            while hands:
                for key, _ in self._ready.select(timeout=0.5):
                    yield from self._heard(key.data, hands)
                for hand in list(hands):
                    yield from self._late(hand, hands)
        finally:
            for hand in hands:
                self._dismiss(hand, hands=[])

    def _hire(self) -> _Hand:
        errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the process
        paths = [str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
        process = subprocess.Popen(
            [sys.executable, "-m", self.worker, str(self.seed)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            start_new_session=True,
            env=os.environ
            | {"PYTHONPATH": os.pathsep.join(paths).rstrip(":"), "OMP_NUM_THREADS": "1"},
        )
        hand = _Hand(process, errors, time.monotonic())
        assert process.stdout is not None
        self._ready.register(process.stdout, selectors.EVENT_READ, hand)
        return hand

    def _dismiss(self, hand: _Hand, hands: list[_Hand]) -> tuple[int, str]:
        """Let go of a process; return its exit status and its last words."""
        assert hand.process.stdout is not None
        assert hand.process.stdin is not None
        self._ready.unregister(hand.process.stdout)
        status = hand.stop()
        hand.errors.seek(0)
        last = hand.errors.read()[-2000:].decode(errors="replace")
        for stream in (hand.process.stdout, hand.process.stdin, hand.errors):
            with contextlib.suppress(BrokenPipeError):
                stream.close()
        if hand in hands:
            hands.remove(hand)
        return status, last

    def _heard(self, hand: _Hand, hands: list[_Hand]) -> Iterator[dict[str, Any]]:
        assert hand.process.stdout is not None
        chunk = os.read(hand.process.stdout.fileno(), 1 << 16)
        if not chunk:
            status, last = self._dismiss(hand, hands)
            if not hand.ready:
                raise RuntimeError(f"a worker did not start: exit status {status}: {last}")
            if hand.case is not None:
                yield _lost(hand, f"the validator's process ended with {status}: {last}")
                self._replace(hands)
            return
        hand.text += chunk
        *lines, hand.text = hand.text.split(b"\n")
        for line in lines:
            document = json.loads(line)
            if "ready" in document:
                hand.ready = True
            else:
                hand.case = None
                yield document
                if document["failures"]:  # what went wrong must not colour the next case
                    self._dismiss(hand, hands)
                    self._replace(hands)
                    return
            self._next(hand, hands)

    def _next(self, hand: _Hand, hands: list[_Hand]) -> None:
        if not self._todo or time.monotonic() > self._deadline:
            self._dismiss(hand, hands)
            return
        hand.case, hand.since = self._todo.pop(), time.monotonic()
        assert hand.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # if it ended, its output tells so
            hand.process.stdin.write(f"{hand.case}\n".encode())
            hand.process.stdin.flush()

    def _replace(self, hands: list[_Hand]) -> None:
        if self._todo and time.monotonic() < self._deadline:
            hands.append(self._hire())

    def _late(self, hand: _Hand, hands: list[_Hand]) -> Iterator[dict[str, Any]]:
        spent = time.monotonic() - hand.since
        if not hand.ready and spent > _START:
            raise RuntimeError(f"a worker was not ready after {_START:g} s")
        if hand.ready and hand.case is not None and spent > self.limit:
            self._dismiss(hand, hands)
            yield _lost(hand, f"still busy after {self.limit:g} s")
            self._replace(hands)


def _lost(hand: _Hand, why: str) -> dict[str, Any]:
    """Return what stands in the log for a case that gave no verdict."""
    seconds = round(time.monotonic() - hand.since, 4)
    facts = {"verdict": "lost", "ran": False, "mutations": [], "failures": [why]}
    return {"case": hand.case, "seconds": seconds, **facts}
