"""Manifests of 1.0 and 1.1 keep all they say when they are lifted to the current version."""

import json
from functools import cache
from importlib import resources

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from gsgen.contract.spec.fields.json_schema import to_json
from gsgen.contract.spec.manifest_io import loads, schema_name
from gsgen.contract.spec.upgrades import CURRENT, upgrade

KINDS = ("gaussian-generator", "post-process", "trajectory-predictor")
VERSIONS = ((1, 0), (1, 1))


@cache
def schema(kind, version):
    file = resources.files("gsgen.contract").joinpath("schemas", schema_name(kind, version))
    return json.loads(file.read_text("utf-8"))


def instances(entry, definitions):
    """Documents of an old schema, drawn from the published file itself."""
    if "$ref" in entry:
        return instances(definitions[entry["$ref"].removeprefix("#/$defs/")], definitions)
    if "anyOf" in entry:
        return st.one_of([instances(option, definitions) for option in entry["anyOf"]])
    if "enum" in entry:
        return st.sampled_from(entry["enum"])
    if "pattern" in entry:
        return st.from_regex(entry["pattern"], fullmatch=True)
    kind = entry["type"]
    if kind == "array":
        low, high = entry.get("minItems", 0), entry.get("maxItems", 3)
        return st.lists(instances(entry["items"], definitions), min_size=low, max_size=high)
    if kind == "object" and "properties" not in entry:
        values = instances(entry["additionalProperties"], definitions)
        return st.dictionaries(st.sampled_from(["time", "view", "pose"]), values, max_size=2)
    if kind == "object":
        return objects(entry, definitions)
    if kind == "string":
        return st.text(min_size=entry.get("minLength", 0), max_size=6)
    if kind == "boolean":
        return st.booleans()
    low = entry.get("minimum", entry.get("exclusiveMinimum"))
    if kind == "integer":
        return st.integers(low, entry.get("maximum", 1 << 20))
    above = "exclusiveMinimum" in entry
    return st.floats(low, 1e6, allow_nan=False, exclude_min=above, allow_infinity=False)


def objects(entry, definitions):
    members = {name: instances(value, definitions) for name, value in entry["properties"].items()}
    required = {name: members.pop(name) for name in entry["required"] if name in members}
    members["x-studio"] = st.dictionaries(st.just("take"), st.integers(), max_size=1)
    return st.fixed_dictionaries(required, optional=members)


@cache  # hypothesis looks through a new strategy for as long as it draws from it
def documents(kind, version):
    body = schema(kind, version)
    return instances(body, body["$defs"])


@st.composite
def old_manifests(draw):
    version, kind = draw(st.sampled_from(VERSIONS)), draw(st.sampled_from(KINDS))
    document = draw(documents(kind, version))
    return version, document | {"contract": f"1.{version[1]}", "kind": kind}


@settings(max_examples=300, deadline=None)
@given(old_manifests())
def test_every_field_of_an_old_manifest_is_kept(drawn):
    version, document = drawn
    assert not list(Draft202012Validator(schema(document["kind"], version)).iter_errors(document))
    lifted = upgrade(document, version)
    expected = document | {"contract": f"{CURRENT[0]}.{CURRENT[1]}"}
    if version == (1, 0) and document.get("blend") == "wsr":
        expected["blend"] = "alpha"  # the one change that the page of versions states
    assert lifted == expected
    current = Draft202012Validator(schema(document["kind"], CURRENT))
    assert not list(current.iter_errors(lifted))


@settings(max_examples=300, deadline=None)
@given(old_manifests())
def test_what_is_read_from_an_old_manifest_is_all_it_says(drawn):
    version, document = drawn
    lifted = upgrade(document, version)
    written = to_json(loads(json.dumps(document)))
    assert is_said(lifted, written), (lifted, written)


def is_said(document, written):
    """Whether ``written`` repeats every field of ``document`` but extensions and empty lists."""
    if isinstance(document, dict):
        own = {k: v for k, v in document.items() if not k.startswith("x-")}
        return all(
            value in ([], {}) or is_said(value, written.get(key)) for key, value in own.items()
        )
    if isinstance(document, list):
        return len(document) == len(written) and all(map(is_said, document, written))
    return document == written


@pytest.mark.parametrize("kind", KINDS)
def test_the_current_schema_has_every_field_of_the_older_ones(kind):
    for version in VERSIONS:
        old, new = schema(kind, version), schema(kind, CURRENT)
        assert old["properties"].keys() <= new["properties"].keys()
        for name, entry in old["$defs"].items():
            assert entry.get("properties", {}).keys() <= new["$defs"][name]["properties"].keys()
            assert set(new["$defs"][name]["required"]) <= set(entry["required"])
