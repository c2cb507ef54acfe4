import copy
import json
from importlib import resources

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from gsgen.contract.spec.manifest_io import _complaint_from_fault
from gsgen.contract.spec.schema_check import schema_faults

FOLDER = resources.files("gsgen.contract").joinpath("schemas")
SCHEMAS = {
    file.name: json.loads(file.read_text("utf-8"))
    for file in FOLDER.iterdir()
    if file.name.startswith(("gaussian", "post", "trajectory"))
}
DOCUMENT = {
    "contract": "1.0",
    "kind": "gaussian-generator",
    "name": "a",
    "inputs": [{"name": "t", "role": "time", "range": [0, 1], "default": [0.5], "frames": 3.0}],
    "outputs": {
        "gaussians": {"name": "g", "capacity": 5},
        "appearance": {"name": "c", "space": "sh", "degree": 0},
        "count": {"name": "n"},
    },
    "bounds": {"min": [0, 0, 0], "max": [1, 1, 1]},
    "depends_on": {"time": True},
    "x-own": {"any": [None]},
}
VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 70000),
    st.floats(-4, 4),
    st.sampled_from(["", "zeros", "identity", "sh", "float16", "1.0", "a" * 64, "-y"]),
    st.lists(st.one_of(st.integers(-1, 4), st.floats(-1, 1), st.just("x")), max_size=4),
    st.dictionaries(st.sampled_from(["x-a", "name", "odd"]), st.integers(0, 2), max_size=2),
)


def places(document, path=()):
    yield path
    members = document.items() if isinstance(document, dict) else ()
    members = enumerate(document) if isinstance(document, list) else members
    for key, value in list(members):
        yield from places(value, (*path, key))


def described(faults):
    """Return faults as manifests report them; of a required name the message differs in words."""
    return sorted(str(_complaint_from_fault(fault)) for fault in faults)


@given(data=st.data(), name=st.sampled_from(sorted(SCHEMAS)))
@settings(max_examples=400, deadline=None)
def test_quick_acceptance_agrees_with_the_library(data, name):
    document = copy.deepcopy(DOCUMENT)
    for _ in range(data.draw(st.integers(0, 2))):
        *path, last = data.draw(st.sampled_from([p for p in places(document) if p]))
        target = document
        for key in path:
            target = target[key]
        if isinstance(target, dict) and data.draw(st.booleans()):
            key = data.draw(
                st.sampled_from(["x-1", "label", "fps", "degree", "name", "shape", last])
            )
            target[key] = data.draw(VALUES)
        elif isinstance(target, dict) and data.draw(st.booleans()):
            del target[last]
        else:
            target[last] = data.draw(VALUES)
    schema = SCHEMAS[name]
    errors = list(Draft202012Validator(schema).iter_errors(document))
    assert described(schema_faults(document, schema)) == described(errors)


@pytest.mark.parametrize("keyword", ["not", "if", "contains", "uniqueItems"])
def test_unknown_keyword_is_a_fault(keyword):
    assert list(schema_faults([], {keyword: True}))


def test_true_is_not_one():
    assert list(schema_faults(True, {"enum": [1]}))
    assert list(schema_faults(True, {"type": "integer"}))
    assert not list(schema_faults(3.0, {"type": "integer"}))
