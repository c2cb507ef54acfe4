"""GO, companion kinds: images and camera states come out as the manifest says."""

from collections.abc import Iterator

from gsgen.contract.model.graph import Tensor
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.spec.manifest import (
    ImageOutput,
    PostProcessManifest,
    TrajectoryManifest,
)
from gsgen.contract.spec.roles import POST_PROCESS, TRAJECTORY
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.rule import rule

# Numbers of a camera state: the centre, then the rotation.
_STATE = {"position+quaternion-wxyz": 7, "position+axis-angle": 6}


@rule(
    "GO018",
    "image-out-as-in",
    Severity.ERROR,
    over="model",
    fixture="image_of_half_size",
    needs=("GM004", "GI005"),
    kinds=(POST_PROCESS,),
)
def image_out_as_in(subject: InspectedModel) -> Iterator[Violation]:
    """The image that comes out has the declared dtype, and the size of the one that goes in.

    Why:
        The result takes the place of the rendered image: it is read with the declared dtype, and
        drawn over the same pixels.

    Hint:
        Resize inside the model, cast at its end, and declare the dtype that the graph has.
    """
    manifest = subject.manifest
    if not isinstance(manifest, PostProcessManifest):
        return
    declared, tensor = _image(subject, manifest)
    if tensor is None:
        return
    place = f"output {tensor.name}"
    if tensor.dtype is not None and tensor.dtype != declared.dtype:
        expected = f"the declared dtype {declared.dtype}"
        yield Violation.at(place, f"graph has {tensor.dtype}", expected)
    for _, given in subject.inputs_of("image"):
        if not _alike(given, tensor):
            expected = f"{given}, as {given.name} has, with 3 or 4 channels"
            yield Violation.at(place, f"shape {tensor}", expected)


def _image(
    subject: InspectedModel, manifest: PostProcessManifest
) -> tuple[ImageOutput, Tensor | None]:
    declared = manifest.outputs.image
    return declared, subject.graph.output(declared.name)


def _alike(given: Tensor, made: Tensor) -> bool:
    """Say whether nothing that the graph knows of the sizes contradicts; channels may differ."""
    if given.dims is None or made.dims is None:
        return True
    if len(given.dims) != len(made.dims) or len(made.dims) != 4:
        return False
    sizes = [(0, given.dims[0], made.dims[0])]
    sizes += [(a, given.dims[a], made.dims[a]) for a in (2, 3)]
    known = all(x == y for _, x, y in sizes if isinstance(x, int) and isinstance(y, int))
    channels = made.dims[1]
    return known and (not isinstance(channels, int) or channels in (3, 4))


@rule(
    "GO019",
    "states-as-declared",
    Severity.ERROR,
    over="model",
    fixture="too_few_steps",
    needs=("GM004",),
    kinds=(TRAJECTORY,),
)
def states_as_declared(subject: InspectedModel) -> Iterator[Violation]:
    """Predicted states, their uncertainty and the history have the sizes that the manifest fixes.

    Why:
        A prefetcher reads row k as the camera at k steps from now, and its numbers by the declared
        representation. A row too few or a number too many shifts all that follows.

    Hint:
        Declare the number of steps and the representation that the graph has.
    """
    manifest = subject.manifest
    if not isinstance(manifest, TrajectoryManifest):
        return
    future, doubt = manifest.outputs.future, manifest.outputs.uncertainty
    state, graph = _STATE[future.representation], subject.graph
    wide = {"covariance-upper": state * (state + 1) // 2}.get(doubt.semantics, state)
    for name, expected in ((future.name, state), (doubt.name, wide)):
        yield from _sized(graph.output(name), f"output {name}", (future.steps, expected))
    for entry, tensor in subject.inputs_of("camera_history"):
        yield from _sized(tensor, f"input {entry.name}", (None, state))


def _sized(
    tensor: Tensor | None, place: str, expected: tuple[int | None, int]
) -> Iterator[Violation]:
    if tensor is None or tensor.dims is None:
        return
    shown = f"[{'T' if expected[0] is None else expected[0]}, {expected[1]}]"
    fits = len(tensor.dims) == 2 and all(
        wanted is None or not isinstance(dim, int) or dim == wanted
        for dim, wanted in zip(tensor.dims, expected, strict=True)
    )
    if not fits:
        yield Violation.at(place, f"shape {tensor}", f"{shown}, as the manifest fixes")
    elif tensor.dtype not in (None, "float32"):
        yield Violation.at(place, str(tensor.dtype), "float32")
