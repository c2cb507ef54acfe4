"""A manifest whose fields hold any other JSON value is judged, and crashes no rule."""

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.spec.manifest_io import dumps
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate

MODELS = (
    "fully_declared", "drift_in_seconds", "weighted_sum", "avatar_with_skeleton", "talks_by_mel",
    "pictures_with_cameras", "declares_its_needs", "post_process", "trajectory",
)  # fmt: skip
VALUES = (
    None,
    True,
    -1,
    0,
    1.5,
    10**30,
    "",
    "x",
    [],
    [1],
    [1, 2, 3],
    ["x"],
    [[0]],
    {},
    {"name": "x"},
)


def _places(part: Any, *keys: str | int) -> Iterator[tuple[str | int, ...]]:
    """Yield the path of each value within a manifest."""
    items = (
        part.items()
        if isinstance(part, dict)
        else enumerate(part)
        if isinstance(part, list)
        else ()
    )
    for key, value in items:
        yield (*keys, key)
        yield from _places(value, *keys, key)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("broken")


def _document(model: ModelSpec) -> dict[str, Any]:
    manifest = model.manifest
    assert manifest is not None
    return dict(json.loads(manifest if isinstance(manifest, str) else dumps(manifest)))


def _broken(name: str, place: tuple[str | int, ...], value: object) -> ModelSpec:
    """Return a model whose manifest has another value at a place."""
    model = find(name).draw()
    part: Any = (document := _document(model))
    for key in place[:-1]:
        part = part[key]
    part[place[-1]] = value
    return replace(model, manifest=json.dumps(document))


@cache
def _cases() -> list[tuple[str, tuple[str | int, ...], object]]:
    """All models, places and values."""
    return [
        (name, place, value)
        for name in MODELS
        for place in _places(_document(find(name).draw()))
        for value in VALUES
    ]


@given(st.sampled_from(_cases()))
@settings(max_examples=100)
def test_any_value_at_any_place_is_judged(
    folder: Path, case: tuple[str, tuple[str | int, ...], object]
) -> None:
    path = folder / "broken.onnx"
    _broken(*case).write(path)
    report = validate(path, Settings(level=Level.STATIC))
    assert report.verdict != "internal-error", (case, report)
