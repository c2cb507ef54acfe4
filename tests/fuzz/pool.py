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
        workers = [self._hire() for _ in range(min(self.jobs, len(todo)))]
        try:
            while workers:
                for key, _ in self._ready.select(timeout=0.5):
                    yield from self._heard(key.data, workers)
                for worker in list(workers):
                    yield from self._late(worker, workers)
        finally:
            for worker in workers:
                self._dismiss(worker, hands=[])

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
        worker = _Hand(process, errors, time.monotonic())
        assert process.stdout is not None
        self._ready.register(process.stdout, selectors.EVENT_READ, worker)
        return worker

    def _dismiss(self, worker: _Hand, hands: list[_Hand]) -> tuple[int, str]:
        """Let go of a process; return its exit status and its last words."""
        assert worker.process.stdout is not None
        assert worker.process.stdin is not None
        self._ready.unregister(worker.process.stdout)
        status = worker.stop()
        worker.errors.seek(0)
        last = worker.errors.read()[-2000:].decode(errors="replace")
        for stream in (worker.process.stdout, worker.process.stdin, worker.errors):
            with contextlib.suppress(BrokenPipeError):
                stream.close()
        if worker in hands:
            hands.remove(worker)
        return status, last

    def _heard(self, worker: _Hand, hands: list[_Hand]) -> Iterator[dict[str, Any]]:
        assert worker.process.stdout is not None
        chunk = os.read(worker.process.stdout.fileno(), 1 << 16)
        if not chunk:
            status, last = self._dismiss(worker, hands)
            if not worker.ready:
                raise RuntimeError(f"a worker did not start: exit status {status}: {last}")
            if worker.case is not None:
                yield _lost_worker_record(
                    worker, f"the validator's process ended with {status}: {last}"
                )
                self._replace(hands)
            return
        worker.text += chunk
        *lines, worker.text = worker.text.split(b"\n")
        for line in lines:
            document = json.loads(line)
            if "ready" in document:
                worker.ready = True
            else:
                worker.case = None
                yield document
                if document["failures"]:  # what went wrong must not colour the next case
                    self._dismiss(worker, hands)
                    self._replace(hands)
                    return
            self._next(worker, hands)

    def _next(self, worker: _Hand, hands: list[_Hand]) -> None:
        if not self._todo or time.monotonic() > self._deadline:
            self._dismiss(worker, hands)
            return
        worker.case, worker.since = self._todo.pop(), time.monotonic()
        assert worker.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # if it ended, its output tells so
            worker.process.stdin.write(f"{worker.case}\n".encode())
            worker.process.stdin.flush()

    def _replace(self, hands: list[_Hand]) -> None:
        if self._todo and time.monotonic() < self._deadline:
            hands.append(self._hire())

    def _late(self, worker: _Hand, hands: list[_Hand]) -> Iterator[dict[str, Any]]:
        elapsed = time.monotonic() - worker.since
        if not worker.ready and elapsed > _START:
            raise RuntimeError(f"a worker was not ready after {_START:g} s")
        if worker.ready and worker.case is not None and elapsed > self.limit:
            self._dismiss(worker, hands)
            yield _lost_worker_record(worker, f"still busy after {self.limit:g} s")
            self._replace(hands)


def _lost_worker_record(worker: _Hand, reason: str) -> dict[str, Any]:
    """Return what stands in the log for a case that gave no verdict."""
    seconds = round(time.monotonic() - worker.since, 4)
    facts = {"verdict": "lost", "ran": False, "mutations": [], "failures": [reason]}
    return {"case": worker.case, "seconds": seconds, **facts}
