import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from gsgen.contract.reporters.document import schema as report_schema
from gsgen.contract.spec.fields.json_schema import (
    SCHEMA_DIALECT,
    Hint,
    from_json,
    schema_of,
    to_json,
)
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.manifest_io import loads, parse, schema_name, schemas
from gsgen.contract.validation.report import REPORT_SCHEMA_FILE
from support.models.manifests import JSON, manifests

ROOT = Path(__file__).parents[3]
SCHEMA_FOLDER = ROOT / "contract/gsgen/contract/schemas"
WRITER = "scripts/write_docs.py"


def test_the_published_schemas_are_those_of_the_dataclasses():
    documents = {**schemas(), REPORT_SCHEMA_FILE: report_schema()}
    assert {file.name for file in SCHEMA_FOLDER.iterdir()} == documents.keys()
    for name, document in documents.items():
        text = json.dumps(document, indent=2, ensure_ascii=False) + "\n"
        same = (SCHEMA_FOLDER / name).read_bytes() == text.encode()
        assert same, f"{name} is out of date: run {sys.executable} {WRITER}"


@pytest.mark.parametrize("kind", MANIFEST_KINDS)
def test_every_schema_is_valid_and_names_its_dialect(kind):
    document = schemas()[schema_name(kind)]
    Draft202012Validator.check_schema(document)
    assert document["$schema"] == SCHEMA_DIALECT
    assert document["required"][:2] == ["contract", "kind"]


def objects(schema):
    yield schema
    yield from schema["$defs"].values()


@pytest.mark.parametrize("document", schemas().values(), ids=schemas())
def test_every_object_is_closed_but_for_extensions_and_says_what_it_is(document):
    for entry in objects(document):
        assert entry["additionalProperties"] is False
        assert entry["patternProperties"] == {"^x-": True}
        assert entry["description"]


@settings(max_examples=60)
@given(manifests())
def test_dataclasses_conform_to_the_schema_and_round_trip(manifest):
    document = json.loads(json.dumps(to_json(manifest)))
    schema = schemas()[schema_name(manifest.kind)]
    assert list(Draft202012Validator(schema).iter_errors(document)) == []
    assert from_json(type(manifest), document) == manifest


def places(value, path=()):
    """Every path into a JSON document."""
    yield path
    pairs = value.items() if isinstance(value, dict) else ()
    for key, inner in enumerate(value) if isinstance(value, list) else pairs:
        yield from places(inner, (*path, key))


@st.composite
def mutated(draw):
    """The JSON of a manifest with one thing changed."""
    document = to_json(draw(manifests()))
    *path, last = draw(st.sampled_from([p for p in places(document) if p]))
    container = document
    for key in path:
        container = container[key]
    change = draw(st.sampled_from(["delete", "replace", "add"]))
    if change == "delete":
        del container[last]
    elif change == "add" and isinstance(container, dict):
        container[draw(st.text(max_size=6))] = draw(JSON)
    else:
        container[last] = draw(JSON)
    return document


@settings(max_examples=100)
@given(mutated())
def test_the_reader_accepts_exactly_what_the_schema_accepts(document):
    text = json.dumps(document)
    parsed = parse(text)
    if parsed.manifest is not None:
        schema = schemas()[schema_name(parsed.manifest.kind)]
        assert list(Draft202012Validator(schema).iter_errors(document)) == []
        again = json.dumps(to_json(parsed.manifest))
        assert loads(again) == parsed.manifest
        return
    assert parsed.complaints
    for complaint in parsed.complaints:
        assert complaint.cause in ("syntax", "schema", "version")
        assert complaint.actual
        assert complaint.expected
        assert len(complaint.actual) <= 60
        f"{complaint.where} {complaint.actual} {complaint.expected}".encode()
    if all(complaint.cause == "schema" for complaint in parsed.complaints):
        schema = schemas().get(schema_name(str(document.get("kind"))))
        assert schema is None or not Draft202012Validator(schema).is_valid(document)


@dataclass(frozen=True)
class Inner:
    """An inner one."""

    count: Annotated[int, Hint(text="How many.", minimum=1, maximum=9)] = 3


@dataclass(frozen=True)
class Outer:
    """An outer one.

    With more to say.
    """

    name: Annotated[str, Hint(min_length=2, pattern="^[a-z]+$")]
    inner: Annotated[Inner, Hint(text="One of them.")]
    kind: Literal["a", "b"] = "a"
    pair: tuple[float, float] | None = None
    many: tuple[Inner, ...] = ()
    words: tuple[str, ...] | None = None
    either: float | Literal["zeros"] | tuple[float, ...] | None = None


def test_a_schema_is_made_from_types_and_hints():
    assert schema_of(Outer, title="Test") == {
        "$schema": SCHEMA_DIALECT,
        "title": "Test",
        "type": "object",
        "description": "An outer one.",
        "properties": {
            "name": {"type": "string", "minLength": 2, "pattern": "^[a-z]+$"},
            "inner": {"$ref": "#/$defs/Inner", "description": "One of them."},
            "kind": {"enum": ["a", "b"], "default": "a"},
            "pair": {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2},
            "many": {"type": "array", "items": {"$ref": "#/$defs/Inner"}, "default": []},
            "words": {"type": "array", "items": {"type": "string"}},
            "either": {
                "anyOf": [
                    {"type": "number"},
                    {"enum": ["zeros"]},
                    {"type": "array", "items": {"type": "number"}},
                ]
            },
        },
        "patternProperties": {"^x-": True},
        "additionalProperties": False,
        "required": ["name", "inner"],
        "$defs": {
            "Inner": {
                "type": "object",
                "description": "An inner one.",
                "properties": {
                    "count": {
                        "type": "integer",
                        "description": "How many.",
                        "minimum": 1,
                        "maximum": 9,
                        "default": 3,
                    }
                },
                "patternProperties": {"^x-": True},
                "additionalProperties": False,
                "required": [],
            }
        },
    }


@pytest.mark.parametrize("union_value", [None, 2.5, "zeros", (), (1.0, 2.0)])
def test_a_union_is_read_by_the_form_of_its_value(union_value):
    outer = Outer("ab", Inner(), either=union_value)
    assert from_json(Outer, json.loads(json.dumps(to_json(outer)))) == outer


def test_absent_fields_are_not_written_but_empty_ones_that_mean_something_are():
    assert to_json(Outer("ab", Inner(), many=(), words=())) == {
        "name": "ab",
        "inner": {"count": 3},
        "kind": "a",
        "words": [],
    }


def test_numbers_take_the_type_of_their_field():
    document = {"name": "ab", "inner": {"count": 4.0, "x-note": []}, "pair": [1, 2]}
    result = from_json(Outer, document)
    assert (result.inner.count, result.pair) == (4, (1.0, 2.0))
    assert isinstance(result.inner.count, int)
    assert isinstance(result.pair[0], float)
