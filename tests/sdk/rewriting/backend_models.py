"""The models of ONNX's backend test: every operator, with inputs and expected outputs.

Models of nodes are made by the installed ``onnx`` package, others are files in it.
"""

import contextlib
import io
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

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
