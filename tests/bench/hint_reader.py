"""A mechanical reader of hints: it does to a model what the words of a finding say, and no more.

It runs the commands that a hint quotes, sets and removes the manifest fields whose paths it names,
and adds the torch lines that it gives. For other words, each entry of :data:`MENDS` is a pattern
and the edit that it asks for. Findings whose words match no pattern are not read.
"""

import difflib
import hashlib
import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnx.parser
from torch_lines import add_line

from gsgen.contract.model.model_file import MANIFEST_KEY, NEUTRAL_KEY
from gsgen.contract.validation.finding import Finding

DTYPES = {"float32": 1, "float16": 10, "int32": 6}


class NotRead(Exception):
    """Raised if a reader does not know what the words ask for."""


@dataclass(slots=True)
class Draft:
    """A model that is edited, its manifest, and the finding that is read.

    Attributes:
        model: The model.
        manifest: Its manifest; empty if it does not parse.
        finding: The finding.
        folder: Where the files beside the model lie.
    """

    model: onnx.ModelProto
    manifest: Any
    finding: Finding
    folder: Path

    @property
    def named(self) -> str:
        """The last word of the finding's location, such as the name of a tensor."""
        return self.finding.where.subject.split(" ")[-1].strip("'")

    def entry(self) -> dict[str, Any]:
        """Return the manifest's entry of the input that the finding names."""
        [entry] = [e for e in self.manifest["inputs"] if e["name"] == self.named]
        return dict_of(entry)

    def append(self, nodes: str, *, output: str = "", **weights: np.ndarray) -> None:
        """Put nodes of ONNX text behind an output, which they read as ``old`` and give as ``new``."""
        name = output or self.named
        if any(value.name == name for value in self.model.graph.input):
            raise NotRead(f"{name} is an input, too")
        if self.tensor(name).elem_type == DTYPES["float16"]:
            weights = {
                key: array.astype(np.float16) if array.dtype == np.float32 else array
                for key, array in weights.items()
            }
        self.append_nodes([onnx.parser.parse_node(text) for text in nodes.split("; ")], name)
        self.add_weights(weights)

    def append_nodes(self, nodes: list[onnx.NodeProto], name: str) -> None:
        """Put nodes behind an output, which they read as ``old`` and give as ``new``."""
        for weight in self.model.graph.initializer:
            weight.name = f"{name}.old" if weight.name == name else weight.name
        for node in self.model.graph.node:
            for names in (node.output, node.input):
                names[:] = [f"{n}.old" if n == name else n for n in names]
        for node in nodes:
            for names in (node.output, node.input):
                names[:] = [{"old": f"{name}.old", "new": name}.get(n, n) for n in names]
            self.model.graph.node.append(node)

    def prepend(self, node_text: str, **weights: np.ndarray) -> None:
        """Put a node of ONNX text between an input and those that read it."""
        name = self.named
        for node in self.model.graph.node:
            node.input[:] = [f"{name}.inner" if n == name else n for n in node.input]
        node = onnx.parser.parse_node(node_text)
        node.input[:] = [name if n == "old" else n for n in node.input]
        node.output[:] = [f"{name}.inner"]
        self.model.graph.node.insert(0, node)
        self.add_weights(weights)

    def add_weights(self, weights: dict[str, np.ndarray]) -> None:
        """Store weights."""
        for name, array in weights.items():
            self.model.graph.initializer.append(onnx.numpy_helper.from_array(array, name))

    def tensor(self, name: str = "") -> onnx.TypeProto.Tensor:
        """Return the type of the input or output that the finding names."""
        graph, name = self.model.graph, name or self.named
        for value in (*graph.input, *graph.output):
            if value.name == name:
                return value.type.tensor_type
        raise NotRead(f"{name} is no input or output")

    def set_shape(self, *sizes: int, name: str = "") -> list[int]:
        """Give an input or output other sizes, and return those it had."""
        dims = self.tensor(name).shape.dim
        old_sizes = [dim.dim_value or -1 for dim in dims]
        del dims[:]
        for size in sizes:
            dims.add().dim_value = size
        return old_sizes

    def outputs(self) -> dict[str, np.ndarray]:
        """Run the model without inputs."""
        import onnxruntime

        session = onnxruntime.InferenceSession(self.model.SerializeToString())
        names = [output.name for output in session.get_outputs()]
        return dict(zip(names, session.run(None, {}), strict=True))


def dict_of(value: Any) -> dict[str, Any]:
    """Return a value that is an object of JSON."""
    assert isinstance(value, dict)
    return value


def parent_of(draft: Draft, path: str) -> tuple[Any, Any]:
    """Return the part of a manifest that holds a path's last key, and the key."""
    part: Any = draft.manifest
    *keys, last = [int(key) if key.isdigit() else key for key in path.split(".")]
    for key in keys:
        part = part.setdefault(key, {}) if isinstance(part, dict) else part[key]
    return part, last


Edit = Callable[[Draft, re.Match[str]], object]


def choose_word(draft: Draft, match: re.Match[str]) -> bool:
    """Write the nearest of the allowed words; the only one if there is one."""
    part, key = parent_of(draft, match["path"])
    words = match["words"].split(", ")
    near = difflib.get_close_matches(str(part[key]), words, 1, 0.3 if len(words) < 5 else 0.6)
    if not near and len(words) > 1:
        return False  # a reader does not guess
    part[key] = near[0] if near else words[0]
    return True


def name_tensor(draft: Draft, match: re.Match[str]) -> None:
    """Write the name of the graph that is nearest, or that no other role has."""
    text = json.dumps(draft.manifest)
    names = match["words"].split(", ")
    free = [name for name in names if json.dumps(name) not in text]
    near = difflib.get_close_matches(draft.named.lower(), names, 1, 0.6)
    if not (near or free):
        raise NotRead("every name has a role")
    new_name = near[0] if near else free[0]
    draft.manifest = json.loads(text.replace(json.dumps(draft.named), json.dumps(new_name), 1))


def declare_graph(draft: Draft, match: re.Match[str]) -> None:
    """Declare what the graph has."""
    has, outputs = match["has"], draft.manifest["outputs"]
    roles = [v for v in outputs.values() if isinstance(v, dict) and v.get("name") == draft.named]
    entry = (
        roles[0]
        if roles
        else draft.entry() and next(e for e in draft.manifest["inputs"] if e["name"] == draft.named)
    )
    if has in DTYPES:
        entry["dtype"] = has
    elif has.endswith(" rows"):
        entry["capacity"] = int(has.split()[0])
    elif has.endswith(" channels"):
        entry["degree"] = round((int(has.split()[0]) / 3) ** 0.5) - 1
    else:
        entry["shape"] = json.loads(has)


def measure_bounds(draft: Draft, _: object) -> None:
    position = draft.outputs()["gaussians"][:, :3].astype(float)
    draft.manifest["bounds"] = {"min": position.min(0).tolist(), "max": position.max(0).tolist()}


def declare_field(draft: Draft, match: re.Match[str]) -> None:
    """Write the JSON value that follows a field's name into the entry of the named input."""
    value, _ = json.JSONDecoder().raw_decode(match.string, match.end())
    draft.entry()[match["field"]] = value


def set_input(**fields: Any) -> Edit:
    """Return an edit that writes fields of the named input; None removes a field."""

    def edit(draft: Draft, _: object) -> None:
        entry = next(e for e in draft.manifest["inputs"] if e["name"] == draft.named)
        for name, value in fields.items():
            entry.pop(name, None) if value is None else entry.update({name: value})

    return edit


def set_field(path: str, value: Any) -> Edit:
    """Return an edit that writes a field of the manifest; None removes it."""

    def edit(draft: Draft, _: object) -> None:
        part, key = parent_of(draft, path)
        part.pop(key, None) if value is None else part.update({key: value})

    return edit


def default_within(draft: Draft, _: object) -> None:
    entry = next(e for e in draft.manifest["inputs"] if e["name"] == draft.named)
    low = entry.get("range", [0.0, 1.0])[0]
    entry["default"] = low


def reshape_input(draft: Draft, match: re.Match[str]) -> None:
    sizes = [int(size) for size in match["sizes"].split(", ")]
    old_sizes = draft.set_shape(*sizes)
    if min(old_sizes, default=1) > 0 and np.prod(old_sizes) != np.prod(sizes):
        raise NotRead("no reshape gives so many numbers")
    shape = np.array([size if size > 0 else -1 for size in old_sizes], np.int64)
    draft.prepend("inner = Reshape (old, mend_shape)", mend_shape=shape)


def cast_input(draft: Draft, match: re.Match[str]) -> None:
    tensor = draft.tensor()
    old_type, tensor.elem_type = tensor.elem_type, DTYPES[match["dtype"]]
    draft.prepend(f"inner = Cast <to = {old_type}> (old)")


def reshape_output(draft: Draft, match: re.Match[str]) -> None:
    columns = 10 if match["sizes"] == "N, 10" else -1
    sizes = draft.set_shape()
    count = int(np.prod(sizes)) // 10 if columns == 10 else sizes[0]
    columns = columns if columns == 10 else int(np.prod(sizes)) // count
    draft.set_shape(count, columns)
    draft.append("new = Reshape (old, mend_shape)", mend_shape=np.array([count, columns]))


def cast_output(dtype: str) -> Edit:
    def edit(draft: Draft, _: object) -> None:
        draft.tensor().elem_type = DTYPES[dtype]
        draft.append(f"new = Cast <to = {DTYPES[dtype]}> (old)")
        for entry in draft.manifest["outputs"].values():
            if isinstance(entry, dict) and entry.get("name") == draft.named and "dtype" in entry:
                entry["dtype"] = dtype

    return edit


def divide_bytes(draft: Draft, _: object) -> None:
    draft.tensor().elem_type = DTYPES["float32"]
    draft.append("real = Cast <to = 1> (old); new = Div (real, mend_byte)", mend_byte=BYTE)


def cast_count(draft: Draft, _: object) -> None:
    sizes = draft.set_shape(1)
    draft.tensor().elem_type = DTYPES["int32"]
    first = "old" if sizes != [2] else "first"
    nodes = "first = Gather <axis = 0> (old, mend_first); " if sizes == [2] else ""
    draft.append(
        f"{nodes}whole = Cast <to = 6> ({first}); flat = Reshape (whole, mend_shape); "
        "new = Add (flat, mend_zero)",
        mend_first=np.array([0]),
        mend_shape=np.array([1]),
        mend_zero=np.zeros(1, np.int32),
    )


def multiply_by_one(draft: Draft, _: object) -> None:
    kind = draft.tensor().elem_type
    dtype = onnx.helper.tensor_dtype_to_np_dtype(kind)  # noqa: TID251
    draft.append("new = Mul (old, mend_one)", mend_one=np.ones(1, dtype))


def reorder_columns(draft: Draft, match: re.Match[str]) -> None:
    columns = np.array(json.loads(match["columns"]), np.int64)
    draft.append("new = Gather <axis = 1> (old, mend_columns)", mend_columns=columns)


def on_opacity(nodes: str, **weights: np.ndarray) -> Edit:
    """Return an edit that computes column 3 anew, ``alpha`` from ``raw``."""

    def edit(draft: Draft, _: object) -> None:
        name = draft.finding.where.subject.split(" ")[-1]
        draft.append(
            "before, raw, after = Split <axis = 1> (old, mend_parts); "
            f"{nodes}; new = Concat <axis = 1> (before, alpha, after)",
            output=name,
            mend_parts=np.array([3, 1, 6]),
            **weights,
        )

    return edit


def on_colour(nodes: str, **weights: np.ndarray) -> Edit:
    def edit(draft: Draft, _: object) -> None:
        draft.append(nodes, output=draft.finding.where.subject.split(" ")[-1], **weights)

    return edit


def embed_once(draft: Draft, _: object) -> None:
    entries = [e for e in draft.model.metadata_props if e.key in (MANIFEST_KEY, NEUTRAL_KEY)]
    for entry in entries[1:]:
        draft.model.metadata_props.remove(entry)


def embed_found(draft: Draft, _: object) -> None:
    sources = (*draft.model.metadata_props, *draft.model.graph.metadata_props)
    text = next(e.value for e in sources if e.value.lstrip().startswith("{"))
    draft.manifest = json.loads(text)


def drop_fields(draft: Draft, match: re.Match[str]) -> None:
    part = draft.manifest
    for key in filter(None, match["path"].split(".")):
        part = part[int(key) if key.isdigit() else key]
    for name in re.findall(r"'([^']+)'", match["names"]):
        part.pop(name)


def digest_again(draft: Draft, _: object) -> None:
    for entry in draft.manifest["external_data"]:
        content = (draft.folder / entry["path"]).read_bytes()
        entry["sha256"] = hashlib.sha256(content).hexdigest()


def drop_role(draft: Draft, _: object) -> None:
    draft.manifest["depends_on"].pop(draft.named)


def drop_output(draft: Draft, _: object) -> None:
    outputs = draft.model.graph.output
    outputs.remove([value for value in outputs if value.name == draft.named][-1])


def drop_weight_inputs(draft: Draft, _: object) -> None:
    weights = {weight.name for weight in draft.model.graph.initializer}
    for value in [v for v in draft.model.graph.input if v.name in weights]:
        draft.model.graph.input.remove(value)


def drop_extension(draft: Draft, match: re.Match[str]) -> None:
    for field in ("extensions_used", "extensions_required"):
        names = draft.manifest.get(field, [])
        draft.manifest[field] = [name for name in names if name not in match["name"]]


def leave_training(draft: Draft, _: object) -> None:
    for node in draft.model.graph.node:
        for attribute in node.attribute:
            if attribute.name == "training_mode":
                attribute.i = 0
        if node.op_type == "Dropout":
            del node.input[1:]
        if node.op_type == "BatchNormalization":
            del node.output[1:]


def drop_value_keys(draft: Draft, _: object) -> None:
    graph = draft.model.graph
    for value in (*graph.input, *graph.output, *graph.value_info, *graph.initializer):
        del value.metadata_props[:]


def pad_colours(draft: Draft, match: re.Match[str]) -> None:
    channels = int(match["channels"])
    appearance = draft.manifest["outputs"]["appearance"]
    is_rgb = appearance["space"] == "rgb"
    size = {3: 4 if is_rgb else 12, 27: 48}[channels]
    rows = draft.set_shape()[0]
    draft.set_shape(rows, size)
    fill = np.full((rows, size - channels), is_rgb, np.float16)
    draft.append("new = Concat <axis = 1> (old, mend_fill)", mend_fill=fill)
    if not is_rgb:
        appearance["degree"] = {12: 1, 48: 3}[size]


def lower_corner_first(draft: Draft, _: object) -> None:
    bounds = draft.manifest["bounds"]
    corners = np.sort([bounds["min"], bounds["max"]], axis=0)
    bounds["min"], bounds["max"] = corners.tolist()


def degrees_to_radians(draft: Draft, _: object) -> None:
    entry = next(e for e in draft.manifest["inputs"] if e["name"] == draft.named)
    entry["range"] = [value / 180 * np.pi for value in entry["range"]]


def sort_range(draft: Draft, _: object) -> None:
    entry = next(e for e in draft.manifest["inputs"] if e["name"] == draft.named)
    entry["range"] = sorted(entry["range"])


def whole_range(draft: Draft, _: object) -> None:
    entry = next(e for e in draft.manifest["inputs"] if e["name"] == draft.named)
    entry["range"] = [float(int(value)) for value in entry["range"]]


def count_frames(draft: Draft, _: object) -> None:
    entry = next(e for e in draft.manifest["inputs"] if e["name"] == draft.named)
    entry["frames"] = int(entry["range"][1] - entry["range"][0]) + 1


def depends_on_nothing(draft: Draft, _: object) -> None:
    draft.manifest.setdefault("depends_on", {})[draft.named] = False


def infer_shapes_again(draft: Draft, _: object) -> None:
    del draft.model.graph.value_info[:]
    draft.model.CopyFrom(onnx.shape_inference.infer_shapes(draft.model))


def rename_tensor(draft: Draft, old_name: str, new_name: str) -> None:
    graph = draft.model.graph
    for node in graph.node:
        for names in (node.input, node.output):
            names[:] = [new_name if name == old_name else name for name in names]
    for value in (*graph.input, *graph.output, *graph.value_info):
        value.name = new_name if value.name == old_name else value.name
    for entry in draft.manifest["inputs"]:
        entry["name"] = new_name if entry["name"] == old_name else entry["name"]


def remove_input(draft: Draft, match: re.Match[str]) -> None:
    inputs = draft.model.graph.input
    inputs.remove(next(value for value in inputs if value.name == match["name"]))
    part, key = parent_of(draft, match["path"])
    part.pop(key)


def store_in_float32(draft: Draft, match: re.Match[str]) -> None:
    for weight in draft.model.graph.initializer:
        if weight.name == match["name"]:
            array = onnx.numpy_helper.to_array(weight).astype(np.float32)
            weight.CopyFrom(onnx.numpy_helper.from_array(array, weight.name))


def store_numbers(draft: Draft, _: object) -> None:
    """Store what the named node of random numbers might have drawn, as a weight."""
    graph = draft.model.graph
    inferred = onnx.shape_inference.infer_shapes(draft.model).graph
    values = {v.name: v for v in (*inferred.value_info, *inferred.input, *inferred.output)}
    for node in [node for node in graph.node if node.op_type.startswith("Random")]:
        shape = [dim.dim_value for dim in values[node.output[0]].type.tensor_type.shape.dim]
        given = {entry.name: entry.f for entry in node.attribute}
        random = np.random.default_rng(1)
        numbers = (
            random.normal(given.get("mean", 0), given.get("scale", 1), shape)
            if "Normal" in node.op_type
            else random.uniform(given.get("low", 0), given.get("high", 1), shape)
        )
        draft.add_weights({node.output[0]: numbers.astype(np.float32)})
        graph.node.remove(node)


def export_at_opset(draft: Draft, match: re.Match[str]) -> None:
    """Do as an export at another operator set does; operators of unknown sets stay as they are."""
    entry = next(opset for opset in draft.model.opset_import if opset.domain in ("", "ai.onnx"))
    version = int(match["version"])
    if entry.version < version:
        converted = onnx.version_converter.convert_version(draft.model, version)
        draft.model.CopyFrom(converted)
    entry = next(opset for opset in draft.model.opset_import if opset.domain in ("", "ai.onnx"))
    entry.version = version


def unique_names(draft: Draft, _: object) -> None:
    for index, node in enumerate(draft.model.graph.node):
        node.name = f"node_{index}"


SPACE = {"handedness": "right", "up": "+y", "unit": "metre", "matrix_order": "column"}
LICENSE = {"license": "Apache-2.0", "tool": "exporter 1.2"}
HALF, BYTE = np.float32([0.5]), np.float32([255])


SET, LINE = (
    re.compile(r"\bSet ([\w.-]+) to "),
    re.compile(r"`(?:\w+ = \w+\.clone\(\); )?(\w+(?:\[[^`]*?\])? = [^`]+)`"),
)
TAKE = re.compile(r"\bTake (\S+) as \[([^\]]*)\]\.")
RENAME = re.compile(r"\bRename '([^']+)' to '([^']+)', in the graph and in the manifest")
REMOVE = re.compile(r"\b[Rr]emove (\w+(?:\.[\w-]+)+|\w+(?=, or))[,.]")


def exact_steps(draft: Draft) -> bool:
    """Set the fields and add the lines that a hint gives, or else remove the field that it names."""
    hint, steps = draft.finding.hint, 0
    for name, sizes in TAKE.findall(hint):
        dims = draft.tensor(name).shape.dim
        del dims[:]
        for size in sizes.split(", "):
            dims.add(**{"dim_value": int(size)} if size.isdigit() else {"dim_param": size})
        steps += 1
    for old_name, new_name in RENAME.findall(hint):
        rename_tensor(draft, old_name, new_name)
        steps += 1
    for match in SET.finditer(hint):
        value, _ = json.JSONDecoder().raw_decode(hint, match.end())
        part, key = parent_of(draft, match[1])
        if isinstance(part, dict):
            part[key] = value
        else:
            part[key : key + 1] = [value]
        steps += 1
    for match in LINE.finditer(hint):
        subject = draft.finding.where.subject.removeprefix("output ")
        outputs = {value.name for value in draft.model.graph.output}
        declared = draft.manifest["outputs"]
        roles = {"rows": "gaussians", "color": "appearance", "count": "count", "cells": "cells"}
        roles = {word: declared[role]["name"] for word, role in roles.items() if role in declared}
        if subject in outputs:
            roles["rows"] = subject
        add_line(draft.model, match[1], roles)
        steps += 1
    if not steps and (removal := REMOVE.search(hint)):
        part, key = parent_of(draft, removal[1])
        if isinstance(part, list) or key in part:
            part.pop(key)
            steps += 1
    return steps > 0


# Words of location, message and hint, and the edit that they ask for; the first match counts.
MENDS: tuple[tuple[str, Edit], ...] = (
    (r'^(manifest )?input .*\| Declare "(?P<field>hop|range)": (?=[\[\d][^a-z]*[.,])', declare_field),
    (r"a manifest (under the key|in the metadata of the graph)", embed_found),
    (r"key '\S+' is repeated.*expected one manifest|Keep one of the two", embed_once),
    (r"key \S+ is repeated within an object", lambda *_: None),  # the reader has kept the last
    (r"^manifest ?(?P<path>\S*) \| (?P<names>'.*); expected only the fields", drop_fields),
    (r"^manifest (?P<path>\S+) \| .*; expected one of (?P<words>[^|]+) \|.*Correct the field", choose_word),
    (r'expected a version such as "1.0"|expected major version 1|set "contract": "1.0"', set_field("contract", "1.0")),
    (r"no such graph (?:output|input); expected one of (?P<words>[^|]+) \|", name_tensor),
    (r"no degree is declared; expected the degree of 3 SH", set_field("outputs.appearance.degree", 0)),
    (r"graph has (?P<has>[^;]+); .*(Take the values from the graph|declare the dtype)", declare_graph),
    (r'Add "space": \{', set_field("space", SPACE)),
    (r'Add "bounds"', measure_bounds),
    (r"expected min <= max.*lower corner first", lower_corner_first),
    (r"space rgb with degree.*else remove the degree", set_field("outputs.appearance.degree", None)),
    (r'Add "color_space": "srgb"', set_field("outputs.appearance.color_space", "srgb")),
    (r'Declare "range": \[first, last\] for time', set_input(range=[0.0, 1.0])),
    (r'expected "range": \[low, high\] \|', set_input(range=[0.0, 1.0])),
    (r"role control with frames", set_input(frames=None)),
    (r"fps 0;.*leave fps out", set_input(fps=None)),
    (r'Write "license": "Apache-2.0".*"tool": "name 1.2"', set_field("producer", LICENSE)),
    (r"key 'gsgen\..*under the model-level key", drop_value_keys),
    (r"(?P<name>\S+) is not in extensions_used.*Add the name", lambda d, m: d.manifest.setdefault("extensions_used", []).append(m["name"])),
    (r'\| (?P<name>[^;]+); expected a field.*Remove the name from "extensions_used"', drop_extension),
    (r'or remove "operator_profile"', set_field("operator_profile", None)),
    (r'Write "unit": "arbitrary"', set_field("space.unit", "arbitrary")),
    (r"sha256 .*write the digests again", digest_again),
    (r"expected \[(?P<sizes>4, 4|1)\] \| Take a ", reshape_input),
    (r"expected (?P<dtype>float32|int32).*cast inside the model", cast_input),
    (r'set "depends_on": \{input or role: false\}', depends_on_nothing),
    (r"Remove every weight from the graph's inputs", drop_weight_inputs),
    (r'expected low <= high \| Write "range"', sort_range),
    (r"expected whole numbers.*with whole numbers", whole_range),
    (r"Give one number for all elements", default_within),
    (r"convention.*or none\.?$", set_input(convention=None)),
    (r'Declare "default": a number, a list, "zeros"', set_input(default="zeros")),
    (r"Remove the entry, or write the name or the role", drop_role),
    (r"degrees by 180 and multiply by π", degrees_to_radians),
    (r"role control with joints", set_input(joints=None)),
    (r"role control with rate", set_input(rate=None)),
    (r"role time with the pass 'scene'|role image with the pass 'frame'", set_input(**{"pass": None})),
    (r'role image of a gaussian-generator \|', set_input(background=None)),
    (r'Declare "background": \[1, 1, 1\]', set_input(background=[1.0, 1.0, 1.0])),
    (r'Declare as many "frames" as the range has whole numbers', count_frames),
    (r"expected two axes, \[(?P<sizes>N, 10)\].*reshape flattened rows|\[(?P<other>N, 10)\].*Drop the batch axis", reshape_output),
    (r"(?P<sizes>)reshape the last two axes into one", reshape_output),
    (r"Divide the bytes by 255 in float32", divide_bytes),
    (r"End the output on a cast to float32", cast_output("float32")),
    (r"expected (float32), as gaussians.*Cast both", cast_output("float32")),
    (r"expected (float16), as gaussians.*Cast both", cast_output("float16")),
    (r"Cast the count to int32 and reshape it to \[1\]", cast_count),
    (r"End the output on (an operator, such as Mul by one|Cast, Concat, Mul by one)", multiply_by_one),
    (r"Remove the second entry|Remove the output from the graph", drop_output),
    (r"\| (?P<channels>3|27) channels of float16.*Pad float16 RGB", pad_colours),
    (r"blend: wsr.*or blend by alpha and declare neither", lambda d, _: (d.manifest.update(blend="alpha"), d.manifest.pop("weighted_sum", None), d.manifest["outputs"].pop("cells", None))),
    (r"without blend: wsr; .*Declare the tensor of cells", set_field("blend", "wsr")),
    (r"expected unique node names", unique_names),
    (r"\| Export at operator set (?P<version>\d+)", export_at_opset),
    (r"Run shape inference again", infer_shapes_again),
    (r"Call model\.eval\(\)", leave_training),
    (r"Store the weight (?P<name>\S+) in float32", store_in_float32),
    (r"expected stored numbers", store_numbers),
    (r"Remove input (?P<name>\S+) from the graph, and (?P<path>inputs\.\d+)", remove_input),
    (r'or declare "capture": \{"static_shapes": false\}', set_field("capture", {"static_shapes": False})),
    (r"Return `rows\[:, (?P<columns>\[[\d, ]+\])\]`", reorder_columns),
    (r"opacity \|.*\| Apply the sigmoid", on_opacity("alpha = Sigmoid (raw)")),
    (r"opacity \|.*\| Divide by 255", on_opacity("alpha = Div (raw, mend_byte)", mend_byte=BYTE)),
    (r"opacity \|.*\| Divide by 100", on_opacity("alpha = Div (raw, mend_cent)", mend_cent=np.float32([100]))),
    (r"opacity \|.*\| Use \(x \+ 1\) / 2", on_opacity("half = Mul (raw, mend_half); alpha = Add (half, mend_half)", mend_half=HALF)),
    (r"opacity \|.*\| Clamp them", on_opacity("alpha = Clip (raw, mend_low, mend_high)", mend_low=np.float32(0), mend_high=np.float32(1))),
    (r"rgb \|.*\| Divide by 255", on_colour("new = Div (old, mend_byte)", mend_byte=BYTE)),
    (r"rgb \|.*\| Clamp them", on_colour("new = Clip (old, mend_low, mend_high)", mend_low=np.float32(0), mend_high=np.float32(1))),
    (r"rgb \|.*\| Use \(x \+ 1\) / 2", on_colour("half = Mul (old, mend_half); new = Add (half, mend_half)", mend_half=HALF)),
    (r"rgb \|.*\| Use 0.5 \+ 0.28209479", on_colour("part = Mul (old, mend_sh); new = Add (part, mend_half)", mend_sh=np.float32([0.28209479]), mend_half=HALF)),
    (r"rgb \|.*\| Apply the sigmoid", on_colour("new = Sigmoid (old)")),
)  # fmt: skip


def run_commands(path: Path, hint: str) -> bool:
    """Run the commands on MODEL that a hint quotes; return False if they write no COPY."""
    commands = re.findall(r"`(gsgen [^`]*\bMODEL\b[^`]*)`", hint)
    names = {"MODEL": path, "COPY": path.with_suffix(".copy.onnx")}
    names |= {"MANIFEST": path.with_suffix(".json"), "FOLDER": path.parent / f"{path.stem}-files"}
    for command in commands if any(" -o COPY" in command for command in commands) else ():
        words, _, target = command.partition(" > ")
        arguments = [str(names.get(word, word)) for word in words.split()[1:]]
        call = [sys.executable, "-m", "gsgen.cli", *arguments]
        result = subprocess.run(call, capture_output=True, check=False)
        if target:
            names[target].write_bytes(result.stdout)
    return names["COPY"].exists() and bool(names["COPY"].replace(path))


def mend(draft: Draft) -> bool:
    """Edit a model as the finding's words say; return False if the reader does not know them."""
    if exact_steps(draft):
        return True
    finding = draft.finding
    text = f"{finding.where} | {finding.message} | {finding.hint}"
    for pattern, edit in MENDS:
        if match := re.search(pattern, text):
            try:
                return edit(draft, match) is not False
            except NotRead:
                return False
    return False
