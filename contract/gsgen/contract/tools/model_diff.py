"""Compares two models: their declarations, their graphs and their outputs."""

__all__ = ["Difference", "OutputDifference", "compare_models"]

from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.contract.model.inspected_model import InspectedModel, inspect_model
from gsgen.contract.model.model_file import open_model
from gsgen.contract.probing.probe_plan import make_plan
from gsgen.contract.probing.sandbox import Execution, execute
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.fields.json_schema import to_json
from gsgen.contract.spec.manifest_io import dumps
from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.targets import load_target

_ABSENT_VALUE_TEXT = "(absent)"


@dataclass(frozen=True, slots=True)
class Difference:
    """One difference between the declarations or graphs of two models.

    Attributes:
        kind: ``contract`` or ``graph``.
        name: The name of the compared fact: ``outputs.gaussians.dtype`` or ``operator MatMul``.
        first: Its value in the first model.
        second: Its value in the second model.
    """

    kind: str
    name: str
    first: str
    second: str


@dataclass(frozen=True, slots=True)
class OutputDifference:
    """The largest difference between two models in one output, over all test inputs.

    Attributes:
        role: ``gaussians``, ``appearance``, ``count`` or ``cells``.
        largest: The largest absolute difference; infinite where shapes differ.
        rows: The number of rows that differ at the worst probe.
        probe: Label of that probe.
    """

    role: str
    largest: float
    rows: int
    probe: str


def compare_models(
    first: Path, second: Path, limits: Limits | None = None
) -> tuple[list[Difference], list[OutputDifference], str]:
    """Compare the declarations, graphs and outputs of two models.

    Returns:
        The differences of contract and graph, those of outputs, and the reason why outputs
        could not be compared (empty if they were).

    Raises:
        ModelUnreadable: One of the files is not an ONNX model.
    """
    limits, target = limits or Limits(), load_target("core")
    a, b = (inspect_model(open_model(path), target, limits) for path in (first, second))
    facts = [*_contract_differences(a, b), *_graph_differences(a, b)]
    reason = _incomparable_reason(a, b)
    if reason:
        return facts, [], reason
    outputs, reason = _outputs(a, b)
    return facts, outputs, reason


def _contract_differences(a: InspectedModel, b: InspectedModel) -> Iterator[Difference]:
    yield from _differing_entries("contract", _declared_fields(a), _declared_fields(b))


def _declared_fields(subject: InspectedModel) -> dict[str, str]:
    if subject.parsed is None or subject.manifest is None:
        return {"manifest": _ABSENT_VALUE_TEXT if subject.parsed is None else "(invalid)"}
    dumps(subject.manifest)  # raises for a manifest that cannot be written
    return dict(_flatten_value("", to_json(subject.manifest)))


def _flatten_value(prefix: str, value: Any) -> Iterator[tuple[str, str]]:
    if isinstance(value, dict):
        for key, nested_value in value.items():
            yield from _flatten_value(f"{prefix}.{key}" if prefix else key, nested_value)
    elif isinstance(value, list) and any(isinstance(item, dict) for item in value):
        for index, nested_value in enumerate(value):
            name = nested_value.get("name", index) if isinstance(nested_value, dict) else index
            yield from _flatten_value(f"{prefix}[{name}]", nested_value)
    else:
        yield prefix, str(value)


def _graph_differences(a: InspectedModel, b: InspectedModel) -> Iterator[Difference]:
    yield from _differing_entries("graph", _structure(a), _structure(b))


def _structure(subject: InspectedModel) -> dict[str, str]:
    graph, proto = subject.graph, subject.file.proto
    facts = {f"opset {e.domain or 'ai.onnx'}": str(e.version) for e in proto.opset_import}
    facts |= {f"input {tensor.name}": str(tensor) for tensor in graph.inputs}
    facts |= {f"output {tensor.name}": str(tensor) for tensor in graph.outputs}
    operators = Counter(node.op_type for node in graph.all_nodes())
    facts |= {f"operator {name}": f"{count} nodes" for name, count in operators.items()}
    sizes = Counter(str(tensor) for tensor in graph.initializers.values())
    return facts | {f"weights {shape}": f"{count} of them" for shape, count in sizes.items()}


def _differing_entries(kind: str, a: dict[str, str], b: dict[str, str]) -> Iterator[Difference]:
    for name in dict.fromkeys([*a, *b]):
        first, second = a.get(name, _ABSENT_VALUE_TEXT), b.get(name, _ABSENT_VALUE_TEXT)
        if first != second:
            yield Difference(kind, name, first, second)


def _incomparable_reason(a: InspectedModel, b: InspectedModel) -> str:
    """Return the reason why two models' outputs cannot be compared; empty if they can."""
    for subject in (a, b):
        if subject.generator is None or not subject.output_names:
            return f"{subject.file.path.name} is not a Gaussian Generator"
    if a.graph.inputs != b.graph.inputs:
        return "the models take different inputs"
    return ""


def _outputs(a: InspectedModel, b: InspectedModel) -> tuple[list[OutputDifference], str]:
    plan = make_plan(a, Level.VALUES)
    with ExitStack() as stack:
        runs: list[Execution] = []
        for subject in (a, b):
            names = [name for name in subject.output_names if subject.graph.output(name)]
            job = execute(subject.file.path, names, plan.probes, subject.sandbox_limits)
            runs.append(stack.enter_context(job))
            fault = runs[-1].fault
            if fault is not None:
                return [], f"{subject.file.path.name} does not run: {fault.message}"
        labels = [probe.label for probe in plan.probes]
        return list(_output_differences(a, b, runs, labels)), ""


def _output_differences(
    a: InspectedModel, b: InspectedModel, runs: list[Execution], labels: list[str]
) -> Iterator[OutputDifference]:
    for role in ("gaussians", "appearance", "count", "cells"):
        first, second = getattr(a, f"declared_{role}"), getattr(b, f"declared_{role}")
        if first is None or second is None:
            continue
        worst_difference = OutputDifference(role, 0.0, 0, "")
        for index, label in enumerate(labels):
            x = runs[0].samples[runs[0].runs[index].sample].outputs[first.name]
            y = runs[1].samples[runs[1].runs[index].sample].outputs[second.name]
            if role == "appearance" and _is_rgb(a) and _is_rgb(b):
                x, y = (x[..., :3], y[..., :3])  # the fourth channel of float16 rows is padding
            largest, rows = _largest_distance(x, y)
            if largest > worst_difference.largest:
                worst_difference = OutputDifference(role, largest, rows, label)
        yield worst_difference


def _is_rgb(subject: InspectedModel) -> bool:
    declared = subject.declared_appearance
    return declared is not None and declared.space == "rgb"


def _largest_distance(x: np.ndarray, y: np.ndarray) -> tuple[float, int]:
    if x.shape != y.shape:
        return float("inf"), max(len(x), len(y))
    abs_difference = np.abs(x.astype(np.float64) - y.astype(np.float64))
    both_nan_mask = np.isnan(x.astype(np.float64)) & np.isnan(y.astype(np.float64))
    abs_difference = np.where(
        both_nan_mask | (x == y), 0.0, np.nan_to_num(abs_difference, nan=np.inf, posinf=np.inf)
    )
    rows = (
        abs_difference.reshape(len(abs_difference), -1).max(axis=1)
        if abs_difference.size
        else np.zeros(0)
    )
    return float(abs_difference.max(initial=0)), int(np.count_nonzero(rows))
