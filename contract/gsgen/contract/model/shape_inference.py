"""ONNX's shape inference with limits on time and memory, for untrusted models.

Two things in a small file take ONNX's library hours and all memory. Functions that call functions
are expanded at every call, 2ⁿ times where each calls the next one twice. And *data propagation*,
which follows shapes that are computed inside a graph, keeps one entry for each element of a vector,
be it one of two thousand million weights. So functions are counted first; and data is propagated
only where something is still unknown without, in a child process if vectors may be long.
"""

__all__ = ["first_line", "infer", "propagate"]

import subprocess
import sys

import onnx
from google.protobuf.message import DecodeError
from onnx import FunctionProto, GraphProto, ModelProto, ValueInfoProto

from gsgen.contract.model.model_file import subgraphs

# Exceptions of ONNX's library besides its own error.
_INFERENCE_ERRORS = (
    onnx.shape_inference.InferenceError,
    onnx.checker.ValidationError,
    ValueError,
    RuntimeError,
    MemoryError,
)
_MAX_EXPANDED_NODES = 20_000
_MAX_MESSAGE_LENGTH = 4096
# Limits of the child. If it exceeds them, the result without propagation is used.
_MAX_SECONDS, _MAX_MEMORY_BYTES = 5.0, 1 << 30


def infer(proto: ModelProto) -> tuple[ModelProto | None, str]:
    """Run ONNX shape inference; return the model with types, and ONNX's error message or "".

    No data is propagated: where sizes are unknown, :func:`propagate` may find them.
    """
    if _expanded_node_count(proto) > _MAX_EXPANDED_NODES:
        return None, f"its functions expand to more than {_MAX_EXPANDED_NODES} nodes"
    return _infer_strictly(proto)


def propagate(proto: ModelProto, inferred: ModelProto) -> tuple[ModelProto, str]:
    """Run ONNX shape inference again, now with data propagation (values of shape tensors)."""
    if _may_have_long_constants(inferred):
        return _propagate_in_subprocess(proto) or inferred, ""
    try:
        return _propagate_data(proto, strict=True), ""
    except _INFERENCE_ERRORS as error:
        return inferred, first_line(error)


def _infer_strictly(proto: ModelProto) -> tuple[ModelProto | None, str]:
    run = onnx.shape_inference.infer_shapes
    try:
        return run(proto, check_type=True, strict_mode=True), ""
    except _INFERENCE_ERRORS as error:
        fault = first_line(error)
    try:
        return run(proto), fault
    except _INFERENCE_ERRORS:
        return None, fault  # the fault is already noted


def _propagate_data(proto: ModelProto, *, strict: bool) -> ModelProto:
    run = onnx.shape_inference.infer_shapes
    return run(proto, check_type=strict, strict_mode=strict, data_prop=True)


def _expanded_node_count(proto: ModelProto) -> int:
    """Return the number of nodes in a model after every function call is inlined."""
    if not proto.functions:
        return 0
    functions = {(function.domain, function.name): function for function in proto.functions}
    sizes: dict[tuple[str, str], int] = {}

    def size(body: GraphProto | FunctionProto) -> int:
        total = 0
        for node in body.node:
            key = node.domain, node.op_type
            if key in functions and key not in sizes:
                sizes[key] = 0  # a function that calls itself is refused by ONNX
                sizes[key] = size(functions[key])
            total += 1 + sizes.get(key, 0)
            total += sum(size(g) for a in node.attribute for g in subgraphs(a))
        return min(total, 2 * _MAX_EXPANDED_NODES)

    return size(proto.graph)


def _may_have_long_constants(proto: ModelProto) -> bool:
    """Return whether ONNX's data propagation may take long, because a vector is large."""
    graph = proto.graph
    if proto.functions or any(subgraphs(a) for node in graph.node for a in node.attribute):
        return True  # its elements are unknown
    values = (*graph.input, *graph.value_info, *graph.output)
    known = {value.name for value in values}
    outputs = [name for node in graph.node for name in node.output if name]
    weights = any(
        len(initializer.dims) == 1 and initializer.dims[0] > _MAX_MESSAGE_LENGTH
        for initializer in graph.initializer
    )
    return weights or any(map(_is_long_constant, values)) or not known.issuperset(outputs)


def _is_long_constant(value: ValueInfoProto) -> bool:
    kind = value.type.tensor_type
    if not kind.HasField("shape"):
        return True
    dims = kind.shape.dim
    return len(dims) == 1 and not (
        dims[0].HasField("dim_value") and dims[0].dim_value <= _MAX_MESSAGE_LENGTH
    )


def _propagate_in_subprocess(proto: ModelProto) -> ModelProto | None:
    """Run ONNX data propagation in a child process; return None if it fails or exceeds limits."""
    from gsgen.contract.process.parent_watchdog import python_command

    try:
        finished_process = subprocess.run(
            [*python_command(), "-m", "gsgen.contract.model.shape_inference"],
            input=proto.SerializeToString(),
            capture_output=True,
            timeout=_MAX_SECONDS,
            check=False,
        )
        return (
            ModelProto.FromString(finished_process.stdout)
            if finished_process.returncode == 0
            else None
        )
    except (subprocess.TimeoutExpired, DecodeError, ValueError):
        return None


def _run_child_process() -> int:
    from gsgen.contract.process.limits import limit_memory

    limit_memory(_MAX_MEMORY_BYTES)
    proto = ModelProto.FromString(sys.stdin.buffer.read())
    try:
        inferred = _propagate_data(proto, strict=False)
    except _INFERENCE_ERRORS:
        return 1
    sys.stdout.buffer.write(inferred.SerializeToString())
    return 0


def first_line(error: Exception) -> str:
    """Return the first line of an error message of the ONNX library."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return " ".join(lines)[:300] or type(error).__name__


if __name__ == "__main__":
    from gsgen.contract.process.parent_watchdog import exit_with_parent

    exit_with_parent()
    sys.exit(_run_child_process())
