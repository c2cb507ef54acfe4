"""Validation rules of avatar inputs: skeletons, blend weights and sound."""

from collections.abc import Iterator

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.rules.interface.input_declarations import declared_inputs, shape_of
from gsgen.contract.spec.manifest import Input
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation, line_hint, remove_hint, set_hint
from gsgen.contract.validation.rule import rule

_SOUND_FIELDS = ("rate", "window", "hop")
_MEL_ROLE = "mel"
# Samples per second that networks of speech usually take.
_USUAL_RATE = 16000
_ARKIT_BLENDSHAPE_SET = "arkit-52"


@rule("GI030", Severity.ERROR, needs=("GM004", "GI005"))
def joints_fit_pose(subject: InspectedModel) -> Iterator[Violation]:
    """A pose with joints declares one named joint for each row, every joint after its parent.

    Why:
        A tool that retargets motion walks the joints once, from the root outwards, and writes row
        k by joint k.

    Hint:
        List one joint for each row, in the order of the rows, parents first.
    """
    for entry in declared_inputs(subject):
        if not entry.joints:
            continue
        shape = shape_of(subject, entry)
        path = f"{subject.path_of(entry)}.joints"
        hint = remove_hint(path, "list one for each row, in the order of the rows, parents first")
        if entry.role != "pose":
            yield _input_violation(entry, f"role {entry.role} with joints", "role pose")
        elif shape is not None and len(entry.joints) != shape[0]:
            expected = f"{shape[0]}, one for each row"
            yield _input_violation(entry, f"{len(entry.joints)} joints", expected, hint)
        else:
            yield from _order_faults(entry, hint)


def _order_faults(entry: Input, hint: str) -> Iterator[Violation]:
    preceding_input_names: set[str] = set()
    for joint in entry.joints:
        if joint.name in preceding_input_names:
            yield _input_violation(entry, f"two joints {joint.name!r}", "different names", hint)
        if joint.parent is not None and joint.parent not in preceding_input_names:
            actual = f"joint {joint.name!r} before its parent {joint.parent!r}"
            yield _input_violation(entry, actual, "parents first", hint)
        preceding_input_names.add(joint.name)


@rule("GI031", Severity.ERROR, needs=("GM004", "GI015"))
def blend_weights_in_unit_range(subject: InspectedModel) -> Iterator[Violation]:
    """The declared range of ARKit's blend weights lies in [0, 1].

    Why:
        Trackers send weights from 0 to 1. A model that expects percent does not move its face.

    Hint:
        Divide by 100 in the model, and declare "range": [0, 1].
    """
    for entry in declared_inputs(subject):
        if entry.convention == _ARKIT_BLENDSHAPE_SET and entry.range is not None:
            low, high = entry.range
            if not 0 <= low <= high <= 1:
                line = line_hint(f"{entry.name} = {entry.name} * {max(-low, high):.9g}", first=True)
                hint = f"{set_hint(f'{subject.path_of(entry)}.range', [0, 1])} {line}"
                yield _input_violation(entry, f"range {[low, high]}", "within [0, 1]", hint)


@rule("GI032", Severity.ERROR, needs=("GM004", "GI015"))
def sound_described(subject: InspectedModel) -> Iterator[Violation]:
    """Audio inputs declare a sample rate, mel inputs also window and hop; other inputs none.

    Why:
        A runtime that resamples a microphone to an assumed rate moves the lips at another speed.

    Hint:
        Declare "rate" in samples per second; for mel also "window" and "hop", in samples.
    """
    for entry in declared_inputs(subject):
        declared = [name for name in _SOUND_FIELDS if getattr(entry, name) is not None]
        if entry.role != "audio":
            if declared:
                yield _input_violation(
                    entry, f"role {entry.role} with {', '.join(declared)}", "role audio"
                )
            continue
        shape = shape_of(subject, entry)
        is_mel = entry.convention == _MEL_ROLE or (shape is not None and len(shape) > 1)
        required_fields = _SOUND_FIELDS if is_mel else _SOUND_FIELDS[:1]
        missing = [name for name in required_fields if name not in declared]
        if missing:
            hint = _sound_hint(subject.path_of(entry), entry, missing)
            expected = f"{', '.join(required_fields)} of the sound"
            yield _input_violation(entry, f"no {', '.join(missing)}", expected, hint)
        elif is_mel and (entry.hop or 0) > (entry.window or 0):
            actual = f"hop {entry.hop} beyond the window {entry.window}"
            expected = "hop <= window, so that no sample is skipped"
            hint = f'Declare "hop": {entry.window}, or a wider window, as the model was trained.'
            yield _input_violation(entry, actual, expected, hint)


def _sound_hint(path: str, entry: Input, missing: list[str]) -> str:
    """Return the hint to declare what is missing as it usually is: 25 ms every 10 ms."""
    rate = entry.rate or _USUAL_RATE
    window = entry.window or rate // 40
    usual = {"rate": rate, "window": window, "hop": window * 2 // 5}
    hints = " ".join(set_hint(f"{path}.{name}", int(usual[name])) for name in missing)
    return f"Declare what the network was trained with, often this: {hints}"


def _input_violation(entry: Input, actual: str, expected: str, hint: str = "") -> Violation:
    return Violation.at(f"manifest input {entry.name}", actual, expected, hint=hint)
