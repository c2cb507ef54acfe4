"""A child of `gsgen.sdk.live.level` that misbehaves as the environment asks, for tests."""

import os
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.contract.probing.sandbox_worker import EmitMessage, keep_outputs, run_worker


def _work(folder: Path, job: dict[str, Any], emit: EmitMessage) -> int:
    how = os.environ["HOW_THE_WORKER_BEHAVES"]
    emit("started", version="made up")
    if how == "crash at once":
        os.kill(os.getpid(), signal.SIGSEGV)
    if how == "fall back":
        emit("fell-back", message="wanted this, got that")
        emit("done")
        return 0
    emit("device", name="made up", version="0")
    emit("adapter", name="made up", software=True, half=False)
    emit("placed", nodes=[])
    if how == "crash in a replay":
        for phase in ("plain", "captured"):
            emit("begin", phase=phase, probe=0)
            sample = keep_outputs(folder, {"y": np.zeros(1, np.float32)}, {}, emit, disk=1 << 20)
            emit("frame", phase=phase, frame=0, sample=sample)
            if phase == "captured":
                emit("accepted")
        emit("begin", phase="captured", probe=1)
        os.kill(os.getpid(), signal.SIGSEGV)
    emit("done")
    return 0


if __name__ == "__main__":
    sys.exit(run_worker(Path(sys.argv[1]), _work))
