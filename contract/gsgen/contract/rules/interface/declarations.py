"""Rules of declarations (GM): colours, time, provenance and dependencies."""

import hashlib
import json
import re
from collections.abc import Iterator
from pathlib import Path

from gsgen.contract.model.files_beside import FileRefused, find_contained_file
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS, POST_PROCESS, ROLES
from gsgen.contract.spec.manifest import PostProcessManifest, ReferenceImage
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.units import MEBIBYTE, format_mebibytes
from gsgen.contract.validation.finding import Violation, remove_hint, set_hint
from gsgen.contract.validation.gates import MANIFEST_PARSED
from gsgen.contract.validation.rule import rule

_METADATA_PREFIX = "gsgen."
# A PNG file begins with these bytes, and a reference image has this size at most.
_PNG_FILE_MAGIC = b"\x89PNG\r\n\x1a\n"
_MAX_IMAGE_BYTES = 32 * MEBIBYTE
_LICENSE_NAME = r"[A-Za-z0-9][A-Za-z0-9.+-]*(?::[A-Za-z0-9.+-]+)?"
_LICENSE_TERM = rf"\(*\s*{_LICENSE_NAME}\s*\)*"
_SPDX = re.compile(rf"^{_LICENSE_TERM}(?:\s+(?:AND|OR|WITH)\s+{_LICENSE_TERM})*$")


@rule("GM007", Severity.ERROR, needs=MANIFEST_PARSED)
def sh_declared_as_sh(subject: InspectedModel) -> Iterator[Violation]:
    """An SH degree is declared only for SH colours, not for raw RGB.

    Why:
        Three channels are a colour or the constant term of SH; the two differ by 0.5 + 0.282 · c.
        The contract fixes order, signs and direction of SH, so the declared space alone decides
        how a row is read, and a degree beside `rgb` says the opposite.

    Hint:
        Set "space": "sh" if the rows hold coefficients; else remove the degree.
    """
    declared = subject.declared_appearance
    if declared is not None and declared.space == "rgb" and declared.degree is not None:
        actual = f"space rgb with degree {declared.degree}"
        yield Violation.at("manifest outputs.appearance", actual, "sh, or no degree")


@rule("GM008", Severity.INFO, needs=MANIFEST_PARSED)
def color_space_declared(subject: InspectedModel) -> Iterator[Violation]:
    """The manifest declares the colour space of the appearance: sRGB or linear.

    Why:
        Readers assume sRGB without a declaration, as trained scenes are. Linear colours shown so are
        too dark.

    Hint:
        Add "color_space": "srgb" or "linear" to outputs.appearance.
    """
    if subject.declared_appearance is None or subject.file.manifest_text is None:
        return
    appearance_document = json.loads(subject.file.manifest_text)["outputs"]["appearance"]
    if "color_space" not in appearance_document:
        yield Violation.at("manifest outputs.appearance", "no color_space", "srgb or linear")


@rule("GM010", Severity.WARNING, needs=("GM004",))
def time_domain(subject: InspectedModel) -> Iterator[Violation]:
    """The declared time range has a beginning and an end, and they differ.

    Why:
        A viewer's timeline runs from one end of the range to the other; without one it guesses, and
        shows the first instant of a scene that runs for minutes.

    Hint:
        Declare "range": [first, last] for time.
    """
    for entry in subject.manifest.inputs if subject.manifest else ():
        location = f"manifest input {entry.name}"
        if entry.role == "time" and entry.range is None:
            yield Violation.at(location, "no range", '"range": [first, last]')
        is_single_instant = entry.range is not None and entry.range[0] == entry.range[1]
        if entry.role in ("time", "frame_index") and is_single_instant:
            yield Violation.at(location, f"range {list(entry.range or ())}", "first < last")


@rule("GM013", Severity.INFO, kinds=MANIFEST_KINDS, needs=MANIFEST_PARSED)
def provenance_readable(subject: InspectedModel) -> Iterator[Violation]:
    """The producer's declared licence is an SPDX expression, and the declared tool has a version.

    Why:
        Collections of models filter by licence, and a fault in an exporter can be traced to its
        version; prose helps with neither. A manifest without a producer is fine.

    Hint:
        Write "license": "Apache-2.0" or another SPDX expression, and "tool": "name 1.2".
    """
    producer = subject.manifest.producer if subject.manifest else None
    if producer is None:
        return
    if producer.license is not None and not _SPDX.match(producer.license):
        yield Violation.at(
            "manifest producer.license", repr(producer.license), "an SPDX expression"
        )
    if not any(char.isdigit() for char in producer.tool):
        yield Violation.at("manifest producer.tool", repr(producer.tool), "name and version")


@rule("GM039", Severity.ERROR, kinds=(POST_PROCESS,), needs=MANIFEST_PARSED)
def picture_range_rises(subject: InspectedModel) -> Iterator[Violation]:
    """In both ranges of a post-process model the value of black is below that of white.

    Why:
        A runtime divides by their difference: equal numbers give NaN, exchanged ones a negative.

    Hint:
        Declare "image_range" and the output's "range" as [black, white], such as [0, 1] or [-1, 1].
    """
    manifest = subject.manifest
    if not isinstance(manifest, PostProcessManifest):
        return
    ranges = {
        "image_range": manifest.image_range,
        "outputs.image.range": manifest.outputs.image.range,
    }
    for name, (black, white) in ranges.items():
        if not black < white:
            rising = [white, black] if white < black else [0, 1]
            hint = set_hint(name, rising)
            yield Violation.at(
                f"manifest {name}", str([black, white]), "black below white", hint=hint
            )


@rule("GM014", Severity.WARNING, kinds=MANIFEST_KINDS)
def manifest_at_model_level(subject: InspectedModel) -> Iterator[Violation]:
    """Contract data is stored in the model's metadata, not in the metadata of single tensors.

    Why:
        Simplifiers and optimisers keep the model's metadata and drop that of tensors: declarations
        there are lost on the way to the viewer.

    Hint:
        Declare it in the manifest, under the model-level key gsgen.manifest.
    """
    graph = subject.file.proto.graph
    metadata_keys = [
        (tensor.name, [entry.key for entry in tensor.metadata_props])
        for tensors in (graph.input, graph.output, graph.value_info)
        for tensor in tensors
    ]
    metadata_keys += [
        (w.name, [entry.key for entry in w.metadata_props]) for w in graph.initializer
    ]
    for name, keys in metadata_keys:
        contract_keys = [key for key in keys if key.startswith(_METADATA_PREFIX)]
        if contract_keys:
            yield Violation.at(f"tensor {name}", f"key {contract_keys[0]!r}", "the manifest")


@rule("GM016", Severity.ERROR, needs=MANIFEST_PARSED)
def dependencies_are_inputs(subject: InspectedModel) -> Iterator[Violation]:
    """`depends_on` names only declared inputs and their input roles.

    Why:
        A misspelt name says nothing of the one that was meant, which then counts as one that the
        outputs depend on: the model runs at every move of a camera that it does not look at. A
        role that exists but that no input has is harmless, and probably a remainder.

    Hint:
        Remove the entry, or write the name or the role as it stands in the inputs.
    """
    generator = subject.generator
    if generator is None or subject.candidate is not None:
        return
    known = dict.fromkeys(name for entry in generator.inputs for name in (entry.name, entry.role))
    for role in generator.depends_on:
        if role not in known:
            actual = "no input has this role" if role in ROLES else "neither an input nor a role"
            known_text = ", ".join(known) or "none: there are no inputs"
            yield Violation.at(
                f"manifest depends_on {role!r}",
                actual,
                f"one of {known_text}",
                certainty="possible" if role in ROLES else "confirmed",
            )


@rule("GM025", Severity.ERROR, needs=MANIFEST_PARSED)
def reference_images_present(subject: InspectedModel) -> Iterator[Violation]:
    """Every declared reference image is an unchanged PNG in the model's folder or below it.

    Why:
        A picture that was not shipped compares nothing, and a path that leads out of the folder
        reads files of the machine that validates the model.

    Hint:
        Ship the pictures beside the model, draw them again with
        `gsgen references MODEL -o MODEL --force` if the model has changed, or remove them.
    """
    for index, image in enumerate(subject.generator.reference_images if subject.generator else ()):
        fault = _image_fault(subject.file.path, image)
        if fault is not None:
            again = "draw it again with `gsgen references MODEL -o MODEL --force`, and ship it"
            hint = remove_hint(f"reference_images.{index}", again)
            yield Violation.at(
                f"manifest reference_images.{index} {image.path!r}", *fault, hint=hint
            )


def _image_fault(model: Path, image: ReferenceImage) -> tuple[str, str] | None:
    """Return the fault of a reference image's file, and the expected value; None if valid."""
    expected = "a PNG in the model's folder or below it"
    try:
        path = find_contained_file(model, image.path)
        if path.stat().st_size > _MAX_IMAGE_BYTES:
            return format_mebibytes(path.stat().st_size), f"{format_mebibytes(_MAX_IMAGE_BYTES)}"
        content = path.read_bytes()
    except FileRefused as error:
        return error.actual, expected
    except OSError as error:
        return f"cannot be read: {error}", expected
    if not content.startswith(_PNG_FILE_MAGIC):
        return "is not a PNG", expected
    digest = hashlib.sha256(content).hexdigest()
    if digest != image.sha256:
        return f"sha256 {digest}", f"the declared {image.sha256}"
    return None
