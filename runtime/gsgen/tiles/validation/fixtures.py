"""Example tilesets, made by code: good ones, and for each rule GT one that breaks it alone.

Registered under the entry point group ``gsgen.fixtures``.
"""

import hashlib
import json
import struct
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gsgen.conformance.fixtures.builders.fixture import Fixture, fixtures_in
from gsgen.contract.spec.severity import Level
from gsgen.formats.spz import container, streams
from gsgen.tiles.index import GLTF_EXTENSION
from gsgen.tiles.neural import EXTENSION as NEURAL
from gsgen.tiles.validation.sketches import (
    TilesetSketch,
    edit_glb,
    explicit_sketch,
    implicit_sketch,
)

__all__ = ["tiles_fixtures"]

Draw = Callable[[], TilesetSketch]
_INDEX = "/tileset.json"


def tiles_fixtures() -> list[Fixture]:
    """Return the example tilesets."""
    return fixtures_in(sys.modules[__name__])


def _example(rule: str = "", *, level: Level = Level.VALUES) -> Callable[[Draw], Fixture]:
    def declare(draw: Draw) -> Fixture:
        summary = (draw.__doc__ or "").partition("\n")[0]
        return Fixture(
            name=draw.__name__,
            rule=rule,
            summary=summary,
            draw=draw,  # type: ignore[arg-type]
            level=level,
            suffix=_INDEX,
        )

    return declare


@_example()
def tiles_good() -> TilesetSketch:
    """A root over two leaves, SPZ 2, with a build record."""
    return explicit_sketch()


@_example()
def tiles_good_floats() -> TilesetSketch:
    """A root over two leaves with plain float accessors."""
    return explicit_sketch(codec="khr")


@_example()
def tiles_good_globe() -> TilesetSketch:
    """A root over two leaves on the globe."""
    matrix = np.eye(4)
    matrix[:3, :3] = [[-0.8, -0.6, 0.0], [0.0, 0.0, 1.0], [-0.6, 0.8, 0.0]]
    matrix[:3, 3] = [4_000_000.0, 3_000_000.0, 3_900_000.0]
    return explicit_sketch(transform=matrix)


@_example()
def tiles_good_implicit() -> TilesetSketch:
    """An implicit octree of two levels of subtrees."""
    return implicit_sketch()


@_example()
def tiles_good_neural() -> TilesetSketch:
    """A leaf that holds a generator, too."""
    return _neural()


@_example("GT001")
def tiles_without_error() -> TilesetSketch:
    """A leaf has no geometric error."""
    sketch = explicit_sketch()
    del sketch.document["root"]["children"][0]["geometricError"]
    return sketch


@_example("GT002")
def tiles_child_outside() -> TilesetSketch:
    """The box of a leaf is larger than the root's box."""
    sketch = explicit_sketch()
    box = sketch.document["root"]["children"][0]["boundingVolume"]["box"]
    box[3] *= 8
    return sketch


@_example("GT003")
def tiles_splats_outside() -> TilesetSketch:
    """The box of a content holds half of its splats."""
    sketch = explicit_sketch()
    content = sketch.document["root"]["children"][1]["content"]
    content["boundingVolume"]["box"][3] *= 0.5
    return sketch


@_example("GT004")
def tiles_error_grows() -> TilesetSketch:
    """A tile between root and leaf has a larger error than the root."""
    sketch = explicit_sketch()
    root = sketch.document["root"]
    leaf = root["children"][0]
    between = {
        "boundingVolume": leaf["boundingVolume"],
        "children": [leaf],
        "geometricError": root["geometricError"] * 2,
    }
    root["children"][0] = between
    return sketch


@_example("GT005")
def tiles_content_cut_short() -> TilesetSketch:
    """A leaf's file ends early."""
    sketch = explicit_sketch(record=False)
    uri = sketch.document["root"]["children"][0]["content"]["uri"]
    sketch.files[uri] = sketch.files[uri][:-40]
    return sketch


@_example("GT006")
def tiles_counts_differ() -> TilesetSketch:
    """Metadata declares one splat more than the content has."""
    sketch = explicit_sketch()
    sketch.document["root"]["children"][0]["metadata"]["properties"]["splats"] += 1
    return sketch


@_example("GT007")
def tiles_extension_missing() -> TilesetSketch:
    """The extension for SPZ is not declared."""
    sketch = explicit_sketch()
    declared = sketch.document["extensions"][GLTF_EXTENSION]
    declared["extensionsRequired"] = declared["extensionsRequired"][:1]
    return sketch


@_example("GT008")
def tiles_hole_in_children() -> TilesetSketch:
    """Half of the root's splats have no leaf."""
    sketch = explicit_sketch(record=False)
    root = sketch.document["root"]
    removed_child = root["children"].pop()
    properties = sketch.document["metadata"]["properties"]
    properties["source_splats"] -= removed_child["metadata"]["properties"]["splats"]
    return sketch


@_example("GT009")
def tiles_spz_version() -> TilesetSketch:
    """A leaf is SPZ of version 3."""
    sketch = explicit_sketch(record=False)
    uri = sketch.document["root"]["children"][0]["content"]["uri"]

    def encode(packed: bytes) -> bytes:
        frame = container.unpack(packed, 1 << 24)
        splats = streams.decode(
            frame.streams,
            version=2,
            degree=frame.degree,
            fractional_bits=frame.fractional_bits,
            antialiased=False,
        )
        content = streams.encode(
            splats, version=3, fractional_bits=frame.fractional_bits, sh_bits=(5, 4)
        )
        return container.pack(replace(frame, version=3), content)

    sketch.files[uri] = edit_glb(sketch.files[uri], binary=encode)
    return sketch


@_example("GT010")
def tiles_uri_escapes() -> TilesetSketch:
    """A leaf's content is outside the folder of the tileset."""
    sketch = explicit_sketch()
    sketch.document["root"]["children"][0]["content"]["uri"] = "../elsewhere.glb"
    return sketch


@_example("GT011")
def tiles_mirrored() -> TilesetSketch:
    """A leaf is mirrored."""
    sketch = explicit_sketch()
    mirror = np.diag([1.0, -1.0, 1.0, 1.0]).ravel().tolist()
    sketch.document["root"]["children"][0]["transform"] = mirror
    return sketch


@_example("GT012")
def tiles_opacity_above_one() -> TilesetSketch:
    """An opacity is 1.5."""
    sketch = explicit_sketch(codec="khr", record=False)
    uri = sketch.document["root"]["children"][0]["content"]["uri"]
    count = sketch.document["root"]["children"][0]["metadata"]["properties"]["splats"]

    def brighten(data: bytes) -> bytes:
        first = count * 4 * (3 + 4 + 3)
        return data[:first] + struct.pack("<f", 1.5) + data[first + 4 :]

    sketch.files[uri] = edit_glb(sketch.files[uri], binary=brighten)
    return sketch


@_example("GT013")
def tiles_subtree_short() -> TilesetSketch:
    """A subtree lacks the last bytes that its header promises."""
    sketch = implicit_sketch()
    uri = min(path for path in sketch.files if path.endswith(".subtree"))
    sketch.files[uri] = sketch.files[uri][:-8]
    return sketch


@_example("GT014")
def tiles_leaf_lost() -> TilesetSketch:
    """The tileset says that the scene has more splats than its leaves have."""
    sketch = explicit_sketch(record=False)
    sketch.document["metadata"]["properties"]["source_splats"] += 7
    return sketch


@_example("GT015")
def tiles_file_changed() -> TilesetSketch:
    """The digest of a file differs from the one in the build record."""
    sketch = explicit_sketch()
    uri = sketch.document["root"]["children"][0]["content"]["uri"]
    sketch.files[uri] = sketch.files[uri].replace(b'"gsgen"', b'"other"')
    return sketch


@_example("GT016")
def tiles_too_many_splats() -> TilesetSketch:
    """One tile has 262,145 splats, all alike."""
    return explicit_sketch(leaf_rows=262_145)


@_example("GT017")
def tiles_root_error_zero() -> TilesetSketch:
    """The geometric error of the root is 0."""
    sketch = explicit_sketch()
    sketch.document["root"]["geometricError"] = 0.0
    return sketch


@_example("GT018")
def tiles_empty_leaf() -> TilesetSketch:
    """A leaf has no content."""
    sketch = explicit_sketch()
    root = sketch.document["root"]
    empty = {"boundingVolume": root["boundingVolume"], "geometricError": 0.0}
    root["children"].append(empty)
    return sketch


@_example("GT019")
def tiles_draft_names() -> TilesetSketch:
    """Contents name their attributes as a draft of the extension did."""
    sketch = explicit_sketch(codec="khr", record=False)

    def rename(document: dict[str, object]) -> dict[str, object]:
        text = json.dumps(document)
        for name in ("ROTATION", "SCALE"):
            text = text.replace(f"KHR_gaussian_splatting:{name}", f"_{name}")
        renamed: dict[str, object] = json.loads(text)
        return renamed

    files = {uri: edit_glb(data, document=rename) for uri, data in sketch.files.items()}
    sketch.files.update(files)
    return sketch


@_example("GT020")
def tiles_neural_digest() -> TilesetSketch:
    """The digest of the generator differs from the one in the tile."""
    sketch = _neural()
    extension = sketch.document["root"]["children"][0]["extensions"][NEURAL]
    extension["sha256"] = hashlib.sha256(b"another model").hexdigest()
    return sketch


def _neural() -> TilesetSketch:
    from gsgen.conformance.fixtures.builders.moving import drifting

    sketch = explicit_sketch()
    model = drifting().build().SerializeToString()
    sketch.files["n/leaf.onnx"] = model
    leaf = sketch.document["root"]["children"][0]
    sketch.document["extensionsUsed"].append(NEURAL)
    leaf["extensions"] = {
        NEURAL: {
            "uri": "n/leaf.onnx",
            "contract": "1.1",
            "sha256": hashlib.sha256(model).hexdigest(),
            "inputs": ["time"],
            "splats_max": 4096,
            "time_range": [0.0, 1.0],
        }
    }
    return sketch
