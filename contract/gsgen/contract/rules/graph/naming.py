"""Rules of naming and storage (GG): unique printable names, and weights as initialisers."""

from collections import Counter
from collections.abc import Iterator

from gsgen.contract._safe_text import is_plain_name
from gsgen.contract.model.graph import Tensor, tensor_bytes
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.units import MEBIBYTE, format_mebibytes
from gsgen.contract.validation.finding import Violation, rename_hint
from gsgen.contract.validation.rule import rule

# A browser holds the file, the runtime's copy and the uploaded weights at the same time.
_MAX_FILE_BYTES = 1500 * MEBIBYTE
# Every pass that edits a node copies its constant, and copies are not shared.
_MAX_CONSTANT_BYTES = MEBIBYTE

_UNKNOWN_TENSOR = Tensor("", None, None)


@rule("GG012", Severity.ERROR, kinds=MANIFEST_KINDS)
def names_are_clean(subject: InspectedModel) -> Iterator[Violation]:
    """Names of nodes are unique, and names of inputs and outputs are printable, without spaces.

    Why:
        ONNX Runtime refuses a model in which two nodes share a name, though ONNX's own checker takes
        it. A name with a blank or a control character looks like another one, and a tool that
        trims it does not find the tensor.

    Hint:
        Rename the nodes; name inputs and outputs with letters, digits, dots, slashes and
        underscores.
    """
    names = Counter(node.name for node in subject.graph.nodes if node.name)
    for name, count in names.items():
        if count > 1:
            yield Violation.at(f"node {name}", f"{count} nodes have this name", "unique node names")
    for kind, tensors in (("input", subject.graph.inputs), ("output", subject.graph.outputs)):
        for tensor in tensors:
            if not is_plain_name(tensor.name):
                where, actual = f"{kind} {tensor.name!r}", "the name contains a blank"
                hint = _clean_hint(tensor.name)
                yield Violation.at(where, actual, "a name without blanks", hint=hint)


def _clean_hint(name: str) -> str:
    characters = (char if is_plain_name(char) else "_" for char in name.strip())
    return rename_hint(name, "".join(characters))


@rule("GG014", Severity.WARNING, kinds=MANIFEST_KINDS)
def weights_are_loadable(subject: InspectedModel) -> Iterator[Violation]:
    """The model file is below 1500 MiB, and large weights are initialisers, not Constant nodes.

    Why:
        A protobuf message ends at 2 GiB, and a browser needs several times the file in memory. A
        constant of a node cannot be stored in a separate file, and optimisers copy it.

    Hint:
        `gsgen rewrite MODEL -o COPY` makes constants initialisers; store them in a file beside the
        model if they are many.
    """
    file = subject.file
    if file.size > _MAX_FILE_BYTES:
        expected = f"{format_mebibytes(_MAX_FILE_BYTES, 0)} at most, and weights beside it"
        yield Violation.at("file", format_mebibytes(file.size, 0), expected)
    for node in subject.graph.all_nodes():
        if node.op_type != "Constant" or not node.output:
            continue
        size = tensor_bytes(subject.graph.tensors.get(node.output[0], _UNKNOWN_TENSOR))
        if size > _MAX_CONSTANT_BYTES:
            actual = f"a constant of {format_mebibytes(size)}"
            yield Violation.at(f"node {node.name or node.output[0]}", actual, "an initialiser")
