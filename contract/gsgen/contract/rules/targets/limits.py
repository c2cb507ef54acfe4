"""Rules of buffers (GL): outputs and weights fit the target's GPU buffer limits."""

from collections.abc import Iterator

from gsgen.contract.model.graph import Graph, Tensor, names_read, tensor_bytes
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.model.provider_placement import frame_nodes
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.units import format_mebibytes
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.rule import rule


def _buffers(subject: InspectedModel) -> Iterator[tuple[str, int]]:
    graph = subject.graph
    for tensor in graph.outputs:
        yield f"output {tensor.name}", tensor_bytes(tensor)
    for name, tensor in graph.initializers.items():
        yield f"weight {name}", tensor_bytes(tensor)
    for tensor in _constant_tensors(graph):
        yield f"tensor {tensor.name}, computed from weights", tensor_bytes(tensor)


def _constant_tensors(graph: Graph) -> Iterator[Tensor]:
    """Yield the tensors that a runtime computes once at loading and reads every frame."""
    executed_nodes = frame_nodes(graph)
    frame_tensors = {name for node in executed_nodes for name in node.output}
    outputs = {tensor.name for tensor in graph.outputs}
    for name in dict.fromkeys(name for node in executed_nodes for name in names_read(node)):
        if name in graph.producers and name not in frame_tensors and name not in outputs:
            tensor = graph.tensors.get(name)
            if tensor is not None:
                yield tensor


def _mebibyte_text(size: int) -> str:
    return f"{format_mebibytes(size)} ({size} bytes)"


def _oversized_buffers(subject: InspectedModel, limit: int) -> Iterator[Violation]:
    """Yield a violation for each output or weight, as stored or unpacked, above ``limit`` bytes."""
    for location, size in _buffers(subject):
        if size > limit:
            yield Violation.at(location, _mebibyte_text(size), f"{_mebibyte_text(limit)} at most")


@rule("GL001", Severity.ERROR, kinds=MANIFEST_KINDS, limit="binding_bytes", needs=("GL002",))
def fits_binding(subject: InspectedModel) -> Iterator[Violation]:
    """Every output and weight fits one storage buffer binding of the target's GPU.

    Why:
        WebGPU guarantees 128 MiB a binding. Beyond it onnxruntime-web 1.22 returns zeros; newer
        ones split the buffer, and pay for it. A tensor computed from weights alone is a buffer, too,
        once a runtime has loaded the model: a table of 16 bits a number that is read as float32
        is twice as large as in the file.

    Hint:
        Use float16, fewer SH degrees or a smaller capacity, or split the model.
    """
    yield from _oversized_buffers(subject, subject.target.limits["binding_bytes"])


@rule("GL002", Severity.ERROR, kinds=MANIFEST_KINDS, limit="buffer_bytes")
def fits_buffer(subject: InspectedModel) -> Iterator[Violation]:
    """Every output and weight fits one buffer of the target's GPU.

    Why:
        WebGPU guarantees buffers of 256 MiB; creating a larger one fails on many devices. A tensor
        computed from weights alone at loading, such as a table unpacked to float32, is one, too.

    Hint:
        Use float16, fewer SH degrees or a smaller capacity, or split the model.
    """
    yield from _oversized_buffers(subject, subject.target.limits["buffer_bytes"])


@rule("GL003", Severity.ERROR, needs=("GO004", "GL001", "GL002"), limit="workgroups")
def fits_dispatch(subject: InspectedModel) -> Iterator[Violation]:
    """One GPU compute dispatch can process every packed row.

    Why:
        WebGPU launches at most 65,535 workgroups along an axis. With 256 rows a workgroup, rows
        beyond 16,776,960 are never visited.

    Hint:
        Lower the capacity, or split the model.
    """
    limits = subject.target.limits
    max_invocations = limits["workgroups"] * limits["workgroup_size"]
    tensor = subject.gaussians
    rows = tensor.dims[0] if tensor is not None and tensor.dims else 0
    if tensor is not None and isinstance(rows, int) and rows > max_invocations:
        yield Violation.at(
            f"output {tensor.name}", f"{rows} rows", f"{max_invocations} rows at most"
        )
