"""The child of :mod:`gsgen.contract.sandbox`: run one model for a list of probes, then exit.

It writes one JSON line an event, and every distinct output once as an ``.npy`` file, so that
whatever stops it leaves all that was done before.
"""

__all__ = ["main"]

import contextlib
import hashlib
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

_OUT_OF_MEMORY = ("bad_alloc", "bad allocation", "Failed to allocate memory", "MemoryError")

Emit = Callable[..., None]


def main(folder: Path) -> int:
    """Do the job described in ``folder/job.json``."""
    job = json.loads((folder / "job.json").read_text())
    with (folder / "events.jsonl").open("w", buffering=1) as log:

        def emit(event: str, **facts: object) -> None:
            log.write(json.dumps({"event": event} | facts) + "\n")

        return _work(folder, job, emit)


def _work(folder: Path, job: dict[str, Any], emit: Emit) -> int:
    import onnxruntime

    emit("started", version=onnxruntime.__version__)
    _limit_memory(job["memory"])
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    probe: int | None = None
    try:
        session = onnxruntime.InferenceSession(
            job["model"], options, providers=["CPUExecutionProvider"]
        )
        known: dict[str, int] = {}
        for probe, names in enumerate(job["probes"]):
            emit("begin", probe=probe)
            inputs = _inputs(folder / f"probe_{probe}.npz", names)
            began = time.perf_counter()
            outputs = session.run(job["outputs"], inputs)
            seconds = time.perf_counter() - began
            sample = _keep(
                folder, dict(zip(job["outputs"], outputs, strict=True)), known, emit
            )
            emit("run", probe=probe, sample=sample, seconds=seconds)
    except Exception as error:  # ONNX Runtime's errors share no base class of their own
        emit("fault", stage=_stage(error, probe), message=_one_line(error), probe=probe)
        return 0
    emit("done")
    return 0


def _limit_memory(limit: int) -> None:
    with contextlib.suppress(ImportError):  # no such module on Windows
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        _, most = resource.getrlimit(resource.RLIMIT_DATA)
        most = sys.maxsize if most == resource.RLIM_INFINITY else most
        resource.setrlimit(resource.RLIMIT_DATA, (min(limit, most), min(limit, most)))


def _inputs(path: Path, names: list[str]) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as arrays:
        return {name: arrays[f"input_{index}"] for index, name in enumerate(names)}


def _keep(
    folder: Path, outputs: dict[str, np.ndarray], known: dict[str, int], emit: Emit
) -> int:
    """Store outputs that were not seen before; return the number of the sample they are."""
    digest = hashlib.sha256()
    for name, value in outputs.items():
        if not isinstance(value, np.ndarray) or value.dtype.hasobject:
            saw = (
                "strings" if isinstance(value, np.ndarray) else f"a {type(value).__name__}"
            )
            raise TypeError(f"output {name!r} is {saw}, wanted a numeric tensor")
        digest.update(f"{name} {value.dtype} {value.shape}\n".encode())
        digest.update(np.ascontiguousarray(value).data)
    key = digest.hexdigest()
    if key not in known:
        known[key] = len(known)
        files = {name: f"sample_{known[key]}_{k}.npy" for k, name in enumerate(outputs)}
        for name, file in files.items():
            np.save(folder / file, outputs[name], allow_pickle=False)
        emit("sample", sample=known[key], digest=key, outputs=files)
    return known[key]


def _stage(error: Exception, probe: int | None) -> str:
    if isinstance(error, MemoryError) or any(word in str(error) for word in _OUT_OF_MEMORY):
        return "memory"
    return "load" if probe is None else "run"


def _one_line(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text[:500] or type(error).__name__


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
