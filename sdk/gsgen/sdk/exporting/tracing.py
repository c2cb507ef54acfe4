"""Turn a packed generator into an ONNX graph, with torch's own exporter."""

__all__ = ["Named", "trace", "trace_module"]

import logging
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass
from io import StringIO
from typing import Any

import numpy as np
import onnx_ir as ir
import torch
from torch import nn

from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.sdk.authoring.packed_module import PackedGenerator, output_names
from gsgen.sdk.errors import ExportFailed, GeneratorInvalid
from gsgen.sdk.exporting.source_lines import line_of
from gsgen.sdk.exporting.trace_hazards import Hazard

_MOST = 3
_MEND = (
    "Shapes must not depend on data: use masks and torch.where instead of boolean indexing, and "
    "keep `.item()`, numpy and Python branches on tensors out of forward."
)


def trace(
    packed: PackedGenerator,
    example: Probe,
    manifest: GeneratorManifest,
    opset: int,
    hazards: Sequence[Hazard] = (),
) -> ir.Model:
    """Export ``packed`` with ``torch.onnx.export(dynamo=True)`` and return the graph.

    Args:
        packed: The module.
        example: The inputs that it is traced with.
        manifest: Names the outputs.
        opset: ONNX operator set.
        hazards: What was seen while it ran, to explain a refusal.

    Raises:
        ExportFailed: The exporter refused the module; the message names the line of its code.
    """
    named = Named(tuple(example.inputs), output_names(manifest))
    where = type(packed.generator).__name__
    return trace_module(packed, example, named, opset, where=where, hazards=hazards)


@dataclass(frozen=True, slots=True)
class Named:
    """What the tensors of a graph are called.

    Attributes:
        inputs: In the order of the module's arguments.
        outputs: In the order of what it returns.
        dynamic: For each argument, axis → the name of its size; all sizes are fixed where absent.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dynamic: tuple[dict[int, Any], ...] | None = None


def trace_module(
    module: nn.Module,
    example: Probe,
    named: Named,
    opset: int,
    *,
    where: str,
    hazards: Sequence[Hazard] = (),
) -> ir.Model:
    """Export any module with ``torch.onnx.export(dynamo=True)`` and return the graph.

    Args:
        module: What to export.
        example: The inputs that it is traced with.
        named: Names of inputs and outputs.
        opset: ONNX operator set.
        where: What the module is called in an error.
        hazards: What was seen while it ran, to explain a refusal.

    Raises:
        ExportFailed: The exporter refused the module; the message names the line of its code.
    """
    arguments = tuple(
        torch.from_numpy(np.array(value)) for value in example.inputs.values()
    )
    try:
        with _quiet():
            program = torch.onnx.export(
                module,
                arguments,
                dynamo=True,
                input_names=list(named.inputs),
                output_names=list(named.outputs),
                opset_version=opset,
                dynamic_shapes=named.dynamic and (named.dynamic,),
                verbose=False,
            )
    except GeneratorInvalid:
        raise
    except Exception as error:  # the exporter's errors share no base class
        raise _explained(where, error, hazards) from error
    assert program is not None
    made = program.model.opset_imports.get("", opset)
    if made != opset:  # torch leaves it at that, with a note in its log
        what = f"torch cannot convert the graph to operator set {opset}; it has {made}"
        raise ExportFailed(what, where="opset", hint=f"Export at operator set {made}.")
    return program.model


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep torch's notes on operators, failed attempts and graphs to itself."""
    level = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        # Graphs of failed attempts are printed, not logged.
        with warnings.catch_warnings(), torch.no_grad(), redirect_stderr(StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(level)


def _explained(name: str, error: BaseException, hazards: Sequence[Hazard]) -> ExportFailed:
    """Say what torch says first, in which line of the user's, and what to write instead."""
    root: BaseException = error
    while root.__cause__ is not None:
        root = root.__cause__
    reason = next(
        (line for line in str(root).splitlines() if line.strip()), type(root).__name__
    )
    what = f"{type(root).__name__}: {reason.strip()[:300]}"
    line = line_of(root)
    likely = [one for one in hazards if line and line in one.where] or list(hazards)
    if not likely:
        return ExportFailed(what, where=line or name, hint=_MEND)
    first = likely[0]
    return ExportFailed(
        f"{first.what}, and torch cannot export it ({what})",
        where=line or first.where,
        hint="\n  ".join([first.hint, *(str(one) for one in likely[1:_MOST])]),
    )
