"""Plans the order of all test inputs, so that one inference session serves all rules."""

__all__ = [
    "Plan",
    "fetched_outputs",
    "make_plan",
    "maps_weights",
    "probed_bytes",
    "probed_dtypes",
    "probed_shapes",
]

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from gsgen.contract.model.graph import Tensor, static_dims
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.behaviour_probes import ZERO_LABEL, trial_probes, turned_away_probes
from gsgen.contract.probing.probes import Probe, default_probes, dependency_probes
from gsgen.contract.probing.test_vectors import vector_probes
from gsgen.contract.spec.manifest import Input, PostProcessManifest
from gsgen.contract.spec.severity import Level

# Budget of bytes for all distinct outputs, which are temporary files.
_OUTPUT_BUDGET = 1 << 30
_MAX_PROBES, _MIN_PROBES = 8, 3
# Budget of bytes that survey probes compute, and the fewest of them: inside, in a Gaussian, far,
# above, below and two at rims.
_SURVEY_BUDGET = 1 << 28
_MIN_SURVEY_PROBES = 7
_MAX_VARIANTS = 2
# Bytes of an element while inputs are drawn: float64.
_MAX_ITEM_BYTES = 8
# Size that replaces an open dimension, such as the height of an image.
_DEFAULT_OPEN_SIZE = 64
# Odd height and width of one more run of an image model of open size.
_ODD_IMAGE_SIZE = (37, 53)
_IMAGE_RANK = 4
# Copies of so many bytes of weights would take more memory than ONNX Runtime itself.
_LARGE_WEIGHT_BYTES = 1 << 28
# Groups of moments whose runs hold for every rule of single runs.
_MOMENT_GROUPS = (
    *("defaults", "frames", "survey", "screens", "pictures", "corners", "open sizes", "histories"),
)
# Dtypes that numpy can hold, so that ONNX Runtime can hand them over; None is unknown.
_FETCHABLE_DTYPES = (
    *("float32", "float16", "float64", "bool", None),
    *("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """The ordered test inputs of one inference session, and which validation rules use each.

    Attributes:
        probes: One set of inputs per run.
        values: How many of the first probes value rules use.
        repeated: Two consecutive runs with the same inputs.
        revisited: Two runs with the same inputs and other runs between them.
        variants: Role → (base run, runs that differ from it in that role alone).
        trials: Name → the runs for one rule, or for several.
        moments: The runs at named moments, which hold for every rule of single runs.
        seed: Seed of the probes of value rules.
    """

    probes: tuple[Probe, ...]
    values: int
    repeated: tuple[int, int] | None = None
    revisited_pair: tuple[int, int] | None = None
    variants: dict[str, tuple[int, tuple[int, ...]]] = field(default_factory=dict)
    trials: dict[str, tuple[int, ...]] = field(default_factory=dict)
    moments: tuple[int, ...] = ()
    seed: int = 0


def make_plan(subject: InspectedModel, level: Level, seed: int = 0) -> Plan:
    """Plan the model runs that a validation up to ``level`` needs."""
    manifest = subject.manifest
    assert manifest is not None
    shapes, dtypes = probed_shapes(subject), probed_dtypes(subject)
    count = _affordable_probes(subject)
    first = default_probes(manifest, shapes, dtypes, seed, count)
    base = len(first) - 1 if len(first) == 1 else 1
    value_trials = {
        "away": tuple(turned_away_probes(manifest, first[base])),
        "sizes": tuple(_odd_size_probes(subject, shapes, dtypes, seed)),
    }
    trials: dict[str, tuple[int, ...]] = {}
    probes = [*first]
    for name, group in value_trials.items():
        trials[name] = tuple(range(len(probes), len(probes) + len(group)))
        probes.extend(group)
    if level < Level.BEHAVIOUR:
        return Plan(probes=tuple(probes), values=len(first), trials=trials, seed=seed)
    from gsgen.contract.probing.named_moments import moments_of

    repeated_count = len(probes)
    probes += [first[base], first[base]]
    other_probes = (first[-1], first[len(first) // 2])[: _affordable_variants(subject, count)]
    variants: dict[str, tuple[int, tuple[int, ...]]] = {}
    for role, changed_probes in dependency_probes(manifest, first[base], other_probes):
        variants[role] = (base, tuple(range(len(probes), len(probes) + len(changed_probes))))
        probes.extend(changed_probes)
    groups = [
        *vector_probes(manifest, shapes, dtypes, seed, count),
        *trial_probes(manifest, first[base], first),
    ]
    limit = max(_MIN_SURVEY_PROBES, _SURVEY_BUDGET // max(_frame_bytes(subject), 1))
    # Each moment is run once: one that a value rule checks is found by its inputs.
    known = {_input_key(probe): index for index, probe in enumerate(first) if not probe.zeros}
    for name, probe in moments_of(manifest, first, _open_axes(subject), limit):
        index = known.setdefault(_input_key(probe), len(probes))
        trials[name] = (*trials.get(name, ()), index)
        if index == len(probes):
            probes.append(probe)
    for name, group in groups:
        trials[name] = tuple(range(len(probes), len(probes) + len(group)))
        probes.extend(group)
    # The ends of all ranges are named, too; zero matrices are not cameras.
    ends = (index for index in trials.get("edges", ()) if not _is_zero_edge(probes[index]))
    named = (index for name in _MOMENT_GROUPS for index in trials.get(name, ()))
    revisited_pair = (base, repeated_count) if len(first) > 1 else None
    repeated = (repeated_count, repeated_count + 1)
    return Plan(
        probes=tuple(probes),
        values=len(first),
        repeated=repeated,
        revisited_pair=revisited_pair,
        variants=variants,
        trials=trials,
        moments=tuple(dict.fromkeys((*named, *ends))),
        seed=seed,
    )


def _input_key(probe: Probe) -> tuple[object, ...]:
    arrays = (value.tobytes() for value in probe.inputs.values())
    shapes = (value.shape for value in probe.inputs.values())
    return (*arrays, *shapes, probe.placement)


def _is_zero_edge(probe: Probe) -> bool:
    return ZERO_LABEL in probe.label


def _open_axes(subject: InspectedModel) -> dict[int, int]:
    """Return the open axes of an image, height 2 and width 3: which number of a size each takes.

    Axes that the graph calls by the same name have the same size.
    """
    for entry, tensor in subject.inputs_of("image"):
        dims = tensor.dims or ()
        if entry.shape is None and len(dims) == _IMAGE_RANK:
            numbers = {2: 0, 3: 0 if dims[2] == dims[3] else 1}
            return {axis: n for axis, n in numbers.items() if not isinstance(dims[axis], int)}
    return {}


def fetched_outputs(subject: InspectedModel) -> list[str]:
    """Return the names of the model outputs to fetch: the declared ones, or else all."""
    graph = subject.graph
    declared = [graph.output(name) for name in subject.output_names]
    tensors = [tensor for tensor in declared if tensor] or graph.outputs
    return [tensor.name for tensor in tensors if tensor.dtype in _FETCHABLE_DTYPES]


def maps_weights(subject: InspectedModel) -> bool:
    """Return whether the model is run with weights as mapped files, without copies of them.

    Constants are then not folded, and ONNX Runtime 1.31 leaves out a Transpose before a MatMul with
    a vector: models that may hold one are run as usual.
    """
    tensors = subject.graph.tensors
    operands = (n for node in subject.graph.nodes if node.op_type == "MatMul" for n in node.input)
    ranks = (len(tensors[n].dims or ()) if n in tensors else 0 for n in operands)
    if subject.graph.functions or any(rank < 2 for rank in ranks):
        return False
    return subject.file.weight_bytes >= _LARGE_WEIGHT_BYTES


def _shape_for_probes(entry: Input, tensor: Tensor) -> tuple[int, ...]:
    """Return the shape to feed for an input; the manifest fills symbolic dimensions."""
    dims = tensor.dims if tensor.dims is not None else entry.shape or ()
    declared = entry.shape if entry.shape and len(entry.shape) == len(dims) else None
    return tuple(
        dim if isinstance(dim, int) else declared[axis] if declared else _DEFAULT_OPEN_SIZE
        for axis, dim in enumerate(dims)
    )


def probed_shapes(subject: InspectedModel) -> dict[str, tuple[int, ...]]:
    """Return the shape to feed for each input by name, with symbolic dimensions resolved."""
    tensors = {tensor.name: tensor for tensor in subject.graph.inputs}
    entries = subject.manifest.inputs if subject.manifest else ()
    return {i.name: _shape_for_probes(i, tensors[i.name]) for i in entries if i.name in tensors}


def probed_dtypes(subject: InspectedModel) -> dict[str, str]:
    """Return the dtype to feed for each input by name; float32 if the graph declares none."""
    tensors = {tensor.name: tensor for tensor in subject.graph.inputs}
    entries = subject.manifest.inputs if subject.manifest else ()
    return {i.name: tensors[i.name].dtype or "float32" for i in entries if i.name in tensors}


def probed_bytes(subject: InspectedModel) -> int:
    """Return the size in bytes of one complete set of test inputs."""
    shapes = probed_shapes(subject).values()
    return sum(_MAX_ITEM_BYTES * math.prod(max(0, dim) for dim in shape) for shape in shapes)


def _odd_size_probes(
    subject: InspectedModel, shapes: dict[str, tuple[int, ...]], dtypes: dict[str, str], seed: int
) -> Iterator[Probe]:
    """Yield one set of inputs of an odd image size for a post-process model of open size."""
    manifest, images = subject.manifest, subject.inputs_of("image")
    if not isinstance(manifest, PostProcessManifest) or not images or images[0][0].shape:
        return
    entry, tensor = images[0]
    shape, dims = list(shapes[entry.name]), tensor.dims or ()
    sizes = dict(zip(dims[2:], _ODD_IMAGE_SIZE, strict=False))  # equal symbols have equal sizes
    for axis in range(2, len(dims)):
        if not isinstance(dims[axis], int):
            shape[axis] = sizes.get(dims[axis], shape[axis])
    if tuple(shape) != shapes[entry.name]:
        odd_shapes = shapes | {entry.name: tuple(shape)}
        probe = default_probes(manifest, odd_shapes, dtypes, seed, count=2)[-1]
        yield replace(probe, label=f"an image of {' × '.join(map(str, shape[2:]))}")


def _affordable_probes(subject: InspectedModel) -> int:
    """Return the number of test runs whose inputs and outputs fit the memory budget."""
    return max(_MIN_PROBES, min(_MAX_PROBES, _OUTPUT_BUDGET // max(_frame_bytes(subject), 1)))


def _affordable_variants(subject: InspectedModel, values: int) -> int:
    """Return the number of variants of each role whose outputs fit the budget, but at least one."""
    manifest = subject.manifest
    roles = len({entry.role for entry in manifest.inputs}) if manifest else 0
    affordable_probe_count = _OUTPUT_BUDGET // max(_frame_bytes(subject), 1) - values
    return max(1, min(_MAX_VARIANTS, affordable_probe_count // max(roles, 1)))


def _frame_bytes(subject: InspectedModel) -> int:
    """Return the size in bytes of the inputs and outputs of one model run, as float32."""
    total = probed_bytes(subject)
    for tensor in (subject.gaussians, subject.appearance, subject.cells):
        dims = static_dims(tensor) if tensor else None
        size = 4
        for dim in dims or (0,):
            size *= int(dim)
        total += size
    return total
