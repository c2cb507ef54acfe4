"""Export 30 modules as authors write them: python tests/bench/bench_authors_modules.py [--live] [NAME …].

Prints of each whether it is exported with parity at the first try, captured live (--live), and the
time of ONNX Runtime over that of eager torch, one thread each. Bars: 27 of 30 exported; 95 % of them
live; 25 of 30 not slower than eager torch.
"""

import math
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnxruntime
import torch

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent))

from authors_modules import MODULES, Cloud

from gsgen.contract.errors import GsgenError
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.sdk import export
from gsgen.sdk.authoring.packed_module import Packed, PackedGenerator
from gsgen.sdk.exporting.pipeline import probes_of
from support.measures import print_line, process_seconds
from support.models.captured import CAPTURED

_MIN_EXPORTED, _MIN_LIVE_SHARE, _MIN_FAST, _MAX_RATIO = 27, 0.95, 25, 1.0
_ROUNDS = 15


@dataclass(frozen=True, slots=True)
class _Result:
    """The outcome of one module."""

    is_exported: bool
    ratio: float = math.inf  # seconds of ONNX Runtime over those of eager torch
    is_captured: bool = False


def _measure(kind: type[Cloud], folder: Path, *, is_live: bool) -> tuple[_Result, str]:
    """Export a module and time it; return the result, and a sentence on it."""
    module = kind()
    settings = Settings(
        level=Level.LIVE if is_live else Level.BEHAVIOUR, limits=Limits(seconds=900)
    )
    try:
        exported = export(
            module, folder / "m.onnx", target="webgpu", settings=settings, capacity=kind.capacity
        )
    except GsgenError as error:
        return _Result(is_exported=False), f"refused: {' '.join(str(error).split())[:300]}"
    is_captured = is_live and all(
        exported.report.outcome(rule).status == "pass" for rule in CAPTURED
    )
    (probe, *_) = probes_of(exported.manifest, count=3)[1:]
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(exported.path, options)
    tensors = [torch.from_numpy(np.array(value)) for value in probe.inputs.values()]
    gaussians = exported.manifest.outputs.gaussians
    packed = PackedGenerator(module, Packed(torch.float32, gaussians.capacity))

    def run_eager() -> None:
        """Compute the same outputs: covariances, and rows of ten numbers."""
        with torch.no_grad():
            packed(*tensors)

    seconds = _by_turns(run_eager, lambda: session.run(None, dict(probe.inputs)))
    ratio = seconds[1] / seconds[0]
    milliseconds = f"{1000 * seconds[1]:.2f} of {1000 * seconds[0]:.2f} ms, {ratio:.2f} x"
    live = ", captured" if is_captured else ", NOT captured" if is_live else ""
    return _Result(True, ratio, is_captured), f"exported{live}; {milliseconds}"


def _by_turns(*actions: Callable[[], object]) -> list[float]:
    """Run all actions in turn, several times; return the shortest processor time of each."""
    rounds = [[process_seconds(action) for action in actions] for _ in range(_ROUNDS)]
    return [min(times[1:]) for times in zip(*rounds, strict=True)]


def _results(names: list[str], *, is_live: bool) -> Iterator[_Result]:
    for kind in MODULES:
        if names and kind.__name__ not in names:
            continue
        start = time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            result, sentence = _measure(kind, Path(folder), is_live=is_live)
        print_line(f"{kind.__name__}: {sentence} ({time.process_time() - start:.0f} CPU-s)")
        yield result


def main(arguments: list[str]) -> int:
    """Print the outcome of each module and the bars; return 1 if a bar is missed."""
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    is_live = "--live" in arguments
    names = [name for name in arguments if name != "--live"]
    results = list(_results(names, is_live=is_live))
    exported = [result for result in results if result.is_exported]
    fast = sum(result.ratio <= _MAX_RATIO for result in results)
    captured = sum(result.is_captured for result in results)
    print_line(
        f"{len(exported)} of {len(results)} exported (bar {_MIN_EXPORTED} of 30); {fast} not slower "
        f"than eager torch (bar {_MIN_FAST} of 30)"
    )
    is_good = len(exported) >= _MIN_EXPORTED and fast >= _MIN_FAST
    if is_live:
        print_line(f"{captured} of {len(exported)} captured live (bar {_MIN_LIVE_SHARE:.0%})")
        is_good &= captured >= _MIN_LIVE_SHARE * len(exported)
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
