"""Validation rules of models shipped beside an ONNX generator: image and camera tensors fit."""

from collections.abc import Iterator

from gsgen.contract.model.graph import Tensor
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.spec.fields.roles import POST_PROCESS, STATE_SIZES, TRAJECTORY
from gsgen.contract.spec.manifest import ImageOutput, PostProcessManifest, TrajectoryManifest
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation, line_hint, set_hint
from gsgen.contract.validation.rule import rule


@rule("GO018", Severity.ERROR, needs=("GM004", "GI005"), kinds=(POST_PROCESS,))
def image_out_as_in(subject: InspectedModel) -> Iterator[Violation]:
    """The output image has the declared dtype, and the size of the input image times `scale`.

    Why:
        The result takes the place of the rendered image: it is read with the declared dtype, and
        a runtime draws the picture smaller by the declared scale.

    Hint:
        Resize inside the model, cast at its end, and declare the dtype and the scale of the graph.
    """
    manifest = subject.manifest
    if not isinstance(manifest, PostProcessManifest):
        return
    declared, tensor = _image(subject, manifest)
    if tensor is None:
        return
    location = f"output {tensor.name}"
    if tensor.dtype is not None and tensor.dtype != declared.dtype:
        expected = f"the declared dtype {declared.dtype}"
        yield Violation.at(location, f"graph has {tensor.dtype}", expected)
    for _, input_image in subject.inputs_of("image"):
        if not _sizes_agree(input_image, tensor, declared.scale):
            times = "" if declared.scale == 1 else f"{declared.scale} times the size of "
            expected = f"{times}{input_image}, as {input_image.name} has, with 3 or 4 channels"
            hint = _scale_hint(input_image, tensor, declared.scale)
            yield Violation.at(location, f"shape {tensor}", expected, hint=hint)


def _scale_hint(input_image: Tensor, output_image: Tensor, declared: int) -> str:
    """Return the hint to declare the scale of the graph or, without a scale, to resize the result."""
    sizes = (*(input_image.dims or ())[2:], *(output_image.dims or ())[2:])
    known = [size for size in sizes if isinstance(size, int)]
    if len(known) < 4 or not known[0] or not known[1]:
        return ""
    scale = known[2] // known[0]
    is_whole = scale >= 1 and known[2:] == [scale * known[0], scale * known[1]]
    if is_whole and scale != declared:
        return set_hint("outputs.image.scale", scale)
    size = f"({declared * known[0]}, {declared * known[1]})"
    return line_hint(f"rows = torch.nn.functional.interpolate(rows, {size})")


def _image(
    subject: InspectedModel, manifest: PostProcessManifest
) -> tuple[ImageOutput, Tensor | None]:
    declared = manifest.outputs.image
    return declared, subject.graph.output(declared.name)


def _sizes_agree(input_image: Tensor, output_image: Tensor, scale: int) -> bool:
    """Return whether known sizes agree with the input's times ``scale``; channels are 3 or 4."""
    if input_image.dims is None or output_image.dims is None:
        return True
    if len(input_image.dims) != len(output_image.dims) or len(output_image.dims) != 4:
        return False
    sizes = [(1, input_image.dims[0], output_image.dims[0])]
    sizes += [(scale, input_image.dims[a], output_image.dims[a]) for a in (2, 3)]
    known = all(k * x == y for k, x, y in sizes if isinstance(x, int) and isinstance(y, int))
    channels = output_image.dims[1]
    return known and (not isinstance(channels, int) or channels in (3, 4))


@rule("GO019", Severity.ERROR, needs=("GM004",), kinds=(TRAJECTORY,))
def states_as_declared(subject: InspectedModel) -> Iterator[Violation]:
    """Predicted states, uncertainty and history have the sizes that the manifest declares.

    Why:
        A prefetcher reads row k as the camera at k steps from now, and its numbers by the declared
        representation. A row too few or a number too many shifts all that follows.

    Hint:
        Declare the number of steps and the representation that the graph has.
    """
    manifest = subject.manifest
    if not isinstance(manifest, TrajectoryManifest):
        return
    future, uncertainty_output = manifest.outputs.future, manifest.outputs.uncertainty
    state, graph = STATE_SIZES[future.representation], subject.graph
    doubt_size = _doubt_sizes(state)[uncertainty_output.semantics]
    for name, expected in ((future.name, state), (uncertainty_output.name, doubt_size)):
        hint = _states_hint(subject, manifest, is_future=name == future.name)
        yield from _check_size(graph.output(name), f"output {name}", (future.steps, expected), hint)
    for entry, tensor in subject.inputs_of("camera_history"):
        yield from _check_size(tensor, f"input {entry.name}", (None, state))


def _states_hint(subject: InspectedModel, manifest: TrajectoryManifest, *, is_future: bool) -> str:
    """Return the hint to declare what a predicted tensor is; empty if nothing explains it."""
    future, uncertainty = manifest.outputs.future, manifest.outputs.uncertainty
    tensors = [subject.graph.output(part.name) for part in (future, uncertainty)]
    shapes = [tensor.dims or () if tensor else () for tensor in tensors]
    if any(len(shape) != 2 for shape in shapes):
        return ""
    rows, size = shapes[0 if is_future else 1]
    if isinstance(rows, int) and rows != future.steps:
        # Of two tensors with unequal rows, one is wrong itself.
        is_same = shapes[0][0] == shapes[1][0]
        return set_hint("outputs.future.steps", rows) if is_same else ""
    state = STATE_SIZES[future.representation]
    field, declared, sizes = (
        ("future.representation", future.representation, STATE_SIZES)
        if is_future
        else ("uncertainty.semantics", uncertainty.semantics, _doubt_sizes(state))
    )
    fitting = [name for name in sizes if sizes[name] == size != sizes[declared]]
    return set_hint(f"outputs.{field}", fitting[0]) if fitting else ""


def _doubt_sizes(state: int) -> dict[str, int]:
    return {"standard-deviation": state, "covariance-upper": state * (state + 1) // 2}


def _check_size(
    tensor: Tensor | None, location: str, expected: tuple[int | None, int], hint: str = ""
) -> Iterator[Violation]:
    if tensor is None or tensor.dims is None:
        return
    expected_shape = f"[{'T' if expected[0] is None else expected[0]}, {expected[1]}]"
    has_fitting_shape = len(tensor.dims) == 2 and all(
        size is None or not isinstance(dim, int) or dim == size
        for dim, size in zip(tensor.dims, expected, strict=True)
    )
    if not has_fitting_shape:
        yield Violation.at(
            location, f"shape {tensor}", f"{expected_shape}, as the manifest fixes", hint=hint
        )
    elif tensor.dtype not in (None, "float32"):
        yield Violation.at(location, str(tensor.dtype), "float32")
