"""Runs a model in ONNX Runtime in a child process with limits on time and memory.

The child (:mod:`gsgen.contract.probing.sandbox_worker`) may hang, crash or be killed; the parent reads what it
managed to write and says what happened.
"""

__all__ = ["Execution", "Fault", "RowCount", "Run", "Sample", "execute"]

import errno
import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from gsgen.contract.errors import HostProcessFailed, ModelUnreadable
from gsgen.contract.model.files_beside import loaded_files, require_loadable
from gsgen.contract.model.model_file import open_model
from gsgen.contract.probing.probes import Probe
from gsgen.contract.process.drafts import temporary_folder
from gsgen.contract.process.limits import Limits, inherited_memory_limit, processor_seconds_of

_WORKER = "gsgen.contract.probing.sandbox_worker"

_HOST_FAULT_BYTES = 4096
_FILES_HINT = "Allow this process more open files, for example with `ulimit -n 1024`."

# A child that works may take this many times its time limit on a busy machine; it is looked at so
# often from then on.
_MAX_CLOCK_RATIO = 8.0
_POLL_SECONDS = 0.25

FaultStage = Literal["load", "run", "time", "memory", "crash"]


@dataclass(frozen=True, slots=True)
class Fault:
    """The reason why a model in the sandbox did not run to the end, and how to repair it."""

    stage: FaultStage
    message: str
    probe: int | None = None
    hint: str = ""


@dataclass(frozen=True, slots=True)
class RowCount:
    """The number of live Gaussians of a run, as the model gives it, and the rows of its output.

    Attributes:
        count: The number of live rows.
        capacity: The number of all rows.
        drawn: The number of live rows that are opaque enough to be drawn.
    """

    count: int
    capacity: int
    drawn: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """One distinct set of model outputs, shared by all runs that gave the same bytes.

    Attributes:
        index: Its number, counted in order of appearance.
        outputs: Output name → array, memory-mapped from the child's file.
        digest: SHA-256 over all outputs, see :func:`gsgen.contract.probing.sandbox_worker.digest_of`.
        thin: Only every so many rows were kept; at a named moment all of a faulty run, or none.
        not_finite: Outputs with a value that is NaN or infinite, where thin.
        survey: The row count at a named moment; else None.
        drawn: The drawn rows of a run for pictures, a sample of many; else None.
    """

    index: int
    outputs: dict[str, np.ndarray]
    digest: str = ""
    thin: bool = False
    not_finite: tuple[str, ...] = ()
    survey: RowCount | None = None
    drawn: np.ndarray | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One inference: its test inputs, the index of its stored outputs, and its duration.

    An extra probe may give no outputs: then ``sample`` is −1, and either ``error`` is the reason or
    ``missing_resource`` names the limit that was reached. ``center`` is where the sandbox moved the
    probe's camera to.
    """

    probe: int
    sample: int
    seconds: float
    error: str = ""
    missing_resource: Literal["", "time", "memory"] = ""
    center: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Execution:
    """All model runs of one sandbox process.

    Attributes:
        runs: Completed runs, in order.
        samples: Distinct outputs.
        fault: Why it ended early, or None.
        seconds: Wall-clock time of the child.
        version: Version of ONNX Runtime that ran.
        events: All that the child wrote down, in order.
    """

    runs: tuple[Run, ...]
    samples: tuple[Sample, ...]
    fault: Fault | None
    seconds: float
    version: str
    events: tuple[Mapping[str, Any], ...] = ()

    @property
    def session_seconds(self) -> float:
        """The seconds spent within ONNX Runtime itself: creating sessions and running models."""
        loading_times = (e["seconds"] for e in self.events if e["event"] == "loaded")
        return float(sum(loading_times)) + sum(run.seconds for run in self.runs)


@contextmanager
def execute(
    model: Path,
    outputs: Sequence[str],
    probes: Sequence[Probe],
    limits: Limits,
    worker: str = _WORKER,
    *,
    rows: str = "",
    count: str = "",
    cells: str = "",
    per_cell: int = 0,
    has_gpu: bool = False,
    trusted: bool = False,
    maps_weights: bool = False,
    has_float16_weights: bool = False,
    **options: object,
) -> Iterator[Execution]:
    """Run a model once for each set of test inputs, in order, in one sandboxed session.

    Args:
        model: The ONNX file; an empty path if the worker needs none.
        outputs: Names of the outputs to fetch.
        probes: Inputs, one set a run.
        limits: Time and memory for the child.
        worker: The module that the child runs; another one may run the model another way.
        rows: The output of packed rows, which survey probes and camera placements read.
        count: The output of the row count, which survey probes read.
        cells: The output of cells, which survey probes read.
        per_cell: Rows of each cell.
        has_gpu: Allow the worker the devices of GPUs.
        trusted: Do not confine the child, whose time alone is limited.
        maps_weights: Read weights from mapped files, without packed and folded copies.
        has_float16_weights: Some weights are float16, which ONNX Runtime converts to float32.
        options: What that worker wants to know besides; anything that JSON can hold.

    A model that is unreadable, or whose external weights must not be read, is a fault of loading;
    no child sees it.

    Raises:
        HostProcessFailed: This machine, not the model, ended the run: a full disk, no memory for the
            process, or a signal from outside.
    """
    try:
        loading_path = model if model == Path() else require_loadable(model)
    except ModelUnreadable as error:
        fault = Fault("load", error.message)
        yield Execution(runs=(), samples=(), fault=fault, seconds=0.0, version="")
        return
    readable = [] if model == Path() else loaded_files(open_model(model))
    options |= {
        "rows": rows,
        "count": count,
        "cells": cells,
        "per_cell": per_cell,
        "has_gpu": has_gpu,
        "trusted": trusted,
        "readable": [str(path) for path in readable],
        "maps_weights": maps_weights,
        "has_float16_weights": has_float16_weights,
    }
    with temporary_folder() as folder:
        try:
            _write_job(folder, loading_path, outputs, probes, limits, **options)
            start_time = time.monotonic()
            process_end = _run_child(folder, limits.seconds, worker)
            seconds = time.monotonic() - start_time
            execution = _collect_results(
                folder, process_end, seconds, limits, is_own_model=worker == _WORKER
            )
        except OSError as error:
            reason = error.strerror or str(error)
            too_many_files = error.errno in (errno.EMFILE, errno.ENFILE)
            hint = _FILES_HINT if too_many_files else ""
            raise _spool_failed_error(folder, reason, hint) from error
        yield execution


def _spool_failed_error(folder: Path, reason: str, hint: str = "") -> HostProcessFailed:
    hint = hint or "Make room there, or set TMPDIR to a folder that has some."
    message = f"inputs and outputs of the model cannot be stored: {reason}"
    return HostProcessFailed(message, where=str(folder.parent), hint=hint)


def _write_job(
    folder: Path,
    model: Path,
    outputs: Sequence[str],
    probes: Sequence[Probe],
    limits: Limits,
    **options: object,
) -> None:
    # Probes share most arrays: each is written once. Inputs go by number, since a name may be "a/b".
    numbers: dict[int, int] = {}
    for array in (array for probe in probes for array in probe.inputs.values()):
        if id(array) not in numbers:
            numbers[id(array)] = len(numbers)
            np.save(folder / f"input_{numbers[id(array)]}.npy", array, allow_pickle=False)
    job = {
        "model": str(model),
        "outputs": list(outputs),
        "probes": [[(n, numbers[id(a)]) for n, a in probe.inputs.items()] for probe in probes],
        "extra": [probe.extra for probe in probes],
        "survey": [probe.survey for probe in probes],
        "pictured": [probe.pictured for probe in probes],
        "placements": [probe.placement and asdict(probe.placement) for probe in probes],
        "optimise": [probe.optimise for probe in probes],
        "memory": limits.memory,
        "disk": limits.disk,
        "seconds": limits.seconds,
        **options,
    }
    (folder / "job.json").write_text(json.dumps(job), "utf-8")


class _ProcessEnd(NamedTuple):
    """How the sandbox's child process ended.

    Attributes:
        status: Its exit status; None at the time limit.
        host_fault: What it wrote about a fault of this machine.
    """

    status: int | None
    host_fault: str


def _run_child(folder: Path, seconds: float, worker: str) -> _ProcessEnd:
    """Run the sandbox's child process until it ends or its time is over."""
    from gsgen.contract.process.parent_watchdog import child_environment, python_command

    environment = child_environment() | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with (folder / "log").open("wb") as log:
        child = subprocess.Popen(
            [*python_command(), "-m", worker, str(folder)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,  # for a line that fits into it: a full disk holds no log
            stderr=log,
            env=environment,
            start_new_session=True,
        )
        assert child.stdout is not None
        with child.stdout:
            try:
                status = _wait(child, seconds, counts_waiting=worker != _WORKER)
                return _ProcessEnd(
                    status, child.stdout.read(_HOST_FAULT_BYTES).decode(errors="replace")
                )
            except subprocess.TimeoutExpired:
                return _ProcessEnd(None, "")
            finally:
                _stop_child(child)


def _wait(child: "subprocess.Popen[bytes]", seconds: float, *, counts_waiting: bool) -> int:
    """Wait until a child ends, and return its status.

    Unless waiting counts, as for a GPU, it gets more time where others take the processor: it may
    use ``seconds`` of processor time, within eight times as much time of the clock.

    Raises:
        subprocess.TimeoutExpired: The time is over.
    """
    deadline = time.monotonic() + _MAX_CLOCK_RATIO * seconds
    step = seconds
    while True:
        try:
            return child.wait(timeout=step)
        except subprocess.TimeoutExpired:
            is_over = counts_waiting or time.monotonic() >= deadline
            if is_over or processor_seconds_of(child.pid) >= seconds:
                raise
            step = _POLL_SECONDS


def _stop_child(child: "subprocess.Popen[bytes]") -> None:
    if child.poll() is None:
        if hasattr(os, "killpg"):
            os.killpg(child.pid, signal.SIGKILL)
        else:  # no process groups on this system
            child.kill()
        child.wait()


def _collect_results(
    folder: Path, process_end: _ProcessEnd, seconds: float, limits: Limits, *, is_own_model: bool
) -> Execution:
    events = _read_events(folder / "events.jsonl")
    runs = tuple(
        Run(
            probe=event["probe"],
            sample=event["sample"],
            seconds=event["seconds"],
            error=event.get("error", ""),
            missing_resource=event.get("missing_resource", ""),
            center=tuple(event.get("center", ())),
        )
        for event in events
        if event["event"] == "run"
    )
    samples = tuple(
        Sample(
            index=event["sample"],
            outputs=_load_arrays(folder, event["outputs"]),
            digest=event["digest"],
            thin=event["thin"],
            not_finite=tuple(event["not_finite"]),
            survey=RowCount(**event["survey"]) if event.get("survey") else None,
            drawn=_map_array(folder / event["drawn"]) if event.get("drawn") else None,
        )
        for event in events
        if event["event"] == "sample"
    )
    version = next((e["version"] for e in events if e["event"] == "started"), "")
    if process_end.host_fault:
        raise _spool_failed_error(folder, process_end.host_fault.strip())
    fault = _read_fault_report(
        events, process_end.status, limits, folder / "log", is_own_model=is_own_model
    )
    return Execution(
        runs=runs,
        samples=samples,
        fault=fault,
        seconds=seconds,
        version=version,
        events=tuple(events),
    )


def _read_events(path: Path) -> list[dict[str, Any]]:
    """Read the log events (JSON lines) of a sandbox process, up to an incomplete last line."""
    events: list[dict[str, Any]] = []
    if path.exists():
        for line in path.read_text("utf-8").splitlines():
            try:
                events.append(json.loads(line))
            except ValueError:
                break
    return events


def _load_arrays(folder: Path, files: dict[str, str]) -> dict[str, np.ndarray]:
    return {name: _map_array(folder / file) for name, file in files.items()}


def _map_array(path: Path) -> np.ndarray:
    # Windows cannot delete a file while it is mapped.
    mode: Literal["r"] | None = None if os.name == "nt" else "r"
    try:
        return np.asanyarray(np.load(path, mmap_mode=mode, allow_pickle=False))
    except ValueError:  # an empty array or a scalar cannot be mapped
        return np.asarray(np.load(path, allow_pickle=False))


def _read_fault_report(
    events: list[dict[str, Any]],
    status: int | None,
    limits: Limits,
    log_path: Path,
    *,
    is_own_model: bool,
) -> Fault | None:
    """Return why a model did not run to the end; ``is_own_model`` for the worker of this module.

    Raises:
        HostProcessFailed: This machine ended the process.
    """
    last: dict[str, Any] = events[-1] if events else {"event": "nothing"}
    from gsgen.contract.model.load_failures import explain_load_failure
    from gsgen.contract.process.child_status import classify_child_end, memory_refused

    run_events = (event for event in reversed(events) if event["event"] in ("begin", "run"))
    begin_event = next(run_events, last)
    probe = begin_event.get("probe") if begin_event["event"] == "begin" else None
    if last["event"] == "done" and status == 0:
        return None
    if status is None and last["event"] != "fault":
        return Fault("time", f"still running after {limits.seconds:g} s", probe)
    if last["event"] == "fault":
        failure = explain_load_failure(last["message"])
        fault = Fault(last["stage"], failure.cause, last.get("probe"), failure.hint)
    else:
        log = log_path.read_text("utf-8", errors="replace")
        child_death = classify_child_end(status or 0, log, limits)
        has_worker_started = (
            any(event["event"] == "started" for event in events) or not is_own_model
        )
        if child_death.stage == "host" or not has_worker_started:
            raise HostProcessFailed(f"the process that runs the model ended: {child_death.message}")
        fault = Fault(child_death.stage, child_death.message, probe)
    host_limit = inherited_memory_limit()
    if fault.stage in ("memory", "crash") and host_limit < limits.memory:
        raise memory_refused(limits.memory, host_limit, fault.message)
    return fault
