"""Traces a torch module into an ONNX graph with torch's own exporter."""

__all__ = ["TensorNames", "trace_generator", "trace_module"]

import logging
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass
from io import StringIO
from typing import Any

import numpy as np
import onnx_ir as ir
import torch
from onnx import TensorProto
from onnxscript import opset18
from torch import nn

from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.sdk.authoring.output_names import output_names
from gsgen.sdk.authoring.packed_module import PackedGenerator
from gsgen.sdk.errors import ExportFailed, GeneratorInvalid
from gsgen.sdk.exporting.tracing.hazards import Hazard
from gsgen.sdk.exporting.tracing.source_lines import user_line_of
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint

_MAX_HAZARDS = 3
_TRACE_HINT = (
    "Shapes must not depend on data: use masks and torch.where, not boolean indexing, and "
    "keep `.item()`, numpy and Python branches on tensors out of forward."
)


def trace_generator(
    packed: PackedGenerator,
    example: Probe,
    manifest: GeneratorManifest,
    opset: int,
    hazards: Sequence[Hazard] = (),
) -> ir.Model:
    """Trace a torch generator with packed outputs, and return its ONNX graph.

    ``hazards`` explain an error.
    """
    names = TensorNames(tuple(example.inputs), output_names(manifest))
    where = type(packed.generator).__name__
    return trace_module(packed, example, names, opset, where=where, hazards=hazards)


@dataclass(frozen=True, slots=True)
class TensorNames:
    """The names for a traced graph's inputs, outputs and symbolic dimensions."""

    inputs: tuple[str, ...]  # in the order of the module's arguments
    outputs: tuple[str, ...]  # in the order of its results
    # for each argument, axis → the name of its size; all sizes are fixed if absent
    dynamic: tuple[dict[int, Any], ...] | None = None


def trace_module(
    module: nn.Module,
    example: Probe,
    names: TensorNames,
    opset: int,
    *,
    where: str,
    hazards: Sequence[Hazard] = (),
) -> ir.Model:
    """Trace any torch module with ``torch.onnx.export(dynamo=True)``, and return the ONNX graph.

    ``where`` is the module's name in an error, which ``hazards`` explain and which names the line
    of the user's code.
    """
    arguments = tuple(torch.from_numpy(np.array(value)) for value in example.inputs.values())
    try:
        with _silence_exporter():
            program = torch.onnx.export(
                module,
                arguments,
                dynamo=True,
                input_names=list(names.inputs),
                output_names=list(names.outputs),
                opset_version=opset,
                dynamic_shapes=names.dynamic and (names.dynamic,),
                custom_translation_table=_TRANSLATIONS,
                verbose=False,
            )
    except GeneratorInvalid:
        raise
    except Exception as error:  # the exporter's errors share no base class
        raise _export_error(where, error, hazards) from error
    assert program is not None
    _widen_indices(program.model)
    exported_opset = program.model.opset_imports.get("", opset)
    if exported_opset != opset:  # torch only logs that it could not convert the graph
        message = f"torch cannot convert the graph to operator set {opset}; it has {exported_opset}"
        raise ExportFailed(message, where="opset", hint=f"Export at operator set {exported_opset}.")
    return program.model


def _widen_indices(model: ir.Model) -> None:
    """Cast the int32 indices of GatherND and ScatterND to int64, which ONNX demands of both."""
    for node in [n for n in model.graph.all_nodes() if n.op_type in ("GatherND", "ScatterND")]:
        indices = node.inputs[1]
        if indices is not None and indices.dtype == ir.DataType.INT32:
            write = InsertionPoint(node)
            int64 = ir.DataType.INT64
            cast = write.op("Cast", indices, dtype=int64, shape=indices.shape, to=int(int64))
            node.replace_input_with(1, cast)


@contextmanager
def _silence_exporter() -> Iterator[None]:
    """Suppress the console messages of torch's exporter, and the stacks that it keeps of nodes."""
    level = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    # No error or file of ours holds them, and they take a tenth of the exporter's time. Older
    # releases do not know the option.
    options: Any = torch.fx.config
    old_setting = getattr(options, "do_not_emit_stack_traces", False)
    options.do_not_emit_stack_traces = True
    try:
        # Graphs of failed attempts are printed, not logged.
        with warnings.catch_warnings(), torch.no_grad(), redirect_stderr(StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        options.do_not_emit_stack_traces = old_setting
        logging.disable(level)


def _export_error(name: str, error: BaseException, hazards: Sequence[Hazard]) -> ExportFailed:
    """Return a tracing error with torch's reason, the line of the user's code, and a hint."""
    root: BaseException = error
    while root.__cause__ is not None:
        root = root.__cause__
    reason = next((line for line in str(root).splitlines() if line.strip()), type(root).__name__)
    message = f"{type(root).__name__}: {reason.strip()[:300]}"
    line = user_line_of(root)
    likely_hazards = [hazard for hazard in hazards if line and line in hazard.where] or list(
        hazards
    )
    likely_hazards.sort(key=lambda hazard: hazard.kind == "order")  # torch exports sorts
    if not likely_hazards:
        return ExportFailed(message, where=line or name, hint=_TRACE_HINT)
    first = likely_hazards[0]
    return ExportFailed(
        f"{first.description}, and torch cannot export it ({message})",
        where=line or first.where,
        hint="\n  ".join([first.hint, *(str(hazard) for hazard in likely_hazards[1:_MAX_HAZARDS])]),
    )


# Its types are those of single operators, not of what they return.
_OPSET18: Any = opset18


def _searchsorted(
    boundaries: Any, values: Any, *, right: bool = False, side: str | None = None, **_: Any
) -> Any:
    """Translate searchsorted to float32 counts of boundaries; WebGPU cannot sum int64."""
    expanded_values = _OPSET18.Unsqueeze(values, _OPSET18.Constant(value_ints=[-1]))
    row = _OPSET18.Unsqueeze(boundaries, _OPSET18.Constant(value_ints=[-2]))
    is_right_side = right or side == "right"
    is_below = (
        _OPSET18.LessOrEqual(row, expanded_values)
        if is_right_side
        else _OPSET18.Less(row, expanded_values)
    )
    ones = _OPSET18.Cast(is_below, to=TensorProto.FLOAT)
    count = _OPSET18.ReduceSum(ones, _OPSET18.Constant(value_ints=[-1]), keepdims=0)
    return _OPSET18.Cast(count, to=TensorProto.INT64)


def _prod(values: Any, dims: Sequence[int], **_: Any) -> Any:
    """Translate ``prims.prod``, to which torch reduces ``cumprod``, to the operator ReduceProd."""
    axes = _OPSET18.Constant(value_ints=list(dims))
    return _OPSET18.ReduceProd(values, axes, keepdims=0)


# ONNX forms of torch operators that torch's own exporter does not translate.
_TRANSLATIONS: dict[Callable[..., Any], Callable[..., Any]] = {
    torch.ops.aten.searchsorted.Tensor: _searchsorted,
    torch.ops.prims.prod.default: _prod,
}
