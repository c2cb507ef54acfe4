"""Test inputs can be planned for any number that a manifest may declare, in bounded memory."""

import json
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.conformance.fixtures.corpus import Fixture, fixtures
from gsgen.contract.model.inspected_model import inspect_model
from gsgen.contract.model.model_file import open_model
from gsgen.contract.probing.probe_plan import make_plan
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.manifest_io import dumps, parse
from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.targets import load_target

_EXTREMES = (0, 10**9, 1e30)
_MAX_PLAN_BYTES = 400e6
_MAX_PROBES = 5000


def _documents() -> Iterator[tuple[Fixture, dict[str, Any]]]:
    """Yield right models until each role of each kind has one."""
    seen: set[tuple[str, str]] = set()
    for fixture in fixtures():
        manifest = fixture.draw().manifest if not fixture.rule else None
        if not manifest:
            continue
        document = json.loads(manifest if isinstance(manifest, str) else dumps(manifest))
        roles = {(document["kind"], entry["role"]) for entry in document["inputs"]}
        if not roles <= seen:
            seen |= roles
            yield fixture, document


def _numbers(value: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Yield the path of each number of a document; of lists, the first two."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        yield path
    elif isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value[:2])
        for key, item in items:
            yield from _numbers(item, (*path, key))


def _with_number(document: dict[str, Any], path: tuple[str | int, ...], number: float) -> str:
    copied: Any = json.loads(json.dumps(document))
    parent = copied
    for key in path[:-1]:
        parent = parent[key]
    parent[path[-1]] = number
    return json.dumps(copied)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("fixture", "document"), [pytest.param(*pair, id=pair[0].name) for pair in _documents()]
)
def test_any_declared_number_is_planned_for_within_bounds(
    fixture: Fixture, document: dict[str, Any], tmp_path: Path
) -> None:
    path = tmp_path / "model.onnx"
    fixture.draw().write(path)
    subject = inspect_model(open_model(path), load_target("core"), Limits())
    tracemalloc.start()
    for field in _numbers(document):
        for number in _EXTREMES:
            parsed = parse(_with_number(document, field, number))
            if parsed.manifest is None:
                continue  # refused by the schema: nothing is run
            plan = make_plan(replace(subject, parsed=parsed), Level.BEHAVIOUR)
            assert len(plan.probes) <= _MAX_PROBES, (field, number)
            for probe in plan.probes:
                for name, array in probe.inputs.items():
                    assert np.isfinite(array).all(), (field, number, probe.label, name)
    assert tracemalloc.get_traced_memory()[1] < _MAX_PLAN_BYTES
    tracemalloc.stop()
