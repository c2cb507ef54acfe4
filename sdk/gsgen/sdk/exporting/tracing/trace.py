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
from onnx_ir.passes.common import ShapeInferencePass
from onnxscript import opset18
from torch import nn

from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.sdk.authoring.output_names import output_names
from gsgen.sdk.authoring.packed_module import PackedGenerator
from gsgen.sdk.errors import ExportFailed, GeneratorInvalid
from gsgen.sdk.exporting.tracing.hazards import Hazard, HazardKind, describe_hazard
from gsgen.sdk.exporting.tracing.operator_watch import (
    OperatorWatch,
    missing_operator,
    missing_operator_hint,
)
from gsgen.sdk.exporting.tracing.optimize import optimize
from gsgen.sdk.exporting.tracing.partial_evaluation import (
    ConstantFolding,
    ValueNeeded,
    fold_constants,
)
from gsgen.sdk.exporting.tracing.source_lines import user_line_of
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint

_MAX_HAZARDS = 3
# Kinds of operations by which the value of an input leaves torch without a torch operator.
_GRAPH_LEAK_HAZARDS: tuple[HazardKind, ...] = ("number", "numpy", "rebuilt")
_TRACE_HINT = (
    "Shapes must not depend on data: use masks and torch.where, not boolean indexing, and "
    "keep `.item()`, numpy and Python branches on tensors out of forward."
)


class OperatorMissing(ExportFailed):
    """Raised if a torch module calls an operator that has no ONNX form."""


def trace_generator(
    packed: PackedGenerator,
    example: Probe,
    manifest: GeneratorManifest,
    opset: int,
    hazards: Sequence[Hazard] = (),
    notes: list[str] | None = None,
) -> ir.Model:
    """Trace a torch generator with packed outputs, and return its ONNX graph.

    Where torch cannot, the operations that no input reaches are computed first
    (:mod:`gsgen.sdk.exporting.tracing.partial_evaluation`), and a sentence of ``notes`` says so.
    ``hazards`` explain an error.
    """
    names = TensorNames(tuple(example.inputs), output_names(manifest))
    where = type(packed.generator).__name__
    try:
        return trace_module(packed, example, names, opset, where=where, hazards=hazards)
    except ExportFailed as error:
        folding_result = _fold_constants(packed, example, hazards, error)
        try:
            model = trace_module(folding_result.graph, example, names, opset, where=error.where)
        except OperatorMissing:
            raise error from None  # it has the line of forward, which the folded graph has not
    if notes is not None:
        notes.append(folding_result.describe())
    return model


def _fold_constants(
    packed: PackedGenerator, example: Probe, hazards: Sequence[Hazard], error: ExportFailed
) -> ConstantFolding:
    """Compute what no input reaches; raise the error of the usual trace where that fails, too."""
    if any(hazard.kind in _GRAPH_LEAK_HAZARDS for hazard in hazards):
        raise error  # a value of an input would become a constant
    try:
        return fold_constants(packed, _tensors(example))
    except ValueNeeded as needed:
        hazards_here = [h for h in hazards if needed.where and needed.where in h.where]
        kinds = [h.kind for h in hazards_here] or ["shape" if needed.is_shape else "number"]
        description, hint = describe_hazard(kinds[0])
        raise ExportFailed(
            f"{description}, and torch cannot export it ({needed})",
            where=needed.where or error.where,
            hint=hint,
        ) from error
    except Exception:  # the module's code may raise anything when a mode watches it
        raise error from None


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
    try:
        model = _run_exporter(module, tuple(_tensors(example)), names, opset)
    except GeneratorInvalid:
        raise
    except Exception as error:  # the exporter's errors share no base class
        missing_error = _missing_operator_error(module, example, where, error, hazards)
        raise missing_error or _export_error(where, error, hazards) from error
    _widen_indices(model)
    exported_opset = model.opset_imports.get("", opset)
    if exported_opset != opset:  # torch only logs that it could not convert the graph
        message = f"torch cannot convert the graph to operator set {opset}; it has {exported_opset}"
        raise ExportFailed(message, where="opset", hint=f"Export at operator set {exported_opset}.")
    return model


def _tensors(example: Probe) -> list[torch.Tensor]:
    return [torch.from_numpy(np.array(value)) for value in example.inputs.values()]


def _run_exporter(
    module: nn.Module, arguments: tuple[torch.Tensor, ...], names: TensorNames, opset: int
) -> ir.Model:
    with _silence_exporter():
        onnx_program = torch.onnx.export(
            module,
            arguments,
            dynamo=True,
            input_names=list(names.inputs),
            output_names=list(names.outputs),
            opset_version=opset,
            dynamic_shapes=names.dynamic and (names.dynamic,),
            custom_translation_table=_OPERATOR_TRANSLATIONS,
            optimize=False,
            verbose=False,
        )
        assert onnx_program is not None
        optimize(onnx_program.model)
        return onnx_program.model


def _widen_indices(model: ir.Model) -> None:
    """Cast the int32 indices of GatherND and ScatterND to int64, which ONNX demands of both."""
    nodes = [n for n in model.graph.all_nodes() if n.op_type in ("GatherND", "ScatterND")]
    if any(node.inputs[1] is not None and node.inputs[1].dtype is None for node in nodes):
        ShapeInferencePass(check_type=False, strict_mode=False, data_prop=False)(model)
    for node in nodes:
        indices = node.inputs[1]
        if indices is not None and indices.dtype == ir.DataType.INT32:
            write = InsertionPoint(node)
            int64 = ir.DataType.INT64
            cast_value = write.op("Cast", indices, dtype=int64, shape=indices.shape, to=int(int64))
            node.replace_input_with(1, cast_value)


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


def _missing_operator_error(
    module: nn.Module, example: Probe, name: str, error: BaseException, hazards: Sequence[Hazard]
) -> ExportFailed | None:
    """Return the error for an operator that ONNX has not, with the line of forward that calls it.

    None if the export failed for another reason, or a hazard explains the operator.
    """
    operator, sentence = missing_operator(error)
    if not operator or any(hazard.kind == "linalg" for hazard in hazards):
        return None
    with torch.no_grad(), OperatorWatch() as watch:
        module(*_tensors(example))
    hint = missing_operator_hint(operator, sentence)
    return OperatorMissing(sentence, where=watch.line_of(operator) or name, hint=hint)


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


def _translate_searchsorted(
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


def _translate_prod(values: Any, dims: Sequence[int], **_: Any) -> Any:
    """Translate ``prims.prod``, to which torch reduces ``cumprod``, to the operator ReduceProd."""
    axes = _OPSET18.Constant(value_ints=list(dims))
    return _OPSET18.ReduceProd(values, axes, keepdims=0)


# ONNX forms of torch operators that torch's own exporter does not translate.
_OPERATOR_TRANSLATIONS: dict[Callable[..., Any], Callable[..., Any]] = {
    torch.ops.aten.searchsorted.Tensor: _translate_searchsorted,
    torch.ops.prims.prod.default: _translate_prod,
}
