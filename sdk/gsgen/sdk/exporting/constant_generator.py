"""Write rows that never change as a generator: the static scene, without torch.

The graph is weights and nothing else; each output ends on Mul by one, so that capture and
replay have a kernel to record.
"""

__all__ = ["write_constant"]

import os
from pathlib import Path

import numpy as np
import onnx
from jaxtyping import Float
from onnx import ModelProto, NodeProto, numpy_helper

from gsgen.contract.model.model_file import MANIFEST_KEY
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.sandbox import execute
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec import layout
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.contract.spec.manifest_io import dumps
from gsgen.sdk.errors import GeneratorInvalid, ParityFailed

_OPSET = 18
_IR_VERSION = 8
# A protobuf message ends at 2 GiB; weights beyond this go to a file beside the model.
_INLINE_BYTES = 1_900_000_000


def write_constant(
    rows: Float[np.ndarray, "n 10"],
    appearance: Float[np.ndarray, "n c"],
    manifest: GeneratorManifest,
    path: Path,
    *,
    count: int | None = None,
    opset: int = _OPSET,
) -> None:
    """Write a generator that emits ``rows`` and ``appearance``, bit for bit, at every frame.

    Args:
        rows: Packed Gaussians, float32 or float16.
        appearance: SH or RGB, float32 or float16.
        manifest: Names the outputs; embedded.
        path: Where the model goes; write to :func:`gsgen.sdk.rewriting.atomic_model_files.atomic_write` another.
        count: How many of the first rows are live; all where absent.
        opset: ONNX operator set.

    Raises:
        GeneratorInvalid: The arrays do not fit each other or the manifest.
        ParityFailed: ONNX Runtime does not give back the same bits.
    """
    outputs = _outputs(rows, appearance, manifest, len(rows) if count is None else count)
    model = _model(outputs, manifest, opset)
    _save(model, path)
    _check(path, outputs)


def _outputs(
    rows: np.ndarray, appearance: np.ndarray, manifest: GeneratorManifest, count: int
) -> dict[str, np.ndarray]:
    declared = manifest.outputs
    if declared.gaussians is None or declared.appearance is None or declared.count is None:
        raise GeneratorInvalid(
            "names no gaussians, appearance or count", where="manifest.outputs"
        )
    if declared.cells is not None:
        what = "declares cells, and rows that never change are written without"
        raise GeneratorInvalid(what, where="manifest.outputs")
    if rows.ndim != 2 or rows.shape[1] != layout.ROW or len(rows) != len(appearance):
        seen = f"shapes are {list(rows.shape)} and {list(appearance.shape)}"
        raise GeneratorInvalid(f"{seen}, wanted [N, {layout.ROW}] and [N, C]", where="rows")
    if not 0 <= count <= len(rows):
        raise GeneratorInvalid(f"{count} is not within 0 to {len(rows)}", where="count")
    return {
        declared.gaussians.name: rows,
        declared.appearance.name: appearance,
        declared.count.name: np.array([count], np.int32),
    }


def _model(
    outputs: dict[str, np.ndarray], manifest: GeneratorManifest, opset: int
) -> ModelProto:
    model = ModelProto(ir_version=_IR_VERSION, producer_name="gsgen")
    model.opset_import.add(domain="", version=opset)
    model.metadata_props.add(key=MANIFEST_KEY, value=dumps(manifest, indent=None))
    graph = model.graph
    graph.name = "static"
    for name, value in outputs.items():
        weight, one = f"{name}_weight", f"{name}_one"
        graph.initializer.append(
            numpy_helper.from_array(np.ascontiguousarray(value), weight)
        )
        graph.initializer.append(numpy_helper.from_array(np.ones((), value.dtype), one))
        graph.node.append(
            NodeProto(op_type="Mul", name=f"{name}_end", input=[weight, one], output=[name])
        )
        declared = graph.output.add(name=name).type.tensor_type
        declared.elem_type = graph.initializer[-1].data_type
        for size in value.shape:
            declared.shape.dim.add(dim_value=size)
    return model


def _save(model: ModelProto, path: Path) -> None:
    size = sum(len(tensor.raw_data) for tensor in model.graph.initializer)
    if size <= _INLINE_BYTES:
        path.write_bytes(model.SerializeToString())
        return
    onnx.save_model(
        model, os.fspath(path), save_as_external_data=True, location=f"{path.name}.data"
    )


def _check(path: Path, outputs: dict[str, np.ndarray]) -> None:
    """Run the model once and compare bits."""
    limits = Limits().for_model(sum(value.nbytes for value in outputs.values()))
    with execute(path, list(outputs), [Probe("no inputs", {})], limits) as execution:
        if execution.fault is not None:
            what = f"ONNX Runtime cannot run the model: {execution.fault.message}"
            raise ParityFailed(what, where=path.name)
        for name, wanted in outputs.items():
            seen = execution.samples[0].outputs[name]
            if seen.shape != wanted.shape or seen.dtype != wanted.dtype:
                what = f"output is {seen.dtype} {list(seen.shape)}"
                raise ParityFailed(what, where=f"{path.name}, {name}")
            if not _same(seen, wanted):
                raise ParityFailed("output has other values", where=f"{path.name}, {name}")


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    """Say whether two arrays hold the same numbers; NaN equals NaN, its payload is no number."""
    return bool(np.array_equal(a, b, equal_nan=a.dtype.kind == "f"))
