"""Validation rules of the scene pass: pictures, their cameras, and inputs that stay over frames."""

from collections.abc import Iterator

from gsgen.contract.model.graph import names_read
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.rules.interface.input_declarations import declared_inputs, shape_of
from gsgen.contract.spec.fields.roles import CAMERA_ROLES, GENERATOR, MANIFEST_KINDS, PICTURE_ROLES
from gsgen.contract.spec.manifest import Input
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.rule import rule

# Roles whose values are those of a frame: the camera that draws, and the moment that is drawn.
_FRAME_ROLES = (*CAMERA_ROLES, "time", "frame_index", "audio")


def _input_violation(entry: Input, actual: str, expected: str) -> Violation:
    return Violation.at(f"manifest input {entry.name}", actual, expected)


@rule("GI033", Severity.ERROR, needs=("GM004", "GI005"))
def pictures_have_cameras(subject: InspectedModel) -> Iterator[Violation]:
    """All inputs of pictures and of their cameras have the same number of pictures, V.

    Why:
        A runtime feeds picture k with camera k. Cameras without pictures, or one camera too few,
        leave it nothing to feed.

    Hint:
        Give `image`, `image_view` and `image_intrinsics` the same first axis, or leave the cameras
        out where the model assumes its own.
    """
    pictures = [entry for entry in declared_inputs(subject) if entry.role in PICTURE_ROLES]
    shapes = [shape_of(subject, entry) for entry in pictures if entry.role == "image"]
    counts = [shape[0] for shape in shapes if shape]
    for entry in pictures:
        shape = shape_of(subject, entry)
        if not counts and entry.role != "image":
            yield _input_violation(entry, f"role {entry.role} without pictures", "a role image")
        elif counts and shape and shape[0] != counts[0]:
            expected = f"{counts[0]}, as the first input of pictures has"
            yield _input_violation(entry, f"{shape[0]} pictures", expected)


@rule("GI034", Severity.ERROR, needs=("GM004",), kinds=MANIFEST_KINDS)
def pass_suits_role(subject: InspectedModel) -> Iterator[Violation]:
    """The declared pass of an input suits its role: no camera or time belongs to the scene pass.

    Why:
        A runtime that runs the scene pass once would never feed the next moment or the next camera;
        pictures in every frame would make it run the network again for the same pictures.

    Hint:
        Declare "pass": "scene" for inputs that stay from frame to frame, such as a condition or a
        body shape; leave it out elsewhere.
    """
    kind = subject.manifest.kind if subject.manifest else ""
    for entry in declared_inputs(subject):
        if entry.pass_ is None:
            continue
        actual = f"role {entry.role} with the pass {entry.pass_!r}"
        if kind != GENERATOR:
            yield _input_violation(entry, actual, f"no pass, as a {kind} has no scene")
        elif entry.pass_ == "scene" and entry.role in _FRAME_ROLES:
            yield _input_violation(entry, actual, "the pass 'frame', or none")
        elif entry.pass_ == "frame" and entry.role in PICTURE_ROLES:
            yield _input_violation(entry, actual, "the pass 'scene', or none")


@rule("GI035", Severity.ERROR, needs=("GM004",), kinds=MANIFEST_KINDS)
def background_suits_pictures(subject: InspectedModel) -> Iterator[Violation]:
    """Only pictures of a generator declare a background, a colour from 0 to 1.

    Why:
        A network that was trained on white behind its objects sees a black silhouette as part of
        the object; 255 would be fed as 255 times white.

    Hint:
        Declare "background": [1, 1, 1] for white, at the input of the role `image`.
    """
    kind = subject.manifest.kind if subject.manifest else ""
    for entry in declared_inputs(subject):
        if entry.background is None:
            continue
        if entry.role != "image" or kind != GENERATOR:
            actual = f"role {entry.role} of a {kind} with a background"
            yield _input_violation(entry, actual, "role image of a gaussian-generator")
        elif not all(0 <= channel <= 1 for channel in entry.background):
            yield _input_violation(
                entry, f"background {list(entry.background)}", "red, green, blue from 0 to 1"
            )


@rule("GI036", Severity.WARNING, needs=("GI006", "GI034", "GG019"))
def scene_pass_computes(subject: InspectedModel) -> Iterator[Violation]:
    """Some operator works on scene inputs alone, if a model has scene inputs and frame inputs.

    Why:
        A runtime computes such operators once and keeps their results. Where every operator needs
        an input of the frame, it runs the whole network for each frame.

    Hint:
        Compute what depends on the scene before the inputs of the frame come in, for example by
        two functions of which the second takes the features of the first.
    """
    entries = declared_inputs(subject)
    generator = subject.generator
    scene_names = {entry.name for entry in entries if entry.is_of_scene}
    frame_names = {
        entry.name
        for entry in entries
        if not entry.is_of_scene and (generator is None or generator.depends(entry))
    }
    if not scene_names or not frame_names:
        return
    for node in subject.graph.nodes:
        names = names_read(node)
        if any(name in frame_names for name in names):
            frame_names.update(node.output)
        elif any(name in scene_names for name in names):
            return
    for entry in entries:
        if entry.is_of_scene:
            actual = "every operator on it needs an input of the frame, too"
            yield _input_violation(entry, actual, "an operator on scene inputs alone")
