"""The models of ONNX's backend test: every operator, with inputs and expected outputs.

Models of nodes are made by the installed ``onnx`` package, others are files in it.
To print the counts of outcomes, and write the verdicts: PYTHONPATH=tests python -m sdk.rewriting.backend_models
"""

import contextlib
import io
import os
import time
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import onnx
import onnxruntime

from gsgen.contract.errors import GsgenError
from gsgen.contract.model.inspected_model import inspect_model
from gsgen.contract.model.installed_runtime import installed_bounds
from gsgen.contract.model.model_file import declared_opset, open_model
from gsgen.contract.model.versions import operators_changed_since
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.targets import load_target
from gsgen.sdk.float16.convert_model import write_float16
from gsgen.sdk.float16.to_float16 import ToFloat16
from gsgen.sdk.rewriting.model_io import load_model, save_model
from gsgen.sdk.rewriting.rewrite import normalize_model, rewrite_file
from support.forks import forked_children, results_of_forks

VERDICTS = Path(__file__).parents[2] / "corpora" / "verdicts" / "onnx-backend.txt"
MAX_SECONDS = 600.0
FAULTS = ("traceback", "broken", "changed", "crash")


@dataclass(frozen=True)
class BackendModel:
    """A model of the backend test, with the input values of its first data set."""

    name: str
    content: bytes
    inputs: tuple[object, ...] = ()


def backend_models() -> Iterator[BackendModel]:
    """Yield all models of the backend test: those of nodes first, then those in files."""
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")  # operators at their limits divide by zero
        from onnx.backend.test.case.node import collect_testcases

        cases = collect_testcases(None)
    opset, ir_version = installed_bounds()
    for case in cases:
        inputs = tuple(case.data_sets[0][0]) if case.data_sets else ()
        declare_loadable_versions(case.model, opset, ir_version)
        yield BackendModel(case.name, case.model.SerializeToString(), inputs)
    folder = Path(onnx.__file__).parent / "backend" / "test" / "data"
    for path in sorted(folder.rglob("*.onnx")):
        name = str(path.relative_to(folder).with_suffix("")).removesuffix("/model")
        yield BackendModel(name, path.read_bytes())


def declare_loadable_versions(model: onnx.ModelProto, opset: int, ir_version: int) -> None:
    """Lower the versions of a model to those that ONNX Runtime reads, where it means the same."""
    declared = declared_opset(model)
    if declared is not None and declared > opset and not operators_changed_since(model, opset):
        for entry in model.opset_import:
            if not entry.domain:
                entry.version = opset
    model.ir_version = min(model.ir_version, ir_version)


def verdict(model: BackendModel, folder: Path) -> dict[str, str]:
    """Inspect, rewrite and convert a model; return the outcome of each.

    An outcome is ``ok``, ``same bytes``, ``refused: …`` for an error of gsgen, or a fault:
    ``traceback: …``, ``broken: …`` for a file that ONNX Runtime does not load although it loads the
    source, and ``changed: …`` for other results.
    """
    source, target = folder / "source.onnx", folder / "target.onnx"
    source.write_bytes(model.content)
    core = load_target("core")
    steps = {
        "inspect": lambda: inspect_model(open_model(source), core, Limits()) and None,
        "rewrite": lambda: rewrite_file(source, target, core) and None,
        "float16": lambda: write_float16(source, target) and None,
        "float16 pass": lambda: _write_in_float16(source, target),
    }
    outcomes = {}
    for name, run in steps.items():
        target.unlink(missing_ok=True)
        try:
            run()
            inputs = () if name == "float16 pass" else model.inputs
            outcomes[name] = _compared(source, target, inputs) if target.exists() else "ok"
        except GsgenError as error:
            outcomes[name] = f"refused: {error.message}"
        except Exception as error:  # any other exception is a traceback for the user
            outcomes[name] = f"traceback: {type(error).__name__}: {error}"
    return outcomes


def _write_in_float16(source: Path, target: Path) -> None:
    """Write a copy whose nodes compute in float16, without a search of the nodes that may."""
    model = load_model(source)
    normalize_model(model)
    ToFloat16()(model)
    save_model(model, target)


def _compared(source: Path, target: Path, inputs: tuple[object, ...]) -> str:
    if source.read_bytes() == target.read_bytes():
        return "same bytes"
    try:
        before = _session(source)
    except Exception:  # ONNX Runtime does not support the operator
        before = None
    try:
        after = _session(target)
    except Exception as error:
        return "ok" if before is None else f"broken: {error}"
    if before is None or not inputs:
        return "ok"
    feed = {entry.name: value for entry, value in zip(before.get_inputs(), inputs, strict=False)}
    try:
        expected = before.run(None, feed)
    except Exception:  # the source does not run with the inputs of the test
        return "ok"
    actual = after.run(None, feed)
    for name, old, new in zip(
        (output.name for output in before.get_outputs()), expected, actual, strict=True
    ):
        if not _equal(old, new):
            return f"changed: output {name}"
    return "ok"


def _session(path: Path) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    options.intra_op_num_threads = 1  # a process with threads does not fork well
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def _equal(old: object, new: object) -> bool:
    if isinstance(old, list) and isinstance(new, list):
        return len(old) == len(new) and all(map(_equal, old, new))
    if not isinstance(old, np.ndarray) or not isinstance(new, np.ndarray):
        return bool(old == new)
    if old.dtype != new.dtype or old.shape != new.shape:
        return False
    if old.dtype.kind not in "fc":
        return bool((old == new).all())
    return bool(np.allclose(old, new, rtol=1e-4, atol=1e-5, equal_nan=True))


def outcomes_of(models: Sequence[BackendModel]) -> dict[str, dict[str, str]]:
    """Return model → step → outcome; a model at which a process ended has the one step ``run``."""
    result: dict[str, dict[str, str]] = {}
    for model, outcome in zip(models, results_of_forks(_outcome, models, MAX_SECONDS), strict=True):
        is_ended = isinstance(outcome, str)
        result[model.name] = {"run": f"crash: {outcome}"} if is_ended else outcome
    return result


def _outcome(model: BackendModel) -> dict[str, str]:
    with TemporaryDirectory() as folder, forked_children():
        return verdict(model, Path(folder))


def outcomes_of_all(models: Sequence[BackendModel]) -> dict[str, dict[str, str]]:
    """Return the outcomes of many models, computed on all processors."""
    count = os.cpu_count() or 1
    shares = [models[first :: 4 * count] for first in range(4 * count)]
    with ProcessPoolExecutor(count) as pool:
        results = {
            name: entry for part in pool.map(outcomes_of, shares) for name, entry in part.items()
        }
    return {model.name: results[model.name] for model in models}


def compact(outcomes: dict[str, str]) -> str:
    """Return the outcomes of a model in a line, without the reasons of refusals."""
    return ", ".join(f"{step}: {outcome.split(':')[0]}" for step, outcome in outcomes.items())


def versions() -> str:
    """Return the versions that decide which models there are, and which of them load."""
    return f"# onnx {onnx.__version__}, ONNX Runtime {onnxruntime.__version__}"


def main() -> None:
    """Judge all models, print how many have which outcome of each step, and write the verdicts."""
    start_times = time.monotonic(), os.times()
    outcomes = outcomes_of_all(list(backend_models()))
    counts = Counter(
        f"{step}: {outcome.split(':')[0]}"
        for entry in outcomes.values()
        for step, outcome in entry.items()
    )
    lines = [f"{name}\t{compact(entry)}\n" for name, entry in sorted(outcomes.items())]
    VERDICTS.write_text(versions() + "\n" + "".join(lines))
    for outcome, number in sorted(counts.items()):
        print(f"{number:6} {outcome}")
    for name, entry in outcomes.items():
        print(
            *(
                f"{name}: {step}: {text}\n"
                for step, text in entry.items()
                if text.startswith(FAULTS)
            ),
            end="",
        )
    processor_minutes = (sum(os.times()[:4]) - sum(start_times[1][:4])) / 60
    print(
        f"{len(outcomes)} models, {processor_minutes:.1f} minutes of a processor, {(time.monotonic() - start_times[0]) / 60:.1f} minutes"
    )


if __name__ == "__main__":
    main()
