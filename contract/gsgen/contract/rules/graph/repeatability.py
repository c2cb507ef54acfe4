"""Validation rules of repeatability: each frame runs the same operators on fixed shapes."""

from collections.abc import Iterator
from itertools import chain

from onnx import NodeProto, TensorProto

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.model.model_file import small_array
from gsgen.contract.model.provider_placement import DATA_SIZED_OPERATORS
from gsgen.contract.spec.fields.roles import GENERATOR, MANIFEST_KINDS, POST_PROCESS
from gsgen.contract.spec.manifest import PostProcessManifest
from gsgen.contract.spec.onnx_facts import MAIN_DOMAIN, RANDOM_OPERATORS
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.gates import MANIFEST_PARSED, WELL_FORMED
from gsgen.contract.validation.rule import rule

# Training layers draw by these operators, which a network has no other use for.
_RANDOM_TRAINING_OPERATORS = frozenset({"Bernoulli"})
_TRAINING_FLAG = 2  # the input of Dropout that switches it on


def _all_nodes(subject: InspectedModel) -> Iterator[NodeProto]:
    """Yield the standard ONNX nodes that the outputs need, in subgraphs and functions too."""
    graph = subject.graph
    needed_nodes = {
        id(node) for tensor in graph.outputs for node in graph.ancestors(tensor.name)[1]
    }
    idle_nodes = {id(node) for node in graph.nodes} - needed_nodes
    functions = (node for function in subject.file.proto.functions for node in function.node)
    for node in chain(graph.all_nodes(), functions):
        if node.domain in MAIN_DOMAIN and id(node) not in idle_nodes:
            yield node


def _location(node: NodeProto) -> str:
    return f"node {node.name or (node.output[0] if node.output else '')} ({node.op_type})"


@rule("GG010", Severity.ERROR, kinds=MANIFEST_KINDS, needs=("GG025",))
def no_random_operators(subject: InspectedModel) -> Iterator[Violation]:
    """No output is computed from random numbers, with or without a seed.

    Why:
        The same camera and time would give another picture every frame and on every machine. A
        seed is no cure: ONNX Runtime's generator goes on from run to run.

    Hint:
        Draw the numbers before export and store them as weights.
    """
    for node in _all_nodes(subject):
        if node.op_type in RANDOM_OPERATORS:
            has_seed_attribute = any(attribute.name == "seed" for attribute in node.attribute)
            actual = (
                "draws on from run to run despite its seed" if has_seed_attribute else "no seed"
            )
            yield Violation.at(_location(node), actual, "stored numbers")


@rule("GG025", Severity.ERROR, kinds=MANIFEST_KINDS, needs=("GG019",))
def inference_mode(subject: InspectedModel) -> Iterator[Violation]:
    """No layer is in training mode: Dropout passes its input on, and nothing is sampled.

    Why:
        Dropout in training sets random elements to zero and scales up the others, a Bernoulli
        draws masks: every frame differs, and values leave their ranges. Batch normalisation in
        training uses the statistics of the frame in place of those that were learned.

    Hint:
        Call model.eval() before the export, and export without training mode.
    """
    true_constants = _true_constants(subject)
    for node in _all_nodes(subject):
        if node.op_type in _RANDOM_TRAINING_OPERATORS:
            yield Violation.at(_location(node), "draws a mask, as in training", "model.eval()")
        elif node.op_type == "Dropout" and true_constants.intersection(node.input[_TRAINING_FLAG:]):
            yield Violation.at(_location(node), "training_mode is true", "model.eval()")
        elif node.op_type == "BatchNormalization" and any(
            attribute.name == "training_mode" and attribute.i for attribute in node.attribute
        ):
            actual = "training_mode is 1: it normalises by the statistics of the frame"
            yield Violation.at(_location(node), actual, "model.eval()")


def _true_constants(subject: InspectedModel) -> set[str]:
    """Return the names of boolean graph constants that are true."""
    weights = list(subject.file.proto.graph.initializer)
    for node in _all_nodes(subject):
        if node.op_type == "Constant" and node.output:
            for attribute in node.attribute:
                if attribute.name == "value":
                    weight = TensorProto()
                    weight.CopyFrom(attribute.t)
                    weight.name = node.output[0]
                    weights.append(weight)
    bool_weights = (weight for weight in weights if weight.data_type == TensorProto.BOOL)
    arrays = ((weight.name, small_array(weight)) for weight in bool_weights)
    return {name for name, array in arrays if array is not None and array.any()}


@rule(
    "GG026",
    Severity.ERROR,
    kinds=(GENERATOR, POST_PROCESS),
    needs=(*MANIFEST_PARSED, *WELL_FORMED, "GG004"),
)
def promised_shapes_static(subject: InspectedModel) -> Iterator[Violation]:
    """If the manifest promises `static_shapes`, no operator's output size depends on values.

    Why:
        A runtime that believes the promise records the kernels of one frame and replays them: the
        next frame has the sizes of the first.

    Hint:
        Keep all rows, and set the opacity of those that are not wanted to zero with Where; or
        declare "capture": {"static_shapes": false}.
    """
    manifest = subject.generator or subject.manifest
    capture_promise = subject.generator.capture if subject.generator else None
    if isinstance(manifest, PostProcessManifest):
        capture_promise = manifest.capture
    if (
        capture_promise is None
        or not capture_promise.static_shapes
        or subject.candidate is not None
    ):
        return
    has_capture_key = '"capture"' in (subject.file.manifest_text or "")
    for placement in subject.placements:
        if placement.node.op_type in DATA_SIZED_OPERATORS:
            yield Violation.at(
                _location(placement.node),
                "as many elements as values say",
                "static shapes, as capture.static_shapes promises",
                certainty="confirmed" if has_capture_key else "possible",
            )
