"""The sandbox's child process: runs one model for a list of test inputs, then exits.

It writes one JSON line an event, and every distinct output once as an ``.npy`` file, so that
an abort leaves everything that was done before. Other workers are made of the same parts.
"""

__all__ = [
    "EXTRA_PROBE_TIME_SHARE",
    "EmitMessage",
    "digest_outputs",
    "error_line",
    "fault_stage",
    "input_reader",
    "keep_outputs",
    "main",
    "model_source",
    "run_worker",
    "subsample_rows",
    "subsample_step",
]

import errno
import hashlib
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.contract.probing.row_screen import drawn_rows, live_count, look_faulty, visible_count
from gsgen.contract.process.confinement import confine
from gsgen.contract.process.limits import is_out_of_memory, limit_memory, limit_processor_time
from gsgen.contract.process.parent_watchdog import exit_with_parent
from gsgen.contract.spec.layout import CULL_OPACITY, OPACITY, POSITION, ROW_LENGTH

# Errors of storing files; NumPy gives none where a part was written.
_STORAGE_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS, None)
_MAX_MESSAGE_LENGTH = 2000  # some of ONNX Runtime's messages have their cause at the end
# Extra probes start only within this share of the time, so that they never use it up.
EXTRA_PROBE_TIME_SHARE = 0.5
_SUBSAMPLE_ROWS = 1 << 14
# Start of the key of a faulty run of a named moment whose rows are stored, and the most of them.
_FAULTY = "faulty "
_MAX_FAULTY_RUNS = 4
# Rows for pictures are kept where the disk holds this many times as many.
_MAX_PICTURES = 128
# Arrays of inputs up to this size are kept in memory, since many probes share them.
_MAX_PIPE_BYTES = 1 << 16

EmitMessage = Callable[..., None]


def main(folder: Path) -> int:
    """Run the sandbox job that ``job.json`` in a folder describes."""
    return run_worker(folder, _run_probes)


def run_worker(folder: Path, run_job: Callable[[Path, dict[str, Any], EmitMessage], int]) -> int:
    """Read a sandbox job from its folder, do the job, and return the exit status.

    A file that cannot be stored is a fault of this machine: the parent reads it from standard
    output, which a full disk does not keep from it.
    """
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as host_faults:
        os.dup2(2, 1)  # what libraries print goes to the log
        try:
            return _run_sandbox_job(folder, run_job)
        except OSError as error:
            if error.errno not in _STORAGE_ERRORS:
                raise
            host_faults.write(error.strerror or f"a part was written ({error_line(error)})")
            return 1


def _run_sandbox_job(
    folder: Path, run_job: Callable[[Path, dict[str, Any], EmitMessage], int]
) -> int:
    job = json.loads((folder / "job.json").read_text("utf-8"))
    readable = map(Path, job["readable"])
    if not job["trusted"]:
        confine(readable, [folder], file_bytes=job["memory"], has_gpu=job["has_gpu"])
    exit_with_parent()
    limit_processor_time(job["seconds"])  # should the parent be killed while a model is loaded
    with (folder / "events.jsonl").open("w", buffering=1, encoding="utf-8") as log:

        def emit(event: str, **facts: object) -> None:
            log.write(json.dumps({"event": event} | facts) + "\n")

        return run_job(folder, job, emit)


def _run_probes(folder: Path, job: dict[str, Any], emit: EmitMessage) -> int:
    import onnxruntime

    start_time = time.thread_time()  # what other processes take from the processor is not counted
    emit("started", version=onnxruntime.__version__)
    limit_memory(job["memory"])
    deadline = start_time + EXTRA_PROBE_TIME_SHARE * job["seconds"]
    known: dict[str, int] = {}
    probe: int | None = None
    is_optimised = True
    center: np.ndarray | None = None
    inputs_of = input_reader(folder, job)
    try:
        session = _session(job, emit)
        for probe in range(len(job["probes"])):
            emit("begin", probe=probe)
            extra = job["extra"][probe]
            if extra and time.thread_time() > deadline:
                emit("run", probe=probe, sample=-1, seconds=0.0, missing_resource="time")
                continue
            try:
                if job["optimise"][probe] is not is_optimised:
                    is_optimised = job["optimise"][probe]
                    del session  # first, so that two of them never need memory at once
                    session = _session(job, emit, optimise=is_optimised)
                inputs = inputs_of(probe)
                placement, facts = job["placements"][probe], dict[str, object]()
                if placement is not None and center is not None:
                    _place_camera(inputs, placement, center)
                    facts["center"] = center.tolist()
                start_seconds = time.perf_counter()
                outputs = session.run(job["outputs"], inputs)
                seconds = time.perf_counter() - start_seconds
                by_name = dict(zip(job["outputs"], outputs, strict=True))
                if probe and center is None and job["rows"] in by_name:
                    center = _mean_drawn_center(by_name[job["rows"]])
                if job["survey"][probe]:
                    pictured = job["pictured"][probe]
                    sample = _survey_outputs(
                        folder, by_name, known, emit, job, is_pictured=pictured
                    )
                else:
                    sample = keep_outputs(
                        folder, by_name, known, emit, disk=job["disk"], thin=extra
                    )
            except OSError:
                raise  # of a file: a fault of this machine
            except Exception as error:
                if not extra:
                    raise
                is_memory_fault = fault_stage(error, probe) == "memory"
                reason = (
                    {"missing_resource": "memory"}
                    if is_memory_fault
                    else {"error": error_line(error)}
                )
                emit("run", probe=probe, sample=-1, seconds=0.0, **reason)
                continue
            emit("run", probe=probe, sample=sample, seconds=seconds, **facts)
    except OSError:
        raise
    except Exception as error:  # ONNX Runtime's errors share no base class of their own
        emit("fault", stage=fault_stage(error, probe), message=error_line(error), probe=probe)
        return 0
    emit("done")
    return 0


def _session(job: dict[str, Any], emit: EmitMessage, *, optimise: bool = True) -> Any:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    # Threads that wait for work sleep: by spinning they would take as much time as the model does.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    levels = onnxruntime.GraphOptimizationLevel
    disabled_optimizers = []
    if job.get("maps_weights"):
        options.add_session_config_entry("session.disable_prepacking", "1")
        disabled_optimizers.append("ConstantFolding")
        # Weights that are converted to float32 are so when they are used, one after another.
        options.execution_order = onnxruntime.ExecutionOrder.PRIORITY_BASED
        if job.get("has_float16_weights"):
            options.graph_optimization_level = levels.ORT_ENABLE_BASIC  # others convert all at once
    if not optimise:
        options.graph_optimization_level = levels.ORT_DISABLE_ALL
    start_seconds = time.perf_counter()
    session = onnxruntime.InferenceSession(
        model_source(job["model"]),
        options,
        providers=["CPUExecutionProvider"],
        disabled_optimizers=disabled_optimizers,
    )
    emit("loaded", seconds=time.perf_counter() - start_seconds)
    return session


def model_source(path: str) -> str | bytes:
    """Return what ONNX Runtime opens a model by: its path, or its bytes if that is not UTF-8."""
    try:
        path.encode()
    except UnicodeEncodeError:
        return Path(path).read_bytes()
    return path


def input_reader(folder: Path, job: dict[str, Any]) -> Callable[[int], dict[str, np.ndarray]]:
    """Return a function that loads one set of a job's test inputs, by index, from a folder."""
    cached_arrays: dict[int, np.ndarray] = {}

    def array(number: int) -> np.ndarray:
        if number in cached_arrays:
            return cached_arrays[number]
        value: np.ndarray = np.load(folder / f"input_{number}.npy", allow_pickle=False)
        if value.nbytes <= _MAX_PIPE_BYTES:
            cached_arrays[number] = value
        return value

    return lambda probe: {name: array(number) for name, number in job["probes"][probe]}


def _mean_drawn_center(rows: np.ndarray) -> np.ndarray | None:
    """Return the centre of the first visible packed row, in float64; None if no row is visible."""
    if rows.ndim != 2 or rows.shape[1] != ROW_LENGTH or rows.dtype.kind != "f":
        return None
    is_drawn = (rows[:, OPACITY] >= CULL_OPACITY) & np.isfinite(rows[:, POSITION]).all(axis=1)
    first = int(is_drawn.argmax()) if len(rows) else 0
    return rows[first, POSITION].astype(np.float64) if is_drawn.any() else None


def _place_camera(
    inputs: dict[str, np.ndarray], placement: dict[str, str], center: np.ndarray
) -> None:
    """Move the test camera in the inputs to a point, keeping its rotation."""
    if view := placement["view"]:
        tensor = inputs[view].copy()
        matrix = tensor.T if placement["order"] == "column" else tensor
        matrix[:3, 3] = -matrix[:3, :3].astype(np.float64) @ center
        inputs[view] = tensor
    if position := placement["position"]:
        inputs[position] = center.astype(inputs[position].dtype)


def _survey_outputs(
    folder: Path,
    outputs: dict[str, np.ndarray],
    known: dict[str, int],
    emit: EmitMessage,
    job: dict[str, Any],
    *,
    is_pictured: bool,
) -> int:
    """Record the digest and the row count of a run; store its outputs only if they look faulty.

    Return the index of the record. A few faulty runs are stored, as far as the disk limit allows, and
    of pictured ones the drawn rows.
    """
    digest = digest_outputs(outputs)
    faulty_keys = [key for key in known if key.startswith(_FAULTY)]
    kinds = ("pictured ",) if is_pictured else ("survey ", "pictured ")
    for kind in (_FAULTY, *kinds):
        if f"{kind}{digest}" in known:
            return known[f"{kind}{digest}"]
    sample = len(known)
    not_finite = [name for name, value in outputs.items() if not _is_finite(value)]
    rows, count = outputs.get(job["rows"]), outputs.get(job["count"])
    is_faulty = not not_finite and look_faulty(
        rows, count, outputs.get(job["cells"]), job["per_cell"]
    )
    size = sum(array.nbytes for array in outputs.values())
    files: dict[str, str] = {}
    # The disk also holds what later probes give: half of it is left to them.
    if is_faulty and len(faulty_keys) < _MAX_FAULTY_RUNS and 2 * size < job["disk"]:
        files = _save_outputs(folder, sample, outputs, job["disk"])
    known[f"{_FAULTY if files else kinds[0]}{digest}"] = sample
    survey = None
    if rows is not None and rows.ndim:
        live, visible = live_count(rows, count), visible_count(rows, count)
        survey = {"count": live, "capacity": len(rows), "drawn": visible}
    facts: dict[str, object] = {"digest": digest, "outputs": files, "not_finite": not_finite}
    drawn = drawn_rows(rows, count) if is_pictured else None
    if drawn is not None and _MAX_PICTURES * drawn.nbytes < job["disk"]:
        facts["drawn"] = f"drawn_{sample}.npy"
        np.save(folder / f"drawn_{sample}.npy", drawn, allow_pickle=False)
    emit("sample", sample=sample, survey=survey, thin=True, **facts)
    return sample


def keep_outputs(
    folder: Path,
    outputs: dict[str, np.ndarray],
    known: dict[str, int],
    emit: EmitMessage,
    *,
    disk: int,
    thin: bool = False,
) -> int:
    """Store the outputs of a run unless equal ones are stored; return the stored set's index.

    Where ``thin``, a part of the rows is stored, and which outputs are not finite is noted.

    Raises:
        OSError: The files in the folder would take more than ``disk`` bytes, or cannot be written.
    """
    key = digest_outputs(outputs)
    if key not in known:
        known[key] = len(known)
        arrays = {n: subsample_rows(value) if thin else value for n, value in outputs.items()}
        files = _save_outputs(folder, known[key], arrays, disk)
        not_finite = [name for name, value in outputs.items() if thin and not _is_finite(value)]
        facts = {"digest": key, "outputs": files, "thin": thin, "not_finite": not_finite}
        emit("sample", sample=known[key], **facts)
    return known[key]


def _save_outputs(
    folder: Path, sample: int, arrays: dict[str, np.ndarray], disk: int
) -> dict[str, str]:
    """Save arrays as files of a folder; return output name → file."""
    _require_disk_space(folder, sum(array.nbytes for array in arrays.values()), disk)
    files = {name: f"sample_{sample}_{k}.npy" for k, name in enumerate(arrays)}
    for name, file in files.items():
        np.save(folder / file, arrays[name], allow_pickle=False)
    return files


def _require_disk_space(folder: Path, size: int, disk: int) -> None:
    """Raise if a folder's files and ``size`` more bytes exceed ``disk`` bytes."""
    with os.scandir(folder) as entries:
        size += sum(entry.stat().st_size for entry in entries)
    if size > disk:
        message = f"they take more than {disk >> 20:,} MiB, four times the memory limit"
        raise OSError(errno.EDQUOT, message)


def digest_outputs(outputs: dict[str, np.ndarray]) -> str:
    """Return the SHA-256 of model outputs: name, dtype, shape and bytes of each, in order."""
    digest = hashlib.sha256()
    for name, value in outputs.items():
        if not isinstance(value, np.ndarray) or value.dtype.hasobject:
            actual = "strings" if isinstance(value, np.ndarray) else f"a {type(value).__name__}"
            raise TypeError(f"output {name!r} is {actual}, expected a numeric tensor")
        digest.update(f"{name} {value.dtype} {value.shape}\n".encode())
        digest.update(np.ascontiguousarray(value).data)
    return digest.hexdigest()


def subsample_rows(value: np.ndarray) -> np.ndarray:
    """Return about 16,384 evenly spaced rows of a model output, or all rows of a small one."""
    step = subsample_step(len(value)) if value.ndim else 1
    return value[::step] if step > 1 else value


def subsample_step(rows: int) -> int:
    """Return the step between stored rows of a large output, of which about 16,384 are stored."""
    return max(1, rows // _SUBSAMPLE_ROWS)


def _is_finite(value: np.ndarray) -> bool:
    return value.dtype.kind != "f" or bool(np.isfinite(value).all())


def fault_stage(error: Exception, probe: int | None) -> str:
    """Return the limit that an error exceeded, or else the stage in which the run failed."""
    if is_out_of_memory(error):
        return "memory"
    return "load" if probe is None else "run"


def error_line(error: Exception) -> str:
    """Return an error's message without line breaks, truncated if it is long."""
    text = " ".join(str(error).split())
    return text[:_MAX_MESSAGE_LENGTH] or type(error).__name__


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
