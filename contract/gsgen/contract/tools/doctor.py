"""What is installed here, and what is missing, with the command that mends it."""

__all__ = ["Check", "checks", "package"]

import platform
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Literal

State = Literal["ok", "missing", "broken"]


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that a part of gsgen needs.

    Attributes:
        name: What it is.
        state: ``ok``, ``missing`` (a part cannot be used), or ``broken`` (something is wrong).
        detail: A version, an adapter, or what is wrong.
        remedy: What to type to mend it; empty where all is well.
        purpose: What it is needed for.
    """

    name: str
    state: State
    detail: str
    remedy: str = ""
    purpose: str = ""


def package(name: str, remedy: str, *, purpose: str = "") -> Check:
    """Say whether the distribution ``name`` is installed, without importing it."""
    try:
        return Check(name, "ok", version(name), purpose=purpose)
    except PackageNotFoundError:
        return Check(name, "missing", "not installed", remedy, purpose)


def checks() -> Iterator[Check]:
    """Yield the state of what validation needs."""
    yield Check("gsgen", "ok", f"{version('gsgen')} in {Path(__file__).parents[2]}")
    yield Check("python", "ok", f"{platform.python_version()} at {sys.executable}")
    for name in ("numpy", "onnx", "onnxruntime"):
        yield package(name, f"pip install {name}", purpose="validate")
    yield _child()


def _child() -> Check:
    """Run the smallest model in the sandbox, as validation does."""
    import tempfile

    from onnx import ModelProto, NodeProto, TensorProto

    from gsgen.contract.probing.probes import Probe
    from gsgen.contract.probing.sandbox import execute
    from gsgen.contract.process.limits import Limits

    model = ModelProto(ir_version=8)
    model.opset_import.add(domain="", version=18)
    weight = TensorProto(name="w", data_type=TensorProto.FLOAT, dims=[1], float_data=[1.0])
    model.graph.name = "smallest"
    model.graph.initializer.append(weight)
    model.graph.node.append(NodeProto(op_type="Neg", input=["w"], output=["y"]))
    value = model.graph.output.add(name="y").type.tensor_type
    value.elem_type = TensorProto.FLOAT
    value.shape.dim.add(dim_value=1)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "smallest.onnx"
        path.write_bytes(model.SerializeToString())
        with execute(path, ["y"], [Probe("none", {})], Limits(seconds=30)) as execution:
            fault, seconds = execution.fault, execution.seconds
    purpose = "levels values and behaviour"
    if fault is not None:
        return Check(
            "sandbox", "broken", fault.message, "pip install -U onnxruntime", purpose
        )
    return Check(
        "sandbox", "ok", f"a model ran in a child process ({seconds:.2f} s)", "", purpose
    )
