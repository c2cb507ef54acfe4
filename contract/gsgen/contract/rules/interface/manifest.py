"""Rules of the manifest (GM): it exists, is valid, and agrees with the graph."""

import json
from collections.abc import Iterator
from typing import Any

from gsgen.contract.model.graph import Tensor
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.model.model_file import MANIFEST_KEY
from gsgen.contract.spec.fields.roles import GENERATOR, MANIFEST_KINDS
from gsgen.contract.spec.layout import ITEMSIZE, appearance_channels
from gsgen.contract.spec.manifest import CellsOutput, GaussiansOutput
from gsgen.contract.spec.manifest_io import ManifestComplaint, parse
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.upgrades import CONTRACT_VERSION, UPGRADE_BY_VERSION
from gsgen.contract.validation.finding import Violation, remove_hint, set_hint
from gsgen.contract.validation.gates import MANIFEST_PARSED
from gsgen.contract.validation.rule import rule

# A manifest names its kind within so many characters.
_MANIFEST_OPENING = 1 << 16
# What a manifest may lack; other outputs are required.
_OPTIONAL_PATHS = ("inputs.", "outputs.count", "outputs.cells")
_POINT_HINT = "Remove bounds, or measure them over all times and poses, as the SDK does."
_BAKED_INPUT_HINT = (
    "Exporters leave out inputs that nothing depends on: export without detaching it (numpy round "
    "trips, `.item()`, Python branches), or remove"
)


@rule("GM001", Severity.ERROR, kinds=MANIFEST_KINDS)
def manifest_present(subject: InspectedModel) -> Iterator[Violation]:
    """The model carries a manifest in its metadata.

    Why:
        Without one a viewer guesses the meaning of tensors from parts of their names, and a wrong
        guess shows a wrong picture without any error. A manifest stored anywhere else is not read.

    Hint:
        Derive one with `gsgen inspect MODEL --emit-manifest > MANIFEST`, correct what it had to
        guess, and embed it with `gsgen fix MODEL --manifest MANIFEST -o COPY`.
    """
    if subject.parsed is None:
        misplaced_text = _misplaced_manifest(subject)
        actual = f"no key {MANIFEST_KEY!r}" + (f", but {misplaced_text}" if misplaced_text else "")
        yield Violation.at("metadata_props", actual, "a manifest under that key")


def _misplaced_manifest(subject: InspectedModel) -> str:
    """Return where else in the model a text looks like a manifest; empty if nowhere."""
    proto = subject.file.proto
    for key, value in subject.file.metadata.items():
        if key.lower() == MANIFEST_KEY:
            return f"a key {key!r}, which differs in case"
        if _looks_like_manifest(value):
            return f"a manifest under the key {key!r}"
    if any(_looks_like_manifest(entry.value) for entry in proto.graph.metadata_props):
        return "a manifest in the metadata of the graph, which is not that of the model"
    docs = (("model", proto.doc_string), ("graph", proto.graph.doc_string))
    for owner, text in docs:
        if _looks_like_manifest(text):
            return f"a manifest in the doc string of the {owner}"
    return ""


def _looks_like_manifest(text: str) -> bool:
    """Return whether a text begins like a JSON object and names a kind of model."""
    first_text = text[:_MANIFEST_OPENING].lstrip()
    return first_text.startswith("{") and any(f'"{kind}"' in first_text for kind in MANIFEST_KINDS)


@rule("GM002", Severity.ERROR, kinds=MANIFEST_KINDS)
def manifest_schema(subject: InspectedModel) -> Iterator[Violation]:
    """The manifest is a JSON document that follows the schema of its kind.

    Why:
        A reader that cannot parse the manifest knows nothing of the model; one that parses half of
        it draws something else than was meant.

    Hint:
        Correct the field named here; the schema is printed by `gsgen inspect --schema KIND`.
    """
    keys = [entry.key for entry in subject.file.proto.metadata_props]
    if keys.count(MANIFEST_KEY) > 1:
        actual = f"the key {MANIFEST_KEY!r} is repeated: {keys.count(MANIFEST_KEY)} manifests"
        yield Violation.at("metadata_props", actual, "one manifest")
    for manifest_complaint in subject.parsed.complaints if subject.parsed else ():
        if manifest_complaint.cause in ("schema", "syntax"):
            location = f"manifest {manifest_complaint.where}".strip()
            yield Violation.at(
                location,
                manifest_complaint.actual,
                manifest_complaint.expected,
                hint=_schema_hint(subject, manifest_complaint),
            )


def _schema_hint(subject: InspectedModel, complaint: ManifestComplaint) -> str:
    """Return the hint to write what the graph says in a field's place; empty if it does not say."""
    from gsgen.contract.model.manifest_inference import infer_manifest
    from gsgen.contract.spec.fields.json_schema import to_json

    text = subject.file.manifest_text or ""
    if complaint.cause == "syntax" or complaint.expected == "a JSON object":
        return ""
    written, inferred = json.loads(text), to_json(infer_manifest(subject.graph, "").manifest)
    _, _, missing = complaint.actual.partition("no field ")
    keys = [key for key in complaint.where.split(".") if key]
    if complaint.expected.startswith("only the fields"):
        path = ".".join([*keys, complaint.actual.strip("'")])
        is_one = path.replace(".", "_").isidentifier()
        return remove_hint(path, "correct its name") if is_one else ""
    keys += [missing.strip("'")] if missing else []
    outputs = written.get("outputs")
    if isinstance(outputs, dict) and "gaussians" in outputs and written.get("kind") != GENERATOR:
        return set_hint("kind", GENERATOR)
    if written.get("kind") != GENERATOR or not keys:
        return ""
    if keys[0] not in (*inferred, "inputs") and len(keys) > 1:
        # The field alone, if it may be absent, or what it belongs to, if nothing else needs that.
        path = ".".join(keys)
        if _may_lack(written, keys):
            return remove_hint(path, "correct it")
        return "" if written.get("blend") == "wsr" else remove_hint(keys[0], f"correct {path}")
    for key in keys:
        if isinstance(written, list) and isinstance(inferred, list):
            written = written[int(key)]
            name = written.get("name") if isinstance(written, dict) else None
            entries = [entry for entry in inferred if isinstance(entry, dict)]  # or numbers
            inferred = next((entry for entry in entries if entry["name"] == name), None)
        elif isinstance(inferred, dict):
            written = written.get(key) if isinstance(written, dict) else None
            inferred = inferred.get(key)
    is_guess = '"space": "rgb"' in json.dumps(inferred)  # three channels may be RGB or SH
    return "" if inferred is None or is_guess else set_hint(".".join(keys), inferred)


def _may_lack(document: Any, keys: list[str]) -> bool:
    """Return whether a manifest without one of its fields follows its schema."""
    owner = document = json.loads(json.dumps(document))
    for key in keys[:-1]:
        owner = owner[int(key)] if isinstance(owner, list) else owner.get(key)
        if not isinstance(owner, (dict, list)):
            return False
    if not isinstance(owner, dict) or keys[-1] not in owner:
        return False
    del owner[keys[-1]]
    return not parse(json.dumps(document)).complaints


@rule("GM003", Severity.ERROR, kinds=MANIFEST_KINDS)
def manifest_version(subject: InspectedModel) -> Iterator[Violation]:
    """The manifest declares a contract version that this validator supports.

    Why:
        A newer major version may change what a field means, so guessing would be wrong in silence.
        A viewer refuses the model, and shows nothing of it.

    Hint:
        Update gsgen, or export the model for the contract version that your readers know.
    """
    for manifest_complaint in subject.parsed.complaints if subject.parsed else ():
        if manifest_complaint.cause == "version":
            yield Violation.at(
                f"manifest {manifest_complaint.where}",
                manifest_complaint.actual,
                manifest_complaint.expected,
            )


@rule("GM004", Severity.ERROR, needs=MANIFEST_PARSED, kinds=MANIFEST_KINDS)
def declared_tensors_exist(subject: InspectedModel) -> Iterator[Violation]:
    """Every tensor that the manifest names is a graph input or output, and is named only once.

    Why:
        A role that points at no tensor cannot be fed or read; the runtime fails at the first frame.

    Hint:
        Write the names as the graph has them; `gsgen inspect MODEL` lists both.
    """
    manifest = subject.manifest
    if manifest is None:
        return
    inputs = [(f"inputs.{index}", entry.name) for index, entry in enumerate(manifest.inputs)]
    yield from _name_faults("input", inputs, [t.name for t in subject.graph.inputs])
    outputs = list(subject.declared_outputs)
    yield from _name_faults("output", outputs, [t.name for t in subject.graph.outputs])


def _name_faults(
    kind: str, declared: list[tuple[str, str]], known: list[str]
) -> Iterator[Violation]:
    """Yield the declared names (with their paths) that the graph lacks, or that are repeated.

    The last comes first: who removes an entry of a list changes the paths of those behind it.
    """
    names = [name for _, name in declared]
    free = [name for name in known if name not in names]
    faults = [n for i, n in enumerate(names) if n not in known or n in names[:i]]
    for index, (path, name) in reversed(list(enumerate(declared))):
        paths = [p for p, n in declared if n == name and p.endswith(f".{free[0]}")] if free else []
        # One name is left for one fault: of several faults, it may mend any.
        is_clear = len(free) == len(faults) == 1
        hint = set_hint(f"{[*paths, path][0]}.name", free[0]) if is_clear else ""
        if name not in known:
            expected = _one_of_names_text(known)
            hint = f"{_BAKED_INPUT_HINT} {path}." if kind == "input" and not free else hint
            yield Violation.at(
                f"manifest {kind} {name!r}", f"no such graph {kind}", expected, hint=hint
            )
        elif name in names[:index]:
            where, expected = f"manifest name {name!r}", "one role per tensor"
            if not hint and path.startswith(_OPTIONAL_PATHS):
                hint = remove_hint(path, "name the tensor that is meant")
            yield Violation.at(where, "declared more than once", expected, hint=hint)


def _one_of_names_text(names: list[str]) -> str:
    names_text = ", ".join(names[:8]) + (", …" if len(names) > 8 else "")
    return f"one of {names_text}" if names else "a tensor that exists; the graph has none"


@rule("GM005", Severity.ERROR, needs=("GM004",), kinds=MANIFEST_KINDS)
def manifest_agrees_with_graph(subject: InspectedModel) -> Iterator[Violation]:
    """The dtypes and sizes that the manifest declares are compatible with the graph.

    Why:
        Runtimes allocate buffers from the manifest; a buffer of another size or dtype is read as
        noise or refused at the first frame.

    Hint:
        Take the values from the graph, or export again so that they agree.
    """
    for entry in subject.manifest.inputs if subject.manifest else ():
        tensor = subject.graph.input(entry.name)
        dims, shape = tensor.dims if tensor else None, entry.shape
        # Height and width of a picture may be open in the graph.
        if (
            dims
            and shape
            and (
                len(dims) != len(shape)
                or any(isinstance(a, int) and a != b for a, b in zip(dims, shape, strict=True))
            )
        ):
            actual = f"graph has {list(dims)}"
            yield Violation.at(f"input {entry.name}", actual, f"the declared shape {list(shape)}")
    yield from _dtypes_agree(subject.declared_gaussians, subject.gaussians)
    yield from _gaussians_agree(subject)
    yield from _appearance_agrees(subject)
    yield from _dtypes_agree(subject.declared_cells, subject.cells)


def _dtypes_agree(
    declared: GaussiansOutput | CellsOutput | None, tensor: Tensor | None
) -> Iterator[Violation]:
    if declared is None or tensor is None:
        return
    if tensor.dtype in ITEMSIZE and tensor.dtype != declared.dtype:
        actual, expected = (f"graph has {tensor.dtype}", f"the declared dtype {declared.dtype}")
        yield Violation.at(f"output {tensor.name}", actual, expected)


def _gaussians_agree(subject: InspectedModel) -> Iterator[Violation]:
    declared, tensor = subject.declared_gaussians, subject.gaussians
    if declared is None or tensor is None or tensor.dims is None:
        return
    location = f"output {tensor.name}"
    first = tensor.dims[0] if tensor.dims else None
    is_inferred = subject.candidate is not None  # taken from the graph, so it cannot disagree
    known = len(tensor.dims) == 2 and isinstance(first, int) and first > 0
    if known and not is_inferred and first != declared.capacity:
        expected = f"the declared capacity {declared.capacity}"
        yield Violation.at(location, f"graph has {first} rows", expected)


def _appearance_agrees(subject: InspectedModel) -> Iterator[Violation]:
    declared, tensor = subject.declared_appearance, subject.appearance
    if (
        declared is None
        or tensor is None
        or tensor.dims is None
        or len(tensor.dims) != 2
        or tensor.dtype not in ITEMSIZE
    ):
        return
    channels = tensor.dims[-1]
    if declared.space != "sh" or not isinstance(channels, int):
        return
    if declared.degree is None:
        actual = "no degree is declared"
        yield Violation.at(f"output {tensor.name}", actual, f"the degree of {channels} SH channels")
        return
    expected_channels = appearance_channels("sh", declared.degree, 4)
    valid_channel_counts = {appearance_channels("sh", degree, 4) for degree in range(4)}
    if channels in valid_channel_counts and channels != expected_channels:
        expected = f"{expected_channels} channels, as SH degree {declared.degree} has"
        yield Violation.at(f"output {tensor.name}", f"graph has {channels} channels", expected)


@rule("GM006", Severity.WARNING, needs=MANIFEST_PARSED)
def coordinate_frame_declared(subject: InspectedModel) -> Iterator[Violation]:
    """The manifest declares the coordinate frame: up axis, unit and matrix memory order.

    Why:
        Two hosts that assume different frames show the same model upside down or mirrored, and a
        view matrix read in the wrong memory order moves the camera centre.

    Hint:
        Add "space": {"handedness": "right", "up": …, "unit": …, "matrix_order": …}.
    """
    if subject.candidate is None and subject.generator and subject.generator.space is None:
        yield Violation.at("manifest space", "not declared", "up, unit and matrix_order")


@rule("GM009", Severity.WARNING, needs=MANIFEST_PARSED)
def bounds_declared(subject: InspectedModel) -> Iterator[Violation]:
    """The manifest declares the bounding box that contains the Gaussians at all times.

    Why:
        Without it a viewer cannot frame the model, cull it, or choose near and far planes; the
        usual fallback is a box of ±1 around the origin.

    Hint:
        Add "bounds": {"min": [x, y, z], "max": [x, y, z]}; the SDK measures them at export.
    """
    generator = subject.generator
    if subject.candidate is None and generator is not None and generator.bounds is None:
        yield Violation.at("manifest bounds", "not declared", "min and max corners")


@rule("GM019", Severity.ERROR, needs=MANIFEST_PARSED)
def bounds_are_a_box(subject: InspectedModel) -> Iterator[Violation]:
    """Bounds run from low to high on every axis, and are not a point if there are several rows.

    Why:
        A viewer frames the camera by the box. A box that is inside out or a point has no size:
        the camera stands inside the scene, or everything is culled.

    Hint:
        Measure the bounds over all times and poses and write the lower corner first; the SDK
        measures them at export.
    """
    generator, declared = subject.generator, subject.declared_gaussians
    if generator is None or generator.bounds is None or declared is None:
        return
    low, high = generator.bounds.min, generator.bounds.max
    actual = f"min {list(low)}, max {list(high)}"
    if not all(a <= b for a, b in zip(low, high, strict=True)):
        yield Violation.at("manifest bounds", actual, "min <= max on every axis")
    elif low == high and declared.capacity > 1:
        expected = "a box; these bounds are a point"
        yield Violation.at("manifest bounds", actual, expected, hint=_POINT_HINT)


@rule("GM015", Severity.WARNING, kinds=MANIFEST_KINDS)
def manifest_minor_known(subject: InspectedModel) -> Iterator[Violation]:
    """The manifest is of no newer minor version than this validator supports.

    Why:
        Fields that came with the newer version are left unread.

    Hint:
        Update gsgen.
    """
    if subject.parsed is not None and subject.parsed.is_newer_version and subject.parsed.version:
        major, minor = subject.parsed.version
        yield Violation.at(
            "manifest contract",
            f"{major}.{minor}",
            f"{CONTRACT_VERSION} or older",
            hint=_version_hint(subject),
        )


def _version_hint(subject: InspectedModel) -> str:
    """Return the hint to declare the version of this validator if the manifest follows it."""
    document = json.loads(subject.file.manifest_text or "")
    complaints = parse(json.dumps({**document, "contract": CONTRACT_VERSION})).complaints
    hint = f"Nothing in it is newer: {set_hint('contract', CONTRACT_VERSION)} Or update gsgen."
    return "" if complaints else hint


@rule("GM018", Severity.INFO, kinds=MANIFEST_KINDS)
def contract_version_released(subject: InspectedModel) -> Iterator[Violation]:
    """The manifest declares a released contract version, not one of a development build.

    Why:
        Builds of gsgen before the first release wrote 1.1 and 1.2. Contract 1.0 has all their
        fields, so such a manifest is read as 1.0; other readers may refuse it.

    Hint:
        Export the model again, or set "contract": "1.0".
    """
    if subject.parsed is not None and subject.parsed.version in UPGRADE_BY_VERSION:
        yield Violation.at("manifest contract", subject.declared_version, CONTRACT_VERSION)
