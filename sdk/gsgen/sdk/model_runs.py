"""Runs a model file in the sandbox, a few test inputs at a time, to bound the memory."""

__all__ = ["MAX_KEPT_OUTPUT_BYTES", "run_in_groups"]

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from gsgen.contract.errors import GsgenError
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.sandbox import execute
from gsgen.contract.process.limits import Limits

# Bytes of outputs that are kept at once, in memory or in the sandbox's files.
MAX_KEPT_OUTPUT_BYTES = 256 << 20


def run_in_groups(
    path: Path,
    names: Sequence[str],
    probes: Sequence[Probe],
    limits: Limits,
    *,
    frame_bytes: int,
    failure: Callable[[str, str], GsgenError],
) -> Iterator[dict[str, np.ndarray]]:
    """Yield a model's outputs by name for each set of test inputs; each is valid until the next.

    Args:
        path: The model file.
        names: Names of the outputs.
        probes: The inputs.
        limits: Time and memory for a group of runs.
        frame_bytes: Bytes of the outputs of one run.
        failure: Makes the error to raise from ONNX Runtime's message and a hint, which may be empty.
    """
    size = max(1, MAX_KEPT_OUTPUT_BYTES // max(1, frame_bytes))
    for start in range(0, len(probes), size):
        group = probes[start : start + size]
        with execute(path, names, group, limits) as execution:
            if execution.fault is not None:
                raise failure(execution.fault.message, execution.fault.hint)
            for run in execution.runs:
                outputs = execution.samples[run.sample].outputs
                yield {name: outputs[name] for name in names}
