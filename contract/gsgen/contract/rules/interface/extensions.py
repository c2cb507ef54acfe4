"""Validation rules of manifest declarations: extensions, operator profile, memory and units."""

import json
from collections.abc import Iterator
from typing import Any

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.model.model_file import MANIFEST_KEY, NEUTRAL_KEY
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.layout import ITEMSIZE, ROW_LENGTH
from gsgen.contract.spec.manifest import GeneratorManifest, TrajectoryManifest
from gsgen.contract.spec.onnx_facts import MAIN_DOMAIN
from gsgen.contract.spec.reader_needs import READER_PROFILES, REGISTERED_EXTENSIONS
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.units import format_bytes
from gsgen.contract.validation.finding import Violation, remove_hint
from gsgen.contract.validation.gates import MANIFEST_PARSED
from gsgen.contract.validation.rule import rule

_MAX_NAMED_EXTENSIONS = 5


@rule("GM030", Severity.ERROR, kinds=MANIFEST_KINDS, needs=MANIFEST_PARSED)
def required_extensions_used(subject: InspectedModel) -> Iterator[Violation]:
    """Every extension in `extensions_required` is also listed in `extensions_used`.

    Why:
        A tool lists what a collection of models uses by the second field alone.

    Hint:
        Add the name to "extensions_used".
    """
    manifest = subject.manifest
    used_extensions = manifest.extensions_used if manifest else ()
    present = set(_field_names(json.loads(subject.file.manifest_text or "{}")))
    for index, name in enumerate(manifest.extensions_required if manifest else ()):
        if name not in used_extensions:
            actual, expected = f"{name} is not in extensions_used", f"{name} in both lists"
            hint = f'Add "{name}" to extensions_used.'
            if name not in present:
                hint = remove_hint(f"extensions_required.{index}", f"write the field {name}")
            yield Violation.at("manifest extensions_required", actual, expected, hint=hint)


@rule("GM038", Severity.ERROR, kinds=MANIFEST_KINDS, needs=MANIFEST_PARSED)
def used_extensions_present(subject: InspectedModel) -> Iterator[Violation]:
    """Every extension in `extensions_used` is the name of a field somewhere in the manifest.

    Why:
        The list outlives the field that a tool dropped: readers prepare for a missing field, and
        a model that requires it is refused for nothing.

    Hint:
        Remove the name from "extensions_used" and "extensions_required", or write its field again.
    """
    manifest = subject.manifest
    text = subject.file.manifest_text
    if manifest is None or not manifest.extensions_used or not text:
        return
    present = set(_field_names(json.loads(text)))
    for name in manifest.extensions_used:
        if name not in present:
            yield Violation.at("manifest extensions_used", name, f"a field {name} in the manifest")


def _field_names(value: Any) -> Iterator[str]:
    """Yield the names of all fields of a JSON value."""
    if isinstance(value, dict):
        yield from value
    for part in value.values() if isinstance(value, dict) else value:
        if isinstance(part, (dict, list)):
            yield from _field_names(part)


@rule("GM031", Severity.ERROR, kinds=MANIFEST_KINDS, needs=("GM030",))
def required_extensions_known(subject: InspectedModel) -> Iterator[Violation]:
    """Every required manifest extension is registered.

    Why:
        A reader refuses a model that requires what it does not know; an extension that nobody else
        can look up closes the model to all readers but one. A viewer that refuses it names the
        extension, and shows nothing of the model.

    Hint:
        Register the extension as the page of extensions says, or do not require it.
    """
    extensions = subject.manifest.extensions_required if subject.manifest else ()
    for index, name in enumerate(extensions):
        if name not in REGISTERED_EXTENSIONS:
            known = ", ".join(REGISTERED_EXTENSIONS) or "none is registered yet"
            expected = f"a registered extension ({known})"
            alternative = "register the extension as the page of extensions says"
            hint = remove_hint(f"extensions_required.{index}", alternative)
            yield Violation.at("manifest extensions_required", name, expected, hint=hint)


@rule("GM032", Severity.ERROR, kinds=MANIFEST_KINDS, needs=(*MANIFEST_PARSED, "GG019"))
def operator_profile_holds(subject: InspectedModel) -> Iterator[Violation]:
    """The graph has only operators and operator sets of the declared operator profile.

    Why:
        A runtime with the operators of a profile accepts the model for its word, and fails at
        load or in the middle of a frame.

    Hint:
        Replace the operators, with `gsgen rewrite` for example, or remove "operator_profile".
    """
    name = subject.manifest.operator_profile if subject.manifest else None
    if name is None:
        return
    if name not in READER_PROFILES:
        expected = f"one of {', '.join(READER_PROFILES)}"
        yield Violation.at("manifest operator_profile", repr(name), expected)
        return
    profile = READER_PROFILES[name]
    opset = max(
        (o.version for o in subject.file.proto.opset_import if o.domain in MAIN_DOMAIN), default=0
    )
    if not profile.opset[0] <= opset <= profile.opset[1]:
        expected = f"{profile.opset[0]} to {profile.opset[1]}, as {name} has"
        yield Violation.at("manifest operator_profile", f"operator set {opset}", expected)
    missing = profile.missing(node.op_type for node in subject.graph.all_nodes())
    if missing:
        remainder_text = (
            f" and {len(missing) - _MAX_NAMED_EXTENSIONS} more"
            if len(missing) > _MAX_NAMED_EXTENSIONS
            else ""
        )
        actual = f"{', '.join(missing[:_MAX_NAMED_EXTENSIONS])}{remainder_text} in the graph"
        yield Violation.at("manifest operator_profile", actual, f"operators of {name} alone")


@rule("GM034", Severity.ERROR, needs=("GM005",))
def cost_plausible(subject: InspectedModel) -> Iterator[Violation]:
    """The declared memory of a frame is at least the size of the packed rows of one frame.

    Why:
        A scheduler that plans by a number that is too small runs out of memory.

    Hint:
        Measure the peak memory of a session with `gsgen bench`, in bytes.
    """
    generator, declared = subject.generator, subject.declared_gaussians
    if generator is None or declared is None:
        return
    frame = declared.capacity * ROW_LENGTH * ITEMSIZE[declared.dtype]
    for number, entry in enumerate(generator.cost):
        if entry.bytes is not None and entry.bytes < frame:
            expected = f"at least {format_bytes(frame)}, the packed rows"
            measured = "measure the peak memory of a session with `gsgen bench`, in bytes"
            hint = remove_hint(f"cost.{number}", measured)
            yield Violation.at(
                f"manifest cost.{number}", format_bytes(entry.bytes), expected, hint=hint
            )


@rule("GM035", Severity.ERROR, kinds=MANIFEST_KINDS)
def manifest_keys_agree(subject: InspectedModel) -> Iterator[Violation]:
    """Manifests stored under both ONNX metadata keys of a model are the same.

    Why:
        One reader looks under one key, the next under the other: the same file is two models.

    Hint:
        Keep one of the two, or write the same text under both.
    """
    texts = {subject.file.metadata.get(key) for key in (MANIFEST_KEY, NEUTRAL_KEY)} - {None}
    if len(texts) > 1:
        actual = f"{MANIFEST_KEY} and {NEUTRAL_KEY} differ"
        yield Violation.at("metadata_props", actual, "one manifest")


@rule("GM036", Severity.ERROR, kinds=MANIFEST_KINDS, needs=MANIFEST_PARSED)
def unit_agrees_with_scale(subject: InspectedModel) -> Iterator[Violation]:
    """A coordinate frame in the unit `metre` has one metre per unit.

    Why:
        One reader takes the unit, the next the length: the scene is placed at two sizes.

    Hint:
        Write "unit": "arbitrary" beside a "metres_per_unit" other than 1.
    """
    manifest = subject.manifest
    space = None
    if isinstance(manifest, (GeneratorManifest, TrajectoryManifest)):
        space = manifest.space
    if space is not None and space.unit == "metre" and space.metres_per_unit not in (None, 1.0):
        actual = f"unit metre with {space.metres_per_unit:g} metres_per_unit"
        yield Violation.at("manifest space", actual, "1, or unit arbitrary")
