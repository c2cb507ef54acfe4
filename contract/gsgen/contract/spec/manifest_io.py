"""Reads and writes manifests as JSON text: parse, upgrade, check against the schema."""

__all__ = [
    "Candidate",
    "ManifestComplaint",
    "ParsedManifest",
    "dumps",
    "loads",
    "parse",
    "schema_name",
    "schemas",
]

import json
import math
import re
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

from gsgen.contract.errors import ManifestInvalid
from gsgen.contract.spec.fields.json_schema import from_json, schema_of, to_json
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.manifest import GeneratorManifest, Manifest, manifest_type
from gsgen.contract.spec.schema_check import SchemaFault, schema_faults
from gsgen.contract.spec.upgrades import (
    CONTRACT_VERSION,
    CURRENT_VERSION,
    UPGRADE_BY_VERSION,
    Version,
    upgrade,
)

_MAX_BYTES = 4 << 20


@dataclass(frozen=True, slots=True)
class Candidate:
    """An inferred manifest, with the guesses that the model's author should confirm."""

    manifest: GeneratorManifest
    manifest_guesses: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ManifestComplaint:
    """One fault of a manifest: its location, the actual value and the expected value.

    Attributes:
        cause: ``syntax``, ``schema`` or ``version``.
        where: A path such as ``outputs.gaussians.dtype``; empty for the whole document.
        actual: The offending value, shortened.
        expected: What the schema asks for.
    """

    cause: str
    where: str
    actual: str
    expected: str


@dataclass(frozen=True, slots=True)
class ParsedManifest:
    """The result of parsing a manifest: the manifest, its version, and its faults.

    Attributes:
        manifest: The manifest, or None where a complaint prevents reading it.
        complaints: Every fault, sorted by location.
        version: The version it declares, as (major, minor), where readable.
        is_newer_version: Whether it declares a newer minor version than this reader knows.
    """

    manifest: Manifest | None
    complaints: tuple[ManifestComplaint, ...] = ()
    version: Version | None = None
    is_newer_version: bool = False


def schema_name(kind: str) -> str:
    """Return the file name of a published manifest schema."""
    return f"{kind}-{CONTRACT_VERSION}.schema.json"


def schemas() -> dict[str, dict[str, object]]:
    """Return the JSON Schemas of manifests, by file name."""
    documents: dict[str, dict[str, object]] = {}
    for kind in MANIFEST_KINDS:
        body = schema_of(manifest_type(kind), title=f"gsgen manifest: {kind}")
        documents[schema_name(kind)] = body | {"required": _required_fields(body)}
    return documents


def _required_fields(body: dict[str, object]) -> list[object]:
    required = body["required"]
    assert isinstance(required, list)
    return ["contract", "kind", *required]


@cache
def _published_schema(kind: str) -> dict[str, Any]:
    file = resources.files("gsgen.contract").joinpath("schemas", schema_name(kind))
    document: dict[str, Any] = json.loads(file.read_text("utf-8"))
    return document


def parse(text: str) -> ParsedManifest:
    """Parse the JSON text of a manifest; faults are returned as data, never raised."""
    if len(text) > _MAX_BYTES:
        return _failed_parse("syntax", "", f"{len(text)} characters", f"at most {_MAX_BYTES}")
    try:
        return _parse_document(text)
    except RecursionError:
        return _failed_parse("syntax", "", _shorten(text), "fewer brackets inside each other")


def _parse_document(text: str) -> ParsedManifest:
    try:
        document = json.loads(
            text,
            parse_float=_parse_number,
            parse_int=_parse_integer,
            parse_constant=_parse_number,
            object_pairs_hook=_unique_keys,
        )
        json.dumps(document, ensure_ascii=False).encode()  # half a surrogate pair cannot be encoded
    except ValueError as error:
        reason = _encoding_fault(text) or str(error)
        return _failed_parse("syntax", "", _excerpt(text, reason), f"a JSON document ({reason})")
    if not isinstance(document, dict):
        return _failed_parse("schema", "", _json_text(document), "a JSON object")
    version = _version(document.get("contract"))
    if version is None:
        actual = _json_text(document["contract"]) if "contract" in document else "nothing"
        return _failed_parse("version", "contract", actual, 'a version such as "1.0"')
    if version[0] != CURRENT_VERSION[0]:
        manifest_complaint = ManifestComplaint(
            "version", "contract", _version_text(version), f"major version {CURRENT_VERSION[0]}"
        )
        return ParsedManifest(None, (manifest_complaint,), version)
    return _parse_body(document, version)


def _parse_body(document: dict[str, Any], version: Version) -> ParsedManifest:
    kind = document.get("kind")
    if kind not in MANIFEST_KINDS:
        return _failed_parse(
            "schema", "kind", _json_text(kind), f"one of {', '.join(MANIFEST_KINDS)}"
        )
    is_newer_version = version > CURRENT_VERSION and version not in UPGRADE_BY_VERSION
    document = upgrade(document, version)
    faults = list(schema_faults(document, _published_schema(kind)))
    if is_newer_version:  # a newer minor may have fields that this reader does not know
        faults = [fault for fault in faults if fault.validator != "additionalProperties"]
    complaints = tuple(_complaint_from_fault(fault) for fault in sorted(faults, key=_fault_path))
    if complaints:
        return ParsedManifest(None, complaints, version, is_newer_version)
    manifest: Manifest = from_json(manifest_type(kind), document)
    return ParsedManifest(manifest, (), version, is_newer_version)


def loads(text: str) -> Manifest:
    """Parse the JSON text of a manifest, and raise ManifestInvalid if it has a fault.

    Raises:
        ManifestInvalid: The manifest has faults; the message lists all of them.
    """
    parsed = parse(text)
    if parsed.manifest is None:
        lines = [
            f"{c.where or 'document'}: {c.actual}, expected {c.expected}" for c in parsed.complaints
        ]
        raise ManifestInvalid("; ".join(lines), where="manifest")
    return parsed.manifest


def dumps(manifest: Manifest, *, indent: int | None = 2) -> str:
    """Return a manifest as JSON text, contract version and kind first.

    Raises:
        ManifestInvalid: A value in it does not follow the schema.
    """
    document = to_json(manifest)
    first = {"contract": document.pop("contract"), "kind": document.pop("kind")}
    text = json.dumps(first | {"inputs": []} | document, indent=indent, ensure_ascii=False)
    loads(text)
    return text


def _failed_parse(cause: str, where: str, actual: str, expected: str) -> ParsedManifest:
    return ParsedManifest(None, (ManifestComplaint(cause, where, actual, expected),))


def _parse_number(text: str) -> float:
    """Parse a number of a JSON document; raise for NaN, infinity and numbers beyond float64."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{_shorten(text)} is not a finite number")
    return value


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Build an object of a JSON document; raise if one of its keys is repeated."""
    document = dict(pairs)
    if len(document) != len(pairs):
        keys = [key for key, _ in pairs]
        repeated_key = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key {_shorten(repeated_key)} is repeated within an object")
    return document


def _parse_integer(text: str) -> int:
    _parse_number(text)  # some fields take it as a float
    return int(text)


def _version(value: object) -> Version | None:
    parts = value.split(".") if isinstance(value, str) else []
    if len(parts) != 2 or not all(p.isascii() and p.isdigit() and len(p) < 6 for p in parts):
        return None
    return int(parts[0]), int(parts[1])


def _version_text(version: Version) -> str:
    return f"{version[0]}.{version[1]}"


def _json_text(value: object) -> str:
    """Return a value as JSON has it, so that a text is told from a number; shortened."""
    return _shorten(json.dumps(value, ensure_ascii=False, default=str))


def _shorten(text: str) -> str:
    text = text.encode(errors="replace").decode() or "an empty text"
    return text if len(text) <= 60 else f"{text[:57]}…"


def _encoding_fault(text: str) -> str:
    """Return how a document is encoded that is not UTF-8 without a byte order mark, or no text."""
    if "\0" in text[:4]:
        return "this is UTF-16: store it as UTF-8"
    if text.startswith("\ufeff"):
        return "it begins with a byte order mark: store it as UTF-8 without one"
    return ""


def _excerpt(text: str, reason: str) -> str:
    """Return the part of a document that a message on its syntax is about, ^ before the place."""
    match = re.search(r"(?:char|position) (\d+)", reason)
    if match is None or not text:
        return _shorten(text)
    place = int(match[1])
    begin = max(0, place - 40)
    excerpt = f"{text[begin:place]}^{text[place : place + 20]}".replace("\n", " ")
    return excerpt.encode(errors="replace").decode()


def _fault_path(fault: SchemaFault) -> tuple[str | int, ...]:
    return fault.absolute_path


def _is_unknown(name: str, fault: SchemaFault) -> bool:
    patterns = fault.schema.get("patternProperties", ())
    known = name in fault.schema.get("properties", ())
    return not known and not any(re.search(pattern, name) for pattern in patterns)


def _complaint_from_fault(fault: SchemaFault) -> ManifestComplaint:
    """Translate a fault of the schema into location, actual and expected value."""
    where = ".".join(str(part) for part in fault.absolute_path)
    expected = fault.schema.get("description") if isinstance(fault.schema, dict) else None
    if fault.validator == "required":
        missing = fault.message.split("'")[1]
        return ManifestComplaint(
            "schema", where, f"no field {missing!r}", f"{missing!r} to be present"
        )
    if fault.validator == "additionalProperties":
        known = ", ".join(fault.schema.get("properties", {}))
        unmatched_entries = ", ".join(
            repr(name) for name in fault.instance if _is_unknown(name, fault)
        )
        return ManifestComplaint(
            "schema", where, _shorten(unmatched_entries), f"only the fields {known}"
        )
    if fault.validator == "enum":
        options = ", ".join(str(option) for option in fault.validator_value)
        return ManifestComplaint("schema", where, _json_text(fault.instance), f"one of {options}")
    fault_detail = f"{fault.validator} {fault.validator_value}"
    return ManifestComplaint(
        "schema",
        where,
        _json_text(fault.instance),
        f"{expected} ({fault_detail})" if expected else fault_detail,
    )
