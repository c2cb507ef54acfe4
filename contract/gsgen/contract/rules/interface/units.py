"""Rules of units (GI): the graph reads numbers in the unit and the range that are declared."""

from collections.abc import Iterator
from math import isclose
from typing import Final, NamedTuple

import numpy as np
from onnx import NodeProto, TensorProto

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.model.model_file import small_array
from gsgen.contract.rules.interface.input_declarations import declared_inputs
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.manifest import Input, PostProcessManifest, TrajectoryManifest
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.rule import rule

# Steps between predicted cameras, in seconds: those of displays and trackers take 0.004 to 1.
_MAX_STEP_SECONDS = 10.0
# A time of at most this length is one in seconds, or a share: a thousandth of it stands still.
_MAX_SECONDS = 60.0
_MAX_DEPTH = 12
_VIEWS: Final = frozenset({"Identity", "Cast", "Reshape", "Squeeze", "Unsqueeze", "Flatten",
                           "Transpose", "Expand"})  # fmt: skip
_UNIT_RANGE, _SIGNED_RANGE = (0.0, 1.0), (-1.0, 1.0)


class _Use(NamedTuple):
    """How the graph first computes with an input: ``scale`` · x + ``offset``.

    Attributes:
        scale: The factor.
        offset: The summand.
        is_shifted_first: Whether a number was added before the factor.
    """

    scale: float
    offset: float
    is_shifted_first: bool


@rule(
    "GI037",
    Severity.WARNING,
    needs=("GM004", "GG019", "GI013", "GI017"),
    kinds=MANIFEST_KINDS,
    explained_by=("GB064",),  # which measures what is left of a picture's contrast
)
def units_as_declared(subject: InspectedModel) -> Iterator[Violation]:
    """The first operations on a time or a picture suit its range, and steps of time are seconds.

    Why:
        A network keeps the unit of its training. One that was trained with times or colours from
        −1 to 1 begins with (x + 1) / 2: fed with 0 to 1, it plays the second half alone, or all
        colours pale. A time in milliseconds stands still.

    Hint:
        Declare the range that the first operations expect, or remove them. If they are part of
        the scene, ignore this rule.
    """
    manifest = subject.manifest
    if isinstance(manifest, TrajectoryManifest) and manifest.step_seconds > _MAX_STEP_SECONDS:
        actual = f"{manifest.step_seconds:g} seconds from state to state"
        hint = "Divide by 1000 if these are milliseconds."
        yield Violation.at(
            "manifest step_seconds", actual, "a step in seconds", certainty="possible", hint=hint
        )
    for entry in declared_inputs(subject):
        span = _range_of(subject, entry)
        faults = (_fault_of(use, *span) for use in _uses(subject, entry.name)) if span else ()
        fault = next((words for words in faults if words), None)
        if fault and span:
            expected = f"operations for the range {list(span)}"
            yield Violation.at(
                f"input {entry.name}", fault[0], expected, certainty="possible", hint=fault[1]
            )


def _range_of(subject: InspectedModel, entry: Input) -> tuple[float, float] | None:
    """Return the declared range of a time or a picture; None for other inputs."""
    manifest = subject.manifest
    if entry.role == "image" and isinstance(manifest, PostProcessManifest):
        return manifest.image_range
    return entry.range or _UNIT_RANGE if entry.role in ("time", "image") else None


def _fault_of(use: _Use, low: float, high: float) -> tuple[str, str] | None:
    """Return the unit or range that operations expect, in words, and a hint; None if it fits."""

    def maps(ends: tuple[float, float], to: tuple[float, float]) -> bool:
        seen = [use.scale * end + use.offset for end in ends]
        return all(isclose(a, b, abs_tol=1e-5) for a, b in zip(seen, to, strict=True))

    if use.is_shifted_first and (low, high) == _UNIT_RANGE and maps(_SIGNED_RANGE, _UNIT_RANGE):
        return "(x + 1) / 2 comes first: a range of [-1, 1]", 'Declare "range": [-1, 1].'
    if (low, high) == _SIGNED_RANGE and maps(_UNIT_RANGE, _SIGNED_RANGE):
        return "2 x − 1 comes first: a range of [0, 1]", 'Declare "range": [0, 1].'
    if use.offset == 0 and high <= 1 and isclose(use.scale, 1 / 255, rel_tol=1e-4):
        return "a division by 255 comes first: bytes", "Remove the division by 255."
    if use.offset == 0 and high <= _MAX_SECONDS and isclose(use.scale, 1e-3, rel_tol=1e-4):
        return "a division by 1000 comes first: milliseconds", "Remove the division by 1000."
    return None


def _uses(subject: InspectedModel, name: str) -> Iterator[_Use]:
    """Yield what an input becomes after each view, sum with a number and factor, one by one."""
    readers: dict[str, list[NodeProto]] = {}
    for node in subject.graph.nodes:
        for read in dict.fromkeys(node.input):
            readers.setdefault(read, []).append(node)
    weights = {tensor.name: tensor for tensor in subject.file.proto.graph.initializer}
    for node in subject.graph.nodes:
        if node.op_type == "Constant" and node.attribute and node.attribute[0].HasField("t"):
            weights[node.output[0]] = node.attribute[0].t
    pending, seen = [(name, 1.0, 0.0, False, 0)], set[tuple[str, _Use]]()
    while pending:
        tensor, scale, offset, is_shifted, depth = pending.pop()
        for node in readers.get(tensor, ()) if depth < _MAX_DEPTH else ():
            step = _affine_step(node, tensor, weights)
            if step is None:
                continue
            factor, summand = step
            is_first = is_shifted or (summand != 0 and scale == 1.0)
            use = _Use(factor * scale, factor * offset + summand, is_first)
            if (node.output[0], use) not in seen:
                seen.add((node.output[0], use))
                pending.append((node.output[0], *use, depth + 1))
                yield use


def _affine_step(
    node: NodeProto, tensor: str, weights: dict[str, TensorProto]
) -> tuple[float, float] | None:
    """Return factor and summand of an operator on a tensor; None if it does something else."""
    if node.op_type in _VIEWS:
        return (1.0, 0.0) if node.input[0] == tensor else None
    if node.op_type == "Neg":
        return -1.0, 0.0
    if node.op_type not in ("Add", "Sub", "Mul", "Div") or len(node.input) != 2:
        return None
    is_left = node.input[0] == tensor
    number = _uniform_number(weights.get(node.input[1 if is_left else 0]))
    if number is None or (node.op_type == "Div" and (not is_left or number == 0)):
        return None
    return {
        "Add": (1.0, number),
        "Sub": (1.0, -number) if is_left else (-1.0, number),
        "Mul": (number, 0.0),
        "Div": (1 / number if number else 0.0, 0.0),
    }[node.op_type]


def _uniform_number(weight: TensorProto | None) -> float | None:
    """Return the number that all elements of a small weight are; None if they differ."""
    array = small_array(weight) if weight is not None and np.prod(weight.dims) <= 64 else None
    is_uniform = array is not None and array.size and (array == array.reshape(-1)[0]).all()
    return float(array.reshape(-1)[0]) if array is not None and is_uniform else None
