"""Rules of graph outputs (GO): each output is computed, distinct and declared."""

from collections import Counter
from collections.abc import Iterator

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.rule import rule


@rule("GO013", Severity.WARNING, kinds=MANIFEST_KINDS, needs=("GG019",))
def outputs_are_computed(subject: InspectedModel) -> Iterator[Violation]:
    """Every output except a constant row count is computed by an operator, and is not a weight.

    Why:
        Exporters and optimisers rename weights: the output's name is lost, and has been repaired by
        string surgery before. Some runtimes cannot bind a buffer to it. The count is one number,
        which the contract asks to be a constant where it never changes.

    Hint:
        End the output on an operator, such as Mul by one; Identity may be removed again.
    """
    count = subject.declared_count
    for tensor in subject.graph.outputs:
        is_count = count is not None and tensor.name == count.name
        if tensor.name in subject.graph.initializers and not is_count:
            yield Violation.at(f"output {tensor.name}", "a weight", "the result of an operator")


@rule("GO014", Severity.ERROR, kinds=MANIFEST_KINDS)
def outputs_are_distinct(subject: InspectedModel) -> Iterator[Violation]:
    """No tensor is listed as a graph output twice.

    Why:
        Two buffers are bound to one name. A recorded frame writes one of them, and the other keeps
        what it held at first.

    Hint:
        Remove the second entry, or give it a tensor of its own through Mul by one.
    """
    for name, count in Counter(subject.graph.output_names).items():
        if count > 1:
            yield Violation.at(f"output {name}", f"listed {count} times", "listed once")


@rule(
    "GO017",
    Severity.WARNING,
    kinds=MANIFEST_KINDS,
    needs=("GM004", "GO001", "GO005", "GO010", "TV102"),
)
def outputs_declared(subject: InspectedModel) -> Iterator[Violation]:
    """Every output of the graph is declared in the manifest.

    Why:
        A runtime that fetches all outputs computes and copies it every frame, and viewers that go
        by names may take it for the colour.

    Hint:
        Remove the output from the graph.
    """
    declared = subject.output_names
    for name in dict.fromkeys(subject.graph.output_names):
        is_graph_input = subject.graph.input(name) is not None  # another rule reports it
        if declared and name not in declared and not is_graph_input:
            yield Violation.at(f"output {name}", "not declared", f"only {', '.join(declared)}")
