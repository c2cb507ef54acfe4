import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.contract.spec.geometry import rotation_matrix
from gsgen.contract.spec.spherical_harmonics import evaluate
from gsgen.formats import (
    PropertyMissing,
    Splats,
    read_glb,
    read_ply,
    read_spz,
    write_glb,
    write_spz,
)
from gsgen.formats.codecs import recognise_codec
from support.glb_files import NAME, built, parts
from support.splat_files import GOLDENS, assert_near, scene


def covariance(splats: Splats) -> np.ndarray:
    axes = rotation_matrix(splats.rotation) * np.exp(splats.log_scale.astype(float))[:, None]
    return axes @ axes.swapaxes(1, 2)


def directions(count: int = 40) -> np.ndarray:
    result = np.random.default_rng(0).standard_normal((count, 3))
    return result / np.linalg.norm(result, axis=1, keepdims=True)


@settings(max_examples=20, deadline=None)
@given(
    degree=st.integers(0, 4),
    seed=st.integers(0, 2**32 - 1),
    space=st.sampled_from(["srgb", "linear"]),
)
def test_glb_round_trip_keeps_float32_precision(tmp_path_factory, degree, seed, space):
    splats = scene(9, degree, seed, color_space=space)
    file = tmp_path_factory.getbasetemp() / "round.glb"
    write_glb(file, splats)
    restored = read_glb(file)
    assert_near(restored, splats, rotation=1e-6, log_scale=1e-6, opacities=1e-7)
    assert restored.color_space == space


def test_written_file_follows_the_extension(tmp_path):
    splats = scene(4, 1)
    write_glb(tmp_path / "a.glb", splats)
    content = (tmp_path / "a.glb").read_bytes()
    assert struct.unpack_from("<4sII", content) == (b"glTF", 2, len(content))
    document, binary = parts(content)
    assert document["asset"]["version"] == "2.0"
    assert document["extensionsUsed"] == [NAME]
    assert document["buffers"] == [{"byteLength": len(binary)}]
    primitive = document["meshes"][0]["primitives"][0]
    assert primitive["mode"] == 0
    assert primitive["extensions"][NAME] == {
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    }

    def values(name: str, width: int) -> np.ndarray:
        accessor = document["accessors"][primitive["attributes"][name]]
        kind = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[width]
        assert (accessor["componentType"], accessor["type"]) == (5126, kind)
        view = document["bufferViews"][accessor["bufferView"]]
        offset = view["byteOffset"]
        return np.array(struct.unpack_from(f"<{4 * width}f", binary, offset)).reshape(4, width)

    flipped = splats.position * np.array([-1, -1, 1])
    np.testing.assert_allclose(values("POSITION", 3), flipped, rtol=1e-6)
    accessor = document["accessors"][primitive["attributes"]["POSITION"]]
    np.testing.assert_allclose(accessor["min"], flipped.min(axis=0), rtol=1e-6)
    np.testing.assert_allclose(accessor["max"], flipped.max(axis=0), rtol=1e-6)
    turns = values(f"{NAME}:ROTATION", 4)
    np.testing.assert_allclose(np.linalg.norm(turns, axis=1), 1, atol=1e-6)
    sizes = values(f"{NAME}:SCALE", 3)
    np.testing.assert_allclose(sizes, np.exp(splats.log_scale), rtol=1e-5)
    np.testing.assert_allclose(
        values(f"{NAME}:OPACITY", 1)[:, 0], 1 / (1 + np.exp(-splats.logit_opacity)), rtol=1e-5
    )
    names = [name for name in primitive["attributes"] if "SH" in name]
    expected = [(0, 0), (1, 0), (1, 1), (1, 2)]
    assert names == [f"{NAME}:SH_DEGREE_{band}_COEF_{n}" for band, n in expected]
    signs = [1, -1, 1, -1]  # of 1, y, z, x
    for index, name in enumerate(names):
        np.testing.assert_allclose(values(name, 3), splats.sh[:, index] * signs[index])
    # The stored quaternion (x, y, z, w) and scale make up the covariance, x and y flipped.
    axes = rotation_matrix(turns[:, [3, 0, 1, 2]]) * sizes[:, None]
    mirror = np.diag([-1, -1, 1])
    np.testing.assert_allclose(
        axes @ axes.swapaxes(1, 2), mirror @ covariance(splats) @ mirror, rtol=1e-4, atol=1e-9
    )


def test_splat_transform_writes_the_same_ellipsoids():
    """Its quaternions are turned by 180° about z, which changes no ellipsoid."""
    here, reference = read_glb(GOLDENS / "scene.glb"), read_ply(GOLDENS / "scene.ply")
    assert isinstance(reference, Splats)
    np.testing.assert_array_equal(here.position, reference.position)
    np.testing.assert_allclose(covariance(here), covariance(reference), rtol=1e-4, atol=1e-9)
    np.testing.assert_array_equal(here.sh, reference.sh)
    np.testing.assert_allclose(here.logit_opacity, reference.logit_opacity, atol=1e-5)


def with_nodes(file, splats: Splats, nodes: list, **document: object) -> Splats:
    write_glb(file, splats)
    old, binary = parts(file.read_bytes())
    file.write_bytes(built(old | {"nodes": nodes} | document, binary))
    return read_glb(file)


def node_matrix(node: dict) -> np.ndarray:
    """The matrix of a node of translation, rotation and scale."""
    x, y, z, w = node.get("rotation", [0, 0, 0, 1])
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_matrix(np.array([[w, x, y, z]]))[0] * node.get("scale", [1, 1, 1])
    matrix[:3, 3] = node.get("translation", [0, 0, 0])
    return matrix


TURN = (np.array([0.5, -0.3, 0.2, 0.7]) / np.linalg.norm([0.5, -0.3, 0.2, 0.7])).tolist()
UNIFORM_SCALE_NODE = {"translation": [1, 2, 3], "rotation": TURN, "scale": [2, 2, 2]}
NONUNIFORM_SCALE_NODE = {"translation": [-1, 0, 3], "rotation": TURN, "scale": [2, 0.5, 1]}


@pytest.mark.parametrize("inner", [{}, UNIFORM_SCALE_NODE, NONUNIFORM_SCALE_NODE])
@pytest.mark.parametrize("outer_matrix", [{}, UNIFORM_SCALE_NODE, NONUNIFORM_SCALE_NODE])
def test_nodes_put_splats_into_the_world(tmp_path, outer_matrix, inner):
    splats = scene(6, 3)
    nodes = [outer_matrix | {"children": [1]}, inner | {"mesh": 0}]
    moved = with_nodes(tmp_path / "a.glb", splats, nodes)
    flip = np.diag([-1, -1, 1, 1])
    matrix = flip @ node_matrix(outer_matrix) @ node_matrix(inner) @ flip
    linear = matrix[:3, :3]
    np.testing.assert_allclose(
        moved.position, splats.position @ linear.T + matrix[:3, 3], atol=1e-5
    )
    expected = linear @ covariance(splats) @ linear.T
    np.testing.assert_allclose(covariance(moved), expected, rtol=1e-3, atol=1e-8)
    left, _, right = np.linalg.svd(linear)
    np.testing.assert_allclose(
        evaluate(moved.sh, directions() @ (left @ right).T),
        evaluate(splats.sh, directions()),
        atol=1e-5,
    )


def test_node_matrix_equals_its_translation_rotation_scale(tmp_path):
    splats = scene(3, 1)
    parts_file = with_nodes(tmp_path / "a.glb", splats, [NONUNIFORM_SCALE_NODE | {"mesh": 0}])
    matrix = {"matrix": node_matrix(NONUNIFORM_SCALE_NODE).T.ravel().tolist(), "mesh": 0}
    assert_near(with_nodes(tmp_path / "a.glb", splats, [matrix]), parts_file, position=1e-6)


def test_a_mesh_may_be_shown_twice_and_not_at_all(tmp_path):
    splats = scene(3, 1)
    nodes = [{"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0]}, {"mesh": 0}]
    both = with_nodes(tmp_path / "a.glb", splats, nodes, scenes=[{}, {"nodes": [1, 0]}], scene=1)
    assert len(both) == 6
    np.testing.assert_allclose(both.position[:3], splats.position - [5, 0, 0], atol=1e-6)
    np.testing.assert_array_equal(both.position[3:], splats.position)
    with pytest.raises(PropertyMissing, match="the glTF scene holds no splats"):
        with_nodes(tmp_path / "a.glb", splats, nodes, scenes=[{}])


def test_a_file_without_scenes_shows_all_roots(tmp_path):
    splats = scene(3, 1)
    write_glb(tmp_path / "a.glb", splats)
    document, binary = parts((tmp_path / "a.glb").read_bytes())
    del document["scenes"], document["scene"]
    document["nodes"] = [{"mesh": 0}, {"children": [0]}]
    (tmp_path / "a.glb").write_bytes(built(document, binary))
    assert len(read_glb(tmp_path / "a.glb")) == 3


INTEGER_COMPONENTS = {
    "ROTATION": [(5122, "<i2", 32767), (5120, "i1", 127)],
    "SCALE": [(5121, "u1", 1), (5123, "<u2", 1), (5121, "u1", 255), (5123, "<u2", 65535)],
    "OPACITY": [(5121, "u1", 255), (5123, "<u2", 65535)],
}


@pytest.mark.parametrize(
    ("name", "kind", "code", "largest"),
    [(name, *kind) for name, kinds in INTEGER_COMPONENTS.items() for kind in kinds],
)
def test_normalised_integers_are_read_as_fractions(tmp_path, name, kind, code, largest):
    write_glb(tmp_path / "a.glb", scene(5, 0))
    document, binary = parts((tmp_path / "a.glb").read_bytes())
    attribute = document["meshes"][0]["primitives"][0]["attributes"][f"{NAME}:{name}"]
    accessor = document["accessors"][attribute]
    width = {"VEC4": 4, "VEC3": 3, "SCALAR": 1}[accessor["type"]]
    low = 0 if code[-2] == "u" else -largest
    stored = np.random.default_rng(0).integers(low, max(largest, 9), (5, 4)).astype(code)
    item_bytes = stored.itemsize * width
    stride = -(-item_bytes // 4) * 4  # glTF aligns rows to four bytes
    rows = b"".join(row[:width].tobytes().ljust(stride, b"\0") for row in stored)
    view = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(rows)}
    document["bufferViews"].append(view | {"byteStride": stride})
    accessor |= {"bufferView": len(document["bufferViews"]) - 1, "componentType": kind}
    accessor["normalized"] = largest > 1
    (tmp_path / "a.glb").write_bytes(built(document, binary + rows))
    restored = read_glb(tmp_path / "a.glb")
    expected = stored[:, :width] / (largest if largest > 1 else 1)
    if name == "SCALE":
        np.testing.assert_allclose(np.exp(restored.log_scale), expected, rtol=1e-5)
    elif name == "OPACITY":
        shown = 1 / (1 + np.exp(-restored.logit_opacity))
        np.testing.assert_allclose(shown, expected[:, 0], rtol=1e-5)
    else:
        turn = expected[:, [3, 0, 1, 2]] * [1, -1, -1, 1]
        turn /= np.linalg.norm(turn, axis=1, keepdims=True)
        np.testing.assert_allclose(restored.rotation, turn, atol=1e-6)


@pytest.mark.parametrize(
    "location",
    [
        {NAME: {"extensions": {"KHR_gaussian_splatting_compression_spz_2": {"bufferView": 0}}}},
        {NAME: {"extensions": {"KHR_gaussian_splatting_compression_spz": {"bufferView": 0}}}},
        {"KHR_spz_gaussian_splats_compression": {"bufferView": 0}},
    ],
)
def test_spz_of_the_drafts_is_read_as_left_up_forward(tmp_path, location):
    splats = scene(5, 2)
    write_spz(tmp_path / "a.spz", splats, version=2)
    packed = (tmp_path / "a.spz").read_bytes()
    document = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(packed)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(packed)}],
        "meshes": [{"primitives": [{"mode": 0, "attributes": {}, "extensions": location}]}],
        "nodes": [{"mesh": 0}],
    }
    (tmp_path / "a.glb").write_bytes(built(document, packed))
    here, reference = read_glb(tmp_path / "a.glb"), read_spz(tmp_path / "a.spz")
    # What SPZ alone calls right up back is here called left up forward.
    np.testing.assert_array_equal(here.position, reference.position * [-1, 1, -1])
    np.testing.assert_array_equal(here.log_scale, reference.log_scale)


def test_attributes_of_the_first_draft_are_read(tmp_path):
    splats = scene(4, 0)
    write_glb(tmp_path / "a.glb", splats)
    document, binary = parts((tmp_path / "a.glb").read_bytes())
    primitive = document["meshes"][0]["primitives"][0]
    del primitive["extensions"]
    old = primitive["attributes"]
    rgba = np.arange(16, dtype=np.uint8) * 16
    view = {"buffer": 0, "byteOffset": len(binary), "byteLength": 16}
    document["bufferViews"].append(view)
    accessor = {"componentType": 5121, "count": 4, "type": "VEC4", "normalized": True}
    document["accessors"].append(accessor | {"bufferView": len(document["bufferViews"]) - 1})
    primitive["attributes"] = {
        "POSITION": old["POSITION"],
        "_ROTATION": old[f"{NAME}:ROTATION"],
        "_SCALE": old[f"{NAME}:SCALE"],
        "COLOR_0": len(document["accessors"]) - 1,
    }
    (tmp_path / "a.glb").write_bytes(built(document, binary + rgba.tobytes()))
    restored = read_glb(tmp_path / "a.glb")
    np.testing.assert_array_equal(restored.position, splats.position)
    shown = np.column_stack(
        [0.5 + 0.28209479 * restored.sh[:, 0], 1 / (1 + np.exp(-restored.logit_opacity))]
    )
    np.testing.assert_allclose(shown, rgba.reshape(4, 4) / 255, atol=1e-6)


def test_the_antialiased_flag_is_not_kept(tmp_path):
    write_glb(tmp_path / "a.glb", replace(scene(1, 0), antialiased=True))
    assert not read_glb(tmp_path / "a.glb").antialiased
    with (tmp_path / "a.glb").open("rb") as stream:
        codec = recognise_codec(stream)
    assert codec is not None
    assert "antialiased" not in codec.keeps_flags
