"""GLB files that break the rules are refused, with the location of the fault."""

import json
import struct

import numpy as np
import pytest

from gsgen.formats import (
    FileTruncated,
    FormatError,
    FormatNotRecognised,
    HeaderMalformed,
    NotSupported,
    PropertyMissing,
    SizeExceeded,
    ValueInvalid,
    read_glb,
    write_glb,
)
from support.glb_files import NAME, built, parts
from support.splat_files import scene


def change(document: dict, path: str, value: object) -> None:
    *key_path, last = [int(key) if key.isdigit() else key for key in path.split("/")]
    for key in key_path:
        document = document[key]
    if value is None:
        del document[last]  # type: ignore[attr-defined]
    else:
        document[last] = value  # type: ignore[index]


P = "meshes/0/primitives/0"
A = f"{P}/attributes/{NAME}"


@pytest.mark.parametrize(
    ("path", "value", "kind", "text"),
    [
        (f"{P}/mode", 4, HeaderMalformed, "meshes[0].primitives[0], mode: '4'\nexpected 0"),
        (f"{P}/extensions/{NAME}/kernel", "cube", NotSupported, "meshes[0].primitives[0], k"),
        (f"{P}/extensions/{NAME}/colorSpace", "x", NotSupported, "meshes[0].primitives[0], c"),
        (f"{P}/extensions", [], PropertyMissing, "the glTF scene holds no splats"),
        (
            f"{A}:ROTATION",
            None,
            PropertyMissing,
            f"meshes[0].primitives[0]: the primitive lacks the attribute {NAME}",
        ),
        (
            f"{A}:SH_DEGREE_1_COEF_1",
            None,
            PropertyMissing,
            "meshes[0].primitives[0]: the primitive lacks the attr",
        ),
        (
            f"{A}:SH_DEGREE_5_COEF_0",
            4,
            NotSupported,
            "meshes[0].primitives[0]: the splats have SH degree 5",
        ),
        (f"{A}:SCALE", 1, HeaderMalformed, "meshes[0].primitives[0], attribute KHR_gaussian_"),
        (f"{A}:SCALE", 99, HeaderMalformed, "meshes[0].primitives[0], attribute KHR_gaussian_"),
        (f"{A}:SCALE", -1, HeaderMalformed, "meshes[0].primitives[0], attribute KHR_gaussian_"),
        (f"{A}:SCALE", "a", HeaderMalformed, "meshes[0].primitives[0], attribute KHR_gaussia"),
        ("accessors/0/count", 10**12, HeaderMalformed, "meshes[0].primitives[0], attribute PO"),
        ("accessors/0/count", 0, HeaderMalformed, "meshes[0].primitives[0], attribute KHR_g"),
        ("accessors/0/componentType", 1, HeaderMalformed, "meshes[0].primitives[0], attribut"),
        ("accessors/0/componentType", [], HeaderMalformed, "meshes[0].primitives[0], attribu"),
        ("accessors/0/type", "MAT4", HeaderMalformed, "meshes[0].primitives[0], attribute PO"),
        ("accessors/0/sparse", {}, NotSupported, "meshes[0].primitives[0], attribute POSITIO"),
        ("accessors/0/byteOffset", 10**9, HeaderMalformed, "meshes[0].primitives[0], attribut"),
        ("bufferViews/0/byteOffset", 10**9, FileTruncated, "meshes[0].primitives[0], attribut"),
        ("bufferViews/0/byteLength", 10**12, FileTruncated, "meshes[0].primitives[0], attrib"),
        ("bufferViews/0/byteStride", 8, HeaderMalformed, "meshes[0].primitives[0], attribute "),
        ("bufferViews/0/buffer", 1, NotSupported, "meshes[0].primitives[0], attribute POSITI"),
        ("buffers/0/uri", "a.bin", NotSupported, "meshes[0].primitives[0], attribute POSITI"),
        ("nodes/0/children", [0], HeaderMalformed, "nodes[0]: the node is its own ancestor"),
        (
            "nodes/0/scale",
            [1, 0, 1],
            NotSupported,
            "nodes[0]: the transform of the node mirrors or fl",
        ),
        (
            "nodes/0/scale",
            [1, -1, 1],
            NotSupported,
            "nodes[0]: the transform of the node mirrors or f",
        ),
        ("nodes/0/scale", [1, 1], HeaderMalformed, "nodes[0].scale: '[1, 1]'\nexpected 3 finit"),
        ("nodes/0/matrix", [1] * 16, HeaderMalformed, "nodes[0].matrix: the last row"),
        ("nodes/0/mesh", 7, HeaderMalformed, "nodes: '7'\nexpected less than the 1 of meshes"),
        ("scenes/0/nodes", [3], HeaderMalformed, "nodes[3]: '3'\nexpected less than the 1 of"),
        ("scene", 1, HeaderMalformed, "scene: '1'\nexpected less than the 1 of scenes"),
        ("meshes/0/primitives", {}, HeaderMalformed, "meshes[0].primitives: '{}'\nexpected an"),
        ("meshes", 3, HeaderMalformed, "meshes: '3'\nexpected an array"),
    ],
)
def test_invalid_document_is_refused(tmp_path, path, value, kind, text):
    file = tmp_path / "bad.glb"
    write_glb(file, scene(4, 1))
    document, binary = parts(file.read_bytes())
    change(document, path, value)
    file.write_bytes(built(document, binary))
    with pytest.raises(FormatError) as caught:
        read_glb(file)
    assert str(caught.value).removeprefix(f"{file}: ").startswith(text), str(caught.value)
    assert type(caught.value) is kind


@pytest.mark.parametrize(
    ("name", "value"), [("SCALE", -1.0), ("OPACITY", 1.5), ("OPACITY", np.nan)]
)
def test_values_beyond_their_range_are_refused(tmp_path, name, value):
    file = tmp_path / "bad.glb"
    write_glb(file, scene(4, 1))
    document, binary = parts(file.read_bytes())
    index = document["meshes"][0]["primitives"][0]["attributes"][f"{NAME}:{name}"]
    offset = document["bufferViews"][index]["byteOffset"]
    binary = binary[:offset] + struct.pack("<f", value) + binary[offset + 4 :]
    file.write_bytes(built(document, binary))
    with pytest.raises(
        ValueInvalid, match=rf"{name}: 1 of \d+ values are invalid: the first is {value:g}"
    ):
        read_glb(file)


def test_nodes_that_multiply_a_mesh_meet_the_limit(tmp_path):
    splats = scene(100, 1)
    nodes = [{"mesh": 0} for _ in range(50)]
    file = tmp_path / "many.glb"
    write_glb(file, splats)
    document, binary = parts(file.read_bytes())
    document |= {"nodes": nodes, "scenes": [{"nodes": list(range(50))}]}
    file.write_bytes(built(document, binary))
    assert len(read_glb(file)) == 5_000
    with pytest.raises(SizeExceeded, match="expected 100000 bytes or fewer"):
        read_glb(file, max_bytes=100_000)


def test_sets_of_both_colour_spaces_are_refused(tmp_path):
    file = tmp_path / "a.glb"
    write_glb(file, scene(4, 1))
    document, binary = parts(file.read_bytes())
    (primitive,) = document["meshes"][0]["primitives"]
    other = json.loads(json.dumps(primitive))
    other["extensions"][NAME]["colorSpace"] = "lin_rec709_display"
    document["meshes"][0]["primitives"].append(other)
    file.write_bytes(built(document, binary))
    with pytest.raises(
        HeaderMalformed, match="some primitives have sRGB colours, others linear ones"
    ):
        read_glb(file)


@pytest.mark.parametrize(
    ("offset", "value", "kind", "text"),
    [
        (0, b"GLTF", FormatNotRecognised, "first bytes: 47 4c 54 46\n"),
        (4, b"\x01", NotSupported, "byte 4: the file has glTF version 1\nexpected version 2"),
        (
            8,
            b"\xff\xff\xff\x7f",
            FileTruncated,
            "header: the data need 2147483647 bytes from byte 0",
        ),
        (12, b"\xff\xff\xff\x07", FileTruncated, "chunk JSON: the data need 134217727 bytes from"),
        (
            12,
            b"\xff\xff\xff\xff",
            HeaderMalformed,
            "byte 12: the first chunk is b'JSON' of 4294967295",
        ),
        (16, b"TEXT", HeaderMalformed, "byte 12: the first chunk is b'TEXT' of "),
        (20, b"!", HeaderMalformed, "chunk JSON: the GLB file has invalid JSON ("),
    ],
)
def test_invalid_coordinate_frame_is_refused(tmp_path, offset, value, kind, text):
    file = tmp_path / "bad.glb"
    write_glb(file, scene(4, 1))
    content = bytearray(file.read_bytes())
    content[offset : offset + len(value)] = value
    file.write_bytes(content)
    with pytest.raises(FormatError) as caught:
        read_glb(file)
    assert str(caught.value).removeprefix(f"{file}: ").startswith(text), str(caught.value)
    assert type(caught.value) is kind


@pytest.mark.parametrize(
    "extension",
    ["EXT_mesh_gpu_instancing", "KHR_node_visibility", "VENDOR_unknown", "KHR_texture_transform"],
)
def test_a_required_extension_that_is_not_known_is_refused(tmp_path, extension):
    write_glb(tmp_path / "a.glb", scene(3, 0))
    content = (tmp_path / "a.glb").read_bytes()
    size = int.from_bytes(content[12:16], "little")
    document = json.loads(content[20 : 20 + size])
    document["extensionsRequired"] = ["KHR_gaussian_splatting", extension]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + size :]
    header = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    (tmp_path / "b.glb").write_bytes(header + struct.pack("<I4s", len(text), b"JSON") + text + rest)
    with pytest.raises(NotSupported, match=f"the file needs {extension}, which is not supported"):
        read_glb(tmp_path / "b.glb")
