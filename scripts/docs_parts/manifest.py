"""The manifest's fields, from the dataclasses behind its JSON Schemas."""

import json
from typing import Any

from docs_parts.tables import code, table
from gsgen.contract.spec import manifest
from gsgen.contract.spec.fields.json_schema import schema_of
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS, ROLES
from gsgen.contract.spec.manifest import manifest_type
from gsgen.contract.spec.manifest_io import schema_name


def kinds() -> str:
    """Return the kinds of model, what each does, and its schema."""
    rows = []
    for kind in MANIFEST_KINDS:
        summary = (manifest_type(kind).__doc__ or "").partition("\n")[0]
        name = schema_name(kind)
        rows.append((f"`{kind}`", summary, f"[{name}](schemas/{name})"))
    return table(("kind", "what it is", "JSON Schema"), rows)


def fields(cls: str) -> str:
    """Return the fields of one object of the manifest: type, whether required, meaning."""
    schema: dict[str, Any] = schema_of(getattr(manifest, cls))
    required = set(schema["required"]) | ({"contract", "kind"} & set(schema["properties"]))
    rows = []
    for name, entry in schema["properties"].items():
        need = "required" if name in required else _default(entry)
        text = entry.get("description", "") or _of_item(entry)
        rows.append((f"`{name}`", type_in_words(entry), need, text or "–"))
    return table(("field", "type", "if absent", "meaning"), rows)


def _default(entry: dict[str, Any]) -> str:
    if "default" in entry:
        return f"`{json.dumps(entry['default'], ensure_ascii=False)}`"
    return "–"


def _of_item(entry: dict[str, Any]) -> str:
    reference = entry.get("$ref") or entry.get("items", {}).get("$ref", "")
    if not reference:
        return ""
    cls = getattr(manifest, reference.rpartition("/")[2])
    return str(cls.__doc__).partition("\n")[0]


def type_in_words(entry: dict[str, Any]) -> str:
    """Return the type of a JSON Schema entry in words."""
    if "$ref" in entry:
        name = entry["$ref"].rpartition("/")[2]
        return f"object [{name}](#{name.lower()})"
    if entry.get("enum") == list(ROLES):
        return "a [role](roles.md)"
    if "enum" in entry:
        options = [json.dumps(option) for option in entry["enum"]]
        return code(options) if len(options) == 1 else f"one of {code(options)}"
    if "anyOf" in entry:
        return " or ".join(type_in_words(option) for option in entry["anyOf"])
    if entry["type"] == "array":
        item = type_in_words(entry["items"])
        fixed = "minItems" in entry
        return f"[{', '.join([item] * entry['minItems'])}]" if fixed else f"array of {item}"
    if entry["type"] == "object":
        return f"object of {type_in_words(entry['additionalProperties'])}"
    return f"{entry['type']}{_limits(entry)}"


def _limits(entry: dict[str, Any]) -> str:
    words = []
    if "minimum" in entry:
        words.append(f"≥ {entry['minimum']}")
    if "exclusiveMinimum" in entry:
        words.append(f"> {entry['exclusiveMinimum']}")
    if "maximum" in entry:
        words.append(f"≤ {entry['maximum']}")
    if entry.get("minLength") == 1:
        words.append("not empty")
    if "pattern" in entry:
        words.append(f"`{entry['pattern']}`")
    return f" ({', '.join(words)})" if words else ""
