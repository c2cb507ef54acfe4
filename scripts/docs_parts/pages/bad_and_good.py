"""Bad and good code of a rule: the lines in which its example differs from a right one."""

import difflib
import json
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from typing import Any, Final

import numpy as np
import onnx

from gsgen.conformance.fixtures import Fixture, example_model_of_rule, find, fixtures
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.runtime.scene_checks.fixtures import scene_fixtures
from gsgen.tiles.validation.fixtures import tiles_fixtures

_MAX_LINES: Final = 14  # of a page's code
_MAX_GOOD: Final = 6  # good lines where the bad ones name other things
_MAX_ROWS: Final = 64  # of a weight that is written row by row
_WIDTH: Final = 88


def _flat(value: object, path: str = "") -> Iterator[str]:
    """Yield a line for each number or word of a JSON document."""
    if isinstance(value, dict) and value:
        for key, inner in value.items():
            yield from _flat(inner, f"{path}.{key}" if path else key)
    elif isinstance(value, list) and any(isinstance(inner, (dict, list)) for inner in value):
        for number, inner in enumerate(value):
            yield from _flat(inner, f"{path}[{number}]")
    else:
        rounded = [
            float(f"{part:.5g}") if isinstance(part, float) else part for part in _listed(value)
        ]
        text = json.dumps(rounded if isinstance(value, list) else rounded[0], ensure_ascii=False)
        yield f"{path}: {text}"


def _listed(value: object) -> list[object]:
    return value if isinstance(value, list) else [value]


def _weight_lines(name: str, array: np.ndarray) -> Iterator[str]:
    """Yield the dtype, shape and numbers of a weight, a line for each row."""
    head = f"{name}: {array.dtype}{list(array.shape)}"
    if array.ndim < 2:
        numbers = " ".join(f"{value:.3g}" for value in array.reshape(-1)[:_MAX_ROWS].tolist())
        yield f"{head} = {numbers}"
        return
    yield head
    if len(array) <= _MAX_ROWS:
        for number, row in enumerate(array.reshape(len(array), -1)):
            yield f"{name}[{number}] = {' '.join(f'{value:.3g}' for value in row.tolist())}"


def _model_lines(spec: ModelSpec) -> list[str]:
    """Return a model as lines: versions, inputs, outputs, nodes, weights, manifest, files."""
    model = spec.build()
    lines = [f"ir_version {model.ir_version}"]
    lines += [f'opset "{entry.domain}" {entry.version}' for entry in model.opset_import]
    graph = model.graph
    shell = onnx.GraphProto()
    shell.CopyFrom(graph)
    shell.ClearField("initializer")
    head, *nodes = onnx.printer.to_text(shell).splitlines()
    head = re.sub(r"\) => \(", ", => ", head.partition(" (")[2])
    lines += [part.strip(" ){") for part in head.split(", ")]
    lines += [" ".join(node.split()) for node in nodes]
    for function in model.functions:
        lines += onnx.printer.to_text(function).splitlines()
    for tensor in graph.initializer:
        if tensor.data_location == onnx.TensorProto.EXTERNAL:
            place = {entry.key: entry.value for entry in tensor.external_data}
            lines.append(f"{tensor.name}: {list(tensor.dims)} in {json.dumps(place)}")
        else:
            lines += _weight_lines(tensor.name, onnx.numpy_helper.to_array(tensor))
    for entry in model.metadata_props:
        try:
            lines += _flat(json.loads(entry.value), "manifest")
        except ValueError:
            lines.append(f"manifest = {entry.value!r}")
        lines.append(f"metadata key {entry.key}")
    lines += [f"file {name}" for name in (*spec.extra_files, *spec.zero_files)]
    lines += [f"link {name} to {target}" for name, target in spec.links.items()]
    return [line for line in lines if line.strip(" {}")]


def _tileset_lines(sketch: Any) -> list[str]:
    """Return a tileset as lines: its index, the JSON of its contents, the sizes of its files."""
    lines = list(_flat(sketch.document))
    for name, data in sketch.files.items():
        lines.append(f"file {name}, {len(data):,} bytes")
        if name.endswith(".glb"):
            with_json = data[20 : 20 + int.from_bytes(data[12:16], "little")]
            try:
                lines += _flat(json.loads(with_json), name)
            except ValueError:
                lines.append(f"{name}: no JSON")
    return lines


@cache
def _lines(fixture: Fixture) -> tuple[str, ...]:
    drawn: object = fixture.draw()
    return tuple(_model_lines(drawn) if isinstance(drawn, ModelSpec) else _tileset_lines(drawn))


@cache
def _right_models() -> tuple[tuple[str, ...], ...]:
    files = (*tiles_fixtures(), *scene_fixtures())
    return tuple(_lines(fixture) for fixture in (*fixtures(), *files) if not fixture.rule)


@cache
def _right_lines() -> frozenset[str]:
    return frozenset(line for lines in _right_models() for line in lines)


def _key(line: str) -> str:
    """Return what a line is about: a field, a tensor."""
    return re.split(r": | = ", line)[0].split()[-1]


def _telling(changes: list[str]) -> list[str]:
    """Return the bad lines that no right model has, and the good ones about the same things."""
    bad = [line for line in changes if line[0] == "-" and line[1:] not in _right_lines()]
    good = [line for line in changes if line[0] == "+"]
    if not bad:
        return changes
    keys = {_key(line[1:]) for line in bad}
    same = [line for line in good if _key(line[1:]) in keys]
    kept = {*bad, *(same or good[:_MAX_GOOD])}
    return [line for line in changes if line in kept]


def _shown(changes: list[str]) -> list[str]:
    """Return the first of many changed lines, and two rows of each weight on each side."""
    rows: Counter[str] = Counter()
    shown = []
    for line in changes:
        name, bracket, _ = line.partition(" = ")[0].partition("[")
        rows[name] += 1
        if not bracket or " = " not in line or rows[name] <= 2:
            text = f"{line[0]} {line[1:]}"
            shown.append(text if len(text) <= _WIDTH else f"{text[: _WIDTH - 1]}…")
    return shown if len(shown) <= _MAX_LINES else [*shown[: _MAX_LINES - 1], "…"]


def section(rule_id: str) -> str:
    """Return the part of a rule's page with its example; empty for a rule without one."""
    name = example_model_of_rule(rule_id)
    if not name:
        return ""
    bad = _lines(find(name))
    words = set(bad)
    good = min(_right_models(), key=lambda lines: len(words.symmetric_difference(lines)))
    difference = list(difflib.unified_diff(bad, good, n=0, lineterm=""))[2:]
    changes = [line for line in difference if not line.startswith("@@")]
    summary = find(name).summary
    text = f"\n## Bad and good\n\n[Example](../guides/example-models.md) `{name}`: {summary}\n"
    code = "\n".join(_shown(_telling(changes)))
    return f"{text}\n```diff\n{code}\n```\n" if code else text
