"""Rules of inputs (GI): shapes and dtypes that any runtime can feed."""

from collections.abc import Iterator

import numpy as np

from gsgen.contract.model.graph import Dims, Tensor, static_dims
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.outputs import ModelOutputs
from gsgen.contract.spec.fields.roles import (
    GENERATOR,
    MANIFEST_KINDS,
    POST_PROCESS,
    ROLES,
    Role,
    matching_shape,
    shapes_of,
)
from gsgen.contract.spec.manifest import Input
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation, set_hint, size_hint, take_hint
from gsgen.contract.validation.rule import rule

# Roles whose shape has a rule of its own.
_SHAPE_RULES = ("view", "projection", "time")


def _wrong_shape(
    subject: InspectedModel, role: str, expected: tuple[int, ...]
) -> Iterator[Violation]:
    for entry, tensor in subject.inputs_of(role):
        if tensor.dims != expected:
            actual, hint = f"shape {_shape_text(tensor)}", _other_role_hint(subject, entry, tensor)
            yield Violation.at(f"input {tensor.name}", actual, str(list(expected)), hint=hint)


def _other_role_hint(subject: InspectedModel, entry: Input, tensor: Tensor) -> str:
    """Return the hint to declare the role that an input's name is known for, if its shape fits."""
    from gsgen.contract.model.manifest_inference import infer_manifest

    dims = static_dims(tensor)
    for known in infer_manifest(subject.graph, "").manifest.inputs:
        fits = dims is not None and matching_shape(ROLES[known.role], dims, GENERATOR) is not None
        if known.name == entry.name and known.role != entry.role and fits:
            return set_hint(f"{subject.path_of(entry)}.role", known.role)
    return ""


def _shape_text(tensor: Tensor) -> str:
    if tensor.dims is None:
        return "unknown"
    return "[" + ", ".join("?" if dim is None else str(dim) for dim in tensor.dims) + "]"


@rule("GI001", Severity.ERROR, needs=("GM004",))
def view_is_4x4(subject: InspectedModel) -> Iterator[Violation]:
    """An input with the role `view` has the static shape [4, 4].

    Why:
        Runtimes feed a [4, 4] tensor; a [1, 16] or [1, 4, 4] input makes ONNX Runtime refuse the
        frame with "Got invalid dimensions".

    Hint:
        Take a [4, 4] tensor and reshape inside the model.
    """
    yield from _wrong_shape(subject, "view", (4, 4))


@rule("GI002", Severity.ERROR, needs=("GM004",))
def projection_is_4x4(subject: InspectedModel) -> Iterator[Violation]:
    """An input with the role `projection` has the static shape [4, 4].

    Why:
        Runtimes feed a [4, 4] tensor; any other shape is refused at the first frame.

    Hint:
        Take a [4, 4] tensor and reshape inside the model.
    """
    yield from _wrong_shape(subject, "projection", (4, 4))


@rule("GI003", Severity.ERROR, needs=("GM004",))
def time_is_1(subject: InspectedModel) -> Iterator[Violation]:
    """An input with the role `time` has the static shape [1].

    Why:
        Runtimes feed one number as [1]. A [1, 1] input is refused ("Invalid rank"); a scalar works
        in some runtimes only.

    Hint:
        Take a [1] tensor.
    """
    yield from _wrong_shape(subject, "time", (1,))


@rule("GI004", Severity.ERROR, needs=("GM004",), kinds=MANIFEST_KINDS)
def input_dtype(subject: InspectedModel) -> Iterator[Violation]:
    """Every input has the dtype of its input role: float32, or int32 for indices.

    Why:
        Runtimes feed 32-bit buffers. WebGPU has no 64-bit types, so an int64 index cannot be
        captured and is truncated where it is accepted.

    Hint:
        Take the input in its role's dtype and cast inside the model.
    """
    for entry in subject.manifest.inputs if subject.manifest else ():
        tensor = subject.graph.input(entry.name)
        dtypes = ROLES[entry.role].dtype
        if tensor is not None and tensor.dtype not in dtypes:
            yield Violation.at(f"input {entry.name}", str(tensor.dtype), " or ".join(dtypes))


@rule("GI005", Severity.ERROR, needs=("GM004",), kinds=MANIFEST_KINDS)
def inputs_declared(subject: InspectedModel) -> Iterator[Violation]:
    """Every graph input is declared with an input role, so that any runtime can feed it.

    Why:
        An input that no role explains is never fed, and the first frame fails with "Required
        inputs are missing". A free-form input needs a static shape, a range and a default, or no
        runtime knows what to give it.

    Hint:
        Declare it in the manifest's inputs, or bake it into the model before export.
    """
    manifest = subject.manifest
    declared = {entry.name: entry for entry in manifest.inputs} if manifest else {}
    for tensor in subject.graph.inputs:
        entry = declared.get(tensor.name)
        location = f"input {tensor.name}"
        if entry is None:
            actual, expected = f"{tensor} without a role", "a declared role, or no such input"
            yield Violation.at(location, actual, expected, hint=_declare_hint(subject, tensor))
            continue
        role = ROLES[entry.role]
        if manifest and manifest.kind not in role.kinds:
            expected = f"a role that a {manifest.kind} may take"
            hint = _slider_hint(subject, entry, tensor)
            yield Violation.at(location, f"role {entry.role}", expected, hint=hint)
        if role.needs_range and entry.range is None:
            yield Violation.at(
                location, f"role {entry.role} without a range", '"range": [low, high]'
            )
        yield from _feed_faults(subject, entry, tensor)


def _declare_hint(subject: InspectedModel, tensor: Tensor) -> str:
    """Return the hint to declare an input by the role that its name is known for, or as a slider."""
    from gsgen.contract.model.manifest_inference import infer_manifest
    from gsgen.contract.spec.fields.json_schema import to_json

    inferred = infer_manifest(subject.graph, "").manifest.inputs
    manifest = subject.manifest
    if manifest is None:
        return ""
    known = [
        to_json(entry)
        for entry in inferred
        if entry.name == tensor.name and manifest.kind in ROLES[entry.role].kinds
    ]
    free = {"name": tensor.name, "role": "control", "range": [0, 1], "default": "zeros"}
    if not (known or (static_dims(tensor) and _may_be_slider(manifest.kind, tensor))):
        return ""
    hint = set_hint(f"inputs.{len(manifest.inputs)}", [*known, free][0])
    return hint if known else f"If people set it: {hint} Else bake it into the model before export."


def _slider_hint(subject: InspectedModel, entry: Input, tensor: Tensor) -> str:
    """Return the hint to declare a slider, if the kind of model and the tensor allow one."""
    kind = subject.manifest.kind if subject.manifest else ""
    path = f"{subject.path_of(entry)}.role"
    return set_hint(path, "control") if _may_be_slider(kind, tensor) else ""


def _may_be_slider(kind: str, tensor: Tensor) -> bool:
    return kind in ROLES["control"].kinds and tensor.dtype in ROLES["control"].dtype


def _feed_faults(subject: InspectedModel, entry: Input, tensor: Tensor) -> Iterator[Violation]:
    role, kind = entry.role, subject.manifest.kind if subject.manifest else ""
    if role in _SHAPE_RULES and kind == GENERATOR:
        return
    location = f"input {tensor.name}"
    dims, hint = static_dims(tensor), _fit_hint(subject, entry, tensor)
    if dims is None:
        if kind != POST_PROCESS:
            actual = f"shape {_shape_text(tensor)}"
            yield Violation.at(location, actual, "a static shape", hint=_size_hint(tensor))
        elif not _is_open_image(tensor, role):
            shapes = _shapes_text(ROLES[role], kind)
            expected = f"{shapes}, channels first; only height and width may be open, not the batch"
            yield Violation.at(location, f"shape {_shape_text(tensor)}", expected, hint=hint)
        return
    if matching_shape(ROLES[role], dims, kind) is None:
        shapes = _shapes_text(ROLES[role], kind)
        expected = f"{shapes}, as the role {role} has"
        yield Violation.at(location, f"shape {_shape_text(tensor)}", expected, hint=hint)


# Joints of SMPL, the commonest body model.
_USUAL_JOINTS = 24


def _size_hint(tensor: Tensor) -> str:
    """Return the hint to give the only symbolic size of an input, such as joints, a number."""
    symbols = [dim for dim in tensor.dims or () if isinstance(dim, str)]
    if len(symbols) != 1:
        return ""
    return f"{size_hint(symbols[0], _USUAL_JOINTS)} Or another one that the model takes."


def _fit_hint(subject: InspectedModel, entry: Input, tensor: Tensor) -> str:
    """Return the hint to take an input as its role has it, and to fit it inside the model."""
    kind = subject.manifest.kind if subject.manifest else ""
    sizes, line = _fit(tensor.dims or (), entry.role, kind)
    shape, name = f"[{', '.join(map(str, sizes))}]", tensor.name
    hint = take_hint(name, shape, line.replace("x", name)) if sizes else ""
    if hint and entry.shape is not None:
        hint += f" {set_hint(f'{subject.path_of(entry)}.shape', list(sizes))}"
    return hint


def _fit(dims: Dims, role: str, kind: str) -> tuple[tuple[int | str | None, ...], str]:
    """Return the sizes that a role has in place of an input's, and the line that fits ``x``."""
    for shape in shapes_of(ROLES[role], kind):
        if len(dims) == len(shape) == 4 and dims[3] == shape[1] and dims[1] != shape[1]:
            return (dims[0], shape[1], *dims[1:3]), "x = x.permute(0, 2, 3, 1)"
        if len(dims) != len(shape):
            continue
        sizes = tuple(
            dim if isinstance(expected, str) else expected
            for expected, dim in zip(shape, dims, strict=True)
        )
        axes = [axis for axis, dim in enumerate(dims) if dim != sizes[axis]]
        size, has = (sizes[axes[0]], dims[axes[0]]) if len(axes) == 1 else (None, None)
        columns = ":, " * axes[0] if axes else ""
        if isinstance(has, str):
            return sizes, ""
        if isinstance(size, int) and isinstance(has, int) and has == size + 1:
            return sizes, f"x = torch.cat([x, x[{columns}:1] * 0 + 1], {axes[0]})"
        if isinstance(size, int) and isinstance(has, int) and has < size:
            return sizes, f"x = x[{columns}:{has}]"
    return (), ""


def _shapes_text(role: Role, kind: str) -> str:
    return " or ".join(f"[{', '.join(map(str, shape))}]" for shape in shapes_of(role, kind))


def _is_open_image(tensor: Tensor, role: str) -> bool:
    """Return whether only height and width of an image are symbolic dimensions."""
    if tensor.dims is None:
        return False
    sizes = {"H", "W"}
    return any(
        len(shape) == len(tensor.dims)
        and all(
            expected in sizes or (isinstance(dim, int) and expected in (dim, str(expected)))
            for expected, dim in zip(shape, tensor.dims, strict=True)
        )
        for shape in ROLES[role].shapes
    )


@rule("GI009", Severity.ERROR, needs=("GV025",))
def zero_inputs_finite(emission: ModelOutputs) -> Iterator[Violation]:
    """If all model inputs are zero, every output is finite.

    Why:
        Viewers run the model once on zeroed buffers before the first camera arrives; a NaN there
        may stay in buffers and sort on top of the picture.

    Hint:
        Guard the division or the norm that sees the zero, with a clamp under the square root. To
        hide such rows meanwhile, end on
        `rows = torch.where((rows.abs() < 3e38).all(1, True), rows, 0)`.
    """
    if not emission.zeros:
        return
    for name, value in emission.outputs.items():
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            nonfinite_count = int(np.count_nonzero(~np.isfinite(value)))
            yield Violation.at(
                f"output {name}", f"{nonfinite_count} of {value.size} values not finite", "finite"
            )


@rule("GI006", Severity.WARNING, needs=("GM004", "GG019"), kinds=MANIFEST_KINDS)
def inputs_reach_outputs(subject: InspectedModel) -> Iterator[Violation]:
    """Some output is computed from each input, unless `depends_on` declares the opposite.

    Why:
        An input that leads nowhere was usually turned into a constant when the model was traced.
        Runtimes still feed it, and run the model whenever it changes.

    Hint:
        Export without detaching the input (numpy round trips, `.item()`, Python branches), remove
        it, or set "depends_on": {input or role: false}.
    """
    graph, generator = subject.graph, subject.generator
    used_names: set[str] = set()
    for tensor in graph.outputs:
        used_names |= graph.ancestors(tensor.name)[0]
    for entry in subject.manifest.inputs if subject.manifest else ():
        expected = generator is None or generator.depends(entry)
        if entry.name not in used_names and expected:
            yield Violation.at(
                f"input {entry.name}",
                "no output depends on it",
                "an input that some output depends on",
                hint="" if generator is not None else _baked_hint(subject, entry),
            )


def _baked_hint(subject: InspectedModel, entry: Input) -> str:
    """Return the hint for a model of a kind whose manifest has no `depends_on`."""
    removal = f"Remove input {entry.name} from the graph, and {subject.path_of(entry)}."
    return (
        "Export without detaching the input (numpy round trips, `.item()`, Python branches), or "
        f"remove it: {removal}"
    )


@rule("GI012", Severity.INFO, kinds=MANIFEST_KINDS)
def weights_are_no_inputs(subject: InspectedModel) -> Iterator[Violation]:
    """No weight (initialiser) is listed among the graph inputs.

    Why:
        Old exporters list them, which lets a runtime feed other numbers: so no optimiser folds
        them, and a viewer that walks the inputs finds one without a meaning.

    Hint:
        Remove every weight from the graph's inputs; the weights stay in the model.
    """
    names = [value.name for value in subject.file.proto.graph.input]
    weights = [name for name in names if name in subject.graph.initializers]
    if weights:  # one setting of an exporter lists all weights: one finding for all of them
        remainder = f", like {len(weights) - 1} more of the inputs" if len(weights) > 1 else ""
        actual = f"is also a weight{remainder}"
        yield Violation.at(f"input {weights[0]}", actual, "a weight that is not an input")
