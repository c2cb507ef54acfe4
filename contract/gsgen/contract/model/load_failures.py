"""Explains why ONNX Runtime does not load a model: its message, parsed into a cause and a hint.

The kinds are those of ONNX Runtime's loader: the versions that the file declares, operators
without schema or kernel, types that do not fit, shapes that do not fit, and a broken graph.
"""

__all__ = ["LoadFailure", "explain_load_failure"]

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

_PREFIX: Final = re.compile(
    r"\[ONNXRuntimeError\] : \d+ : \w+ : |Load model from \S* ?failed: ?|"
    r"(Exception caught: )?\S+\.(?:cc|h|hpp):\d+ (?:.*? was false\. |.*?\) (?=[A-Z]))|"
    r"This is an invalid model\. |Fatal error: "
)
_MAX_LENGTH: Final = 500
_KERNEL_HINT: Final = (
    "Export it in another form: at operator set 18, in float32, or with other operators."
)


@final
@dataclass(frozen=True, slots=True)
class LoadFailure:
    """Why ONNX Runtime does not load a model.

    Attributes:
        cause: The cause in one line.
        hint: How to repair the model; empty for an unknown kind.
    """

    cause: str
    hint: str = ""


def explain_load_failure(message: str) -> LoadFailure:
    """Parse an error message of ONNX Runtime's loader; an unknown kind keeps its text."""
    text = " ".join(message.split())
    for pattern, explain_failure in _KINDS:
        if match := pattern.search(text):
            return explain_failure(match)
    return LoadFailure(_PREFIX.sub("", text)[:_MAX_LENGTH].strip() or "unknown error")


def _ir_version(match: re.Match[str]) -> LoadFailure:
    actual, most = match.groups()
    return LoadFailure(
        f"the file declares IR version {actual}, and ONNX Runtime reads at most {most}",
        f"Set model.ir_version = 10, unless something else in the file needs IR {actual}: "
        "`gsgen fix MODEL -o COPY` does it.",
    )


def _operator_set(match: re.Match[str]) -> LoadFailure:
    actual, domain, most = match.groups()
    return LoadFailure(
        f"the file declares operator set {actual} of {domain}, and ONNX Runtime supports at most "
        f"{most}",
        f"Export at operator set {most} or lower; `gsgen fix MODEL -o COPY` lowers it where no "
        "operator has changed.",
    )


def _kernel(match: re.Match[str]) -> LoadFailure:
    operator, version, node = match.groups()
    name = f" (node {node!r})" if node else ""
    return LoadFailure(
        f"ONNX Runtime has no kernel for {operator} of operator set {version}{name} with these "
        "types",
        _KERNEL_HINT,
    )


def _unknown_operator(match: re.Match[str]) -> LoadFailure:
    operator = match[1]
    return LoadFailure(
        f"{operator} is not an operator that ONNX Runtime knows",
        "Export without custom operators: write the operation with standard ones.",
    )


def _unknown_node(match: re.Match[str]) -> LoadFailure:
    node, operator, domain, fault = match.groups()
    name = f"{domain}.{operator}" if domain else operator
    if fault.startswith("No Op registered"):
        version = fault.rsplit(" ", 1)[-1].rstrip(".")
        return LoadFailure(
            f"operator set {version} has no operator {name} (node {node!r})",
            "Export with operators of the declared set, or declare the set that has it.",
        )
    if fault.startswith("No opset import"):
        return LoadFailure(
            f"the file declares no version of the domain {domain!r} of {operator} (node {node!r})",
            "Export without custom operators: write the operation with standard ones.",
        )
    return LoadFailure(
        f"node {node!r} ({name}) is invalid: {fault[:200]}", "Export the model again."
    )


def _mixed_types_failure(match: re.Match[str]) -> LoadFailure:
    operator, first, second, node = match.groups()
    return LoadFailure(
        f"{operator} (node {node!r}) gets {first} and {second}, expected one type",
        "Cast one of them; in torch, call .float() on weights and values below float32.",
    )


def _output_type(match: re.Match[str]) -> LoadFailure:
    declared, value, node, computed = match.groups()
    return LoadFailure(
        f"{value} (node {node!r}) is declared {declared}, but is {computed}",
        "Declare the type that the node computes, or add a Cast.",
    )


def _input_type(match: re.Match[str]) -> LoadFailure:
    actual, value, operator, node = match.groups()
    return LoadFailure(
        f"{operator} (node {node!r}) does not take {actual}, the type of {value}",
        "Cast it; in torch, call .float() on weights and values below float32.",
    )


def _shapes(match: re.Match[str]) -> LoadFailure:
    node, operator, fault = match.groups()
    return LoadFailure(
        f"shapes at node {node!r} ({operator}) do not fit: {fault[:200]}",
        "Export again with inputs of the sizes that the model is run with.",
    )


def _dangling_input_failure(match: re.Match[str]) -> LoadFailure:
    return LoadFailure(
        f"{match[1]!r} is read by a node, but nothing computes it", "Export the model again."
    )


def _cycle(match: re.Match[str]) -> LoadFailure:
    return LoadFailure("the graph has a cycle", "Export the model again.")


def _not_onnx_error(match: re.Match[str]) -> LoadFailure:
    return LoadFailure("the file is not an ONNX model, or is cut off", "Copy the file again.")


_KINDS: Final[tuple[tuple[re.Pattern[str], Callable[[re.Match[str]], LoadFailure]], ...]] = (
    (re.compile(r"Unsupported model IR version: (\d+), max supported IR version: (\d+)"), _ir_version),
    (
        re.compile(r"Opset (\d+) is under development .* for domain (\S+) is till opset (\d+)"),
        _operator_set,
    ),
    (
        re.compile(r"Could not find an implementation for (\w+)\((\d+)\) node with name '(.*?)'"),
        _kernel,
    ),
    (re.compile(r"(\S+?)(?:\(-?\d+\))? is not a registered function/op"), _unknown_operator),
    (re.compile(r'In Node, \("(.*?)", (\w+), "(.*?)", .*?, Error (.+)$'), _unknown_node),
    (
        re.compile(
            r"of Optype \((\w+)\) bound to different types \((\S+) and (\S+?\))\)? in node \((.*?)\)"
        ),
        _mixed_types_failure,
    ),
    (
        re.compile(
            r"Type \((\S+)\) of output arg \((.*?)\) of node \((.*?)\) does not match expected "
            r"type \((\S+)\)"
        ),
        _output_type,
    ),
    (
        re.compile(
            r"Type '(.*?)' of input parameter \((.*?)\) of operator \((\w+)\) in node \((.*?)\)"
        ),
        _input_type,
    ),
    (re.compile(r"Node \((.*?)\) Op \((\w+)\) \[\w+\] (.+)$"), _shapes),
    (re.compile(r"Node input '(.*?)' is not a graph input"), _dangling_input_failure),
    (re.compile(r"graph is not acyclic"), _cycle),
    (re.compile(r"protobuf parsing failed|ModelProto does not have a graph"), _not_onnx_error),
)  # fmt: skip
