"""The child process of a benchmark: runs one model on one execution provider, then exits."""

__all__ = ["main"]

import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.contract.errors import GsgenError
from gsgen.contract.probing.sandbox_worker import EmitMessage, run_worker
from gsgen.contract.process.limits import DRIVER_BYTES, limit_memory
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.sdk.binding.providers.errors import ProviderUnavailable
from gsgen.sdk.binding.session import FrameSession

# The first frames are not measured: caches fill and clock rates rise.
_WARM_UP_FRAMES = 3


def main(folder: Path) -> int:
    """Run the benchmark that ``folder/job.json`` describes, and return the exit code."""
    return run_worker(folder, _run_job)


def _run_job(folder: Path, job: dict[str, Any], emit: EmitMessage) -> int:
    if not job["trusted"] and job["provider"] != "cuda":  # CUDA reserves addresses for a whole GPU
        limit_memory(job["memory"] + DRIVER_BYTES * (job["provider"] != "cpu"))
    try:
        emit("measured", facts=_measure(job))
    except ProviderUnavailable as error:
        emit("unavailable", message=_error_line(error))
    except GsgenError as error:
        emit("failed", message=_error_line(error))
    emit("done")
    return 0


def _error_line(error: GsgenError) -> str:
    is_model_error = error.where.startswith(("tensor ", "input ", "output "))
    message = f"{error.where}: {error.message}" if is_model_error else error.message
    return f"{message}; {error.hint}" if error.hint else message


def _measure(job: dict[str, Any]) -> dict[str, Any]:
    warnings.simplefilter("ignore")  # the facts contain their content
    import onnxruntime  # noqa: F401 (the first frame does not include loading the library)

    start = time.perf_counter()
    with FrameSession(
        job["model"], provider=job["provider"], sizes=job["sizes"], capture=job["capture"]
    ) as session:
        opening_time = time.perf_counter()
        probes = session.samples()
        _read_outputs(session, session.run())
        first = time.perf_counter() - start
        times = np.asarray(
            [
                _time_frame(session, probes[k % len(probes)])
                for k in range(job["frames"] + _WARM_UP_FRAMES)
            ]
        )[_WARM_UP_FRAMES:]
        return _benchmark_facts(session, times) | {
            "create_seconds": opening_time - start,
            "first_frame_seconds": first,
        }


def _time_frame(session: FrameSession, inputs: dict[str, np.ndarray]) -> tuple[float, float, float]:
    """Measure the time of one frame in seconds: total, copy to the device, copy back."""
    start = time.perf_counter()
    session.write(inputs)
    write_end = time.perf_counter()
    frame = session.run()
    _read_outputs(session, frame)
    run_end = time.perf_counter()
    for (
        buffer
    ) in session.outputs.values():  # read again without waiting: this measures the copies alone
        buffer.read()
    return run_end - start, write_end - start, time.perf_counter() - run_end


def _read_outputs(session: FrameSession, frame: Any) -> None:
    for name in session.outputs:
        frame[name]


def _benchmark_facts(session: FrameSession, times: np.ndarray) -> dict[str, Any]:
    total, copy_times = times[:, 0], times[:, 1] + times[:, 2]
    p50, p95 = np.percentile(total, [50, 95])
    share = float(np.clip(np.median(copy_times) / p50, 0, 1))
    count = _gaussian_count(session)
    return {
        "device": session.device,
        "frames": len(times),
        "p50_seconds": float(p50),
        "p95_seconds": float(p95),
        "copy_share": share,
        "bytes_in": sum(buffer.nbytes for buffer in session.inputs.values()),
        "bytes_out": sum(buffer.nbytes for buffer in session.outputs.values()),
        "gaussians": count,
        "gaussians_per_second": None if count is None else count / float(p50),
        "captured": session.captured,
        "cause": session.cause,
        "nodes": len(session.nodes),
        "nodes_on_cpu": [node.operator for node in session.left_on_cpu],
    }


def _gaussian_count(session: FrameSession) -> int | None:
    manifest = session.manifest
    has_gaussians = isinstance(manifest, GeneratorManifest) and manifest.outputs.gaussians
    return session.run().count if has_gaussians else None


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
