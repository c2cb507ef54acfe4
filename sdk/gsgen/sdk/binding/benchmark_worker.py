"""The child of :mod:`gsgen.sdk.binding.benchmark`: run one model on one provider, then exit."""

__all__ = ["main"]

import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.contract.errors import GsgenError
from gsgen.contract.probing.sandbox_worker import Emit, serve
from gsgen.contract.process.parent_watchdog import exit_with_parent
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.sdk.binding.providers.errors import ProviderUnavailable
from gsgen.sdk.binding.session import FrameSession

# Frames that are not measured: caches fill, clocks rise.
_UNMEASURED = 3


def main(folder: Path) -> int:
    """Do the job described in ``folder/job.json``."""
    return serve(folder, _work)


def _work(folder: Path, job: dict[str, Any], emit: Emit) -> int:
    try:
        emit("measured", facts=_measure(job))
    except ProviderUnavailable as error:
        emit("unavailable", message=_line(error))
    except GsgenError as error:
        emit("failed", message=_line(error))
    emit("done")
    return 0


def _line(error: GsgenError) -> str:
    inside = error.where.startswith(("tensor ", "input ", "output "))
    what = f"{error.where}: {error.message}" if inside else error.message
    return f"{what}; {error.hint}" if error.hint else what


def _measure(job: dict[str, Any]) -> dict[str, Any]:
    warnings.simplefilter("ignore")  # what they say is among the facts
    import onnxruntime  # noqa: F401 (loading the library is no part of the first frame)

    began = time.perf_counter()
    with FrameSession(
        job["model"], provider=job["provider"], sizes=job["sizes"], capture=job["capture"]
    ) as session:
        opened = time.perf_counter()
        probes = session.samples()
        _read(session, session.run())
        first = time.perf_counter() - began
        times = np.asarray(
            [
                _frame(session, probes[k % len(probes)])
                for k in range(job["frames"] + _UNMEASURED)
            ]
        )[_UNMEASURED:]
        return _facts(session, times) | {
            "create_seconds": opened - began,
            "first_frame_seconds": first,
        }


def _frame(
    session: FrameSession, inputs: dict[str, np.ndarray]
) -> tuple[float, float, float]:
    """Return the seconds for a frame as a whole, and for its copies to and from the device."""
    began = time.perf_counter()
    session.write(inputs)
    written = time.perf_counter()
    frame = session.run()
    _read(session, frame)
    done = time.perf_counter()
    for buffer in session.outputs.values():  # again, with nothing to wait for: copies alone
        buffer.read()
    return done - began, written - began, time.perf_counter() - done


def _read(session: FrameSession, frame: Any) -> None:
    for name in session.outputs:
        frame[name]


def _facts(session: FrameSession, times: np.ndarray) -> dict[str, Any]:
    total, copied = times[:, 0], times[:, 1] + times[:, 2]
    p50, p95 = np.percentile(total, [50, 95])
    share = float(np.clip(np.median(copied) / p50, 0, 1))
    count = _count(session)
    return {
        "device": session.device,
        "frames": len(times),
        "p50_seconds": float(p50),
        "p95_seconds": float(p95),
        "copy_share": share,
        "bytes_in": sum(one.nbytes for one in session.inputs.values()),
        "bytes_out": sum(one.nbytes for one in session.outputs.values()),
        "gaussians": count,
        "gaussians_per_second": None if count is None else count / float(p50),
        "captured": session.captured,
        "cause": session.cause,
        "nodes": len(session.nodes),
        "nodes_on_cpu": [node.operator for node in session.left_on_cpu],
    }


def _count(session: FrameSession) -> int | None:
    manifest = session.manifest
    known = isinstance(manifest, GeneratorManifest) and manifest.outputs.gaussians
    return session.run().count if known else None


if __name__ == "__main__":
    exit_with_parent()
    sys.exit(main(Path(sys.argv[1])))
