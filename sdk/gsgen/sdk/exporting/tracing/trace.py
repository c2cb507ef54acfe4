"""Traces a torch module into an ONNX graph with torch's own exporter."""

__all__ = ["TensorNames", "TracedGenerator", "trace_generator", "trace_module"]

import logging
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, suppress
from dataclasses import dataclass
from io import StringIO
from typing import Any

import numpy as np
import onnx_ir as ir
import torch
from onnx_ir.passes.common import ShapeInferencePass
from torch import nn

from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.sdk.authoring.output_names import output_names
from gsgen.sdk.authoring.packed_module import PackedGenerator
from gsgen.sdk.errors import ExportFailed, GeneratorInvalid
from gsgen.sdk.exporting.tracing.fixed_sizes import SharedMasks
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
from gsgen.sdk.exporting.tracing.translations import OPERATOR_TRANSLATIONS
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint

_MAX_HAZARDS = 3
# Kinds of operations by which the value of an input leaves torch without a torch operator.
_GRAPH_LEAK_HAZARDS: tuple[HazardKind, ...] = ("number", "numpy", "rebuilt")
# Operators of which the values decide how large the result is.
_VALUE_SHAPED_OPERATORS = ("Compress", "NonZero", "Unique")
# Kinds of operations that never make torch's exporter fail.
_TRACEABLE_HAZARDS: tuple[HazardKind, ...] = (
    "changing",
    "data",
    "order",
    "random",
    "state",
    "training",
)
_TRACE_HINT = (
    "The message is torch's own. Leave out parts of forward until it exports, and write the part "
    "that stops it with other operators."
)


class OperatorMissing(ExportFailed):
    """Raised if a torch module calls an operator that has no ONNX form."""


@dataclass(frozen=True, slots=True)
class TracedGenerator:
    """The ONNX graph of a torch generator, and the constants that it was given.

    Attributes:
        model: The graph.
        folding: The operations that were computed before the trace; None if torch traced them all.
        shape_obstacle: The operation of forward that gives the graph a shape which depends on an
            input; None without one.
    """

    model: ir.Model
    folding: ConstantFolding | None = None
    shape_obstacle: ExportFailed | None = None


def trace_generator(
    packed: PackedGenerator,
    example: Probe,
    manifest: GeneratorManifest,
    opset: int,
    hazards: Sequence[Hazard] = (),
) -> TracedGenerator:
    """Trace a torch generator with packed outputs, and return its ONNX graph.

    Where torch cannot, or where a shape of the graph depends on values, the operations that no
    input reaches are computed first (:mod:`gsgen.sdk.exporting.tracing.partial_evaluation`).
    ``hazards`` explain an error.
    """
    names = TensorNames(tuple(example.inputs), output_names(manifest))
    where = type(packed.generator).__name__
    try:
        model = trace_module(packed, example, names, opset, where=where, hazards=hazards)
    except ExportFailed as error:
        if any(hazard.kind == "shape" for hazard in hazards):
            with suppress(ExportFailed):  # the error of the plain module says more
                shared = SharedMasks(packed)
                return TracedGenerator(trace_module(shared, example, names, opset, where=where))
        folding = _fold_constants(packed, example, hazards, error)
        try:
            model = trace_module(folding.graph, example, names, opset, where=error.where)
        except OperatorMissing:
            raise error from None  # it has the line of forward, which the folded graph has not
        return TracedGenerator(model, folding)
    if not any(node.op_type in _VALUE_SHAPED_OPERATORS for node in model.graph.all_nodes()):
        return TracedGenerator(model)
    try:
        obstacle = ExportFailed("a shape depends on values", where=where)
        folding = _fold_constants(packed, example, hazards, obstacle)
        return TracedGenerator(
            trace_module(folding.graph, example, names, opset, where=where), folding
        )
    except ExportFailed as error:  # the passes rewrite most masks that an input reaches
        return TracedGenerator(model, shape_obstacle=error)


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
            custom_translation_table=OPERATOR_TRANSLATIONS,
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
    # A hazard explains the error if it has the error's line. An error without a line has one of the
    # hazards that exports fail at.
    likely_hazards = [
        hazard
        for hazard in hazards
        if (line in hazard.where if line else hazard.kind not in _TRACEABLE_HAZARDS)
    ]
    if not likely_hazards:
        return ExportFailed(message, where=line or name, hint=_TRACE_HINT)
    first = likely_hazards[0]
    return ExportFailed(
        f"{first.description}, and torch cannot export it ({message})",
        where=line or first.where,
        hint="\n  ".join([first.hint, *(str(hazard) for hazard in likely_hazards[1:_MAX_HAZARDS])]),
    )
