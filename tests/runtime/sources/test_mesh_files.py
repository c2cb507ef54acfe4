"""Files of triangles are told from files of Gaussians, and read as they look."""

import cProfile
import io
import json
import logging
import os
import struct
import subprocess
import sys
from base64 import b64encode
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from gsgen.formats import FormatWarning, Splats, write_glb, write_ply
from gsgen.runtime.errors import SceneInvalid, SceneUnreadable
from gsgen.runtime.sources.mesh_files import is_mesh, read_mesh

SHAPE = trimesh.creation.icosphere(subdivisions=1)
COLORS = np.random.default_rng(0).integers(0, 255, (42, 4), np.uint8)
PICTURE = np.random.default_rng(1).integers(0, 255, (4, 6, 3), np.uint8)


@pytest.fixture(autouse=True)
def _silence_trimesh_log() -> None:
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)


def painted(**visual: object) -> trimesh.Trimesh:
    mesh = trimesh.Trimesh(SHAPE.vertices, SHAPE.faces, process=False)
    if "uv" in visual or "material" in visual:
        mesh.visual = TextureVisuals(**visual)
    for name, colors in visual.items():
        if name.endswith("colors"):
            setattr(mesh.visual, name, colors)
    return mesh


def textured(**material: object) -> trimesh.Trimesh:
    uv = np.random.default_rng(2).uniform(size=(42, 2))
    image = Image.fromarray(PICTURE)
    return painted(uv=uv, material=PBRMaterial(baseColorTexture=image, **material))


def write_mesh(path: Path, mesh: trimesh.Trimesh | trimesh.Scene, **options: object) -> Path:
    content = mesh.export(file_type=path.suffix[1:], **options)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.mark.parametrize("name", ["a.ply", "a.obj", "a.stl", "a.glb"])
def test_mesh_shapes_round_trip(tmp_path: Path, name: str) -> None:
    path = write_mesh(tmp_path / name, painted())
    assert is_mesh(path)
    (mesh,) = read_mesh(path)
    corners = mesh.data.vertices[mesh.data.faces] @ mesh.transform[:3, :3].T
    turned = [-1, -1, 1] if name == "a.glb" else [1, 1, 1]  # glTF's y is up, ours is down
    np.testing.assert_allclose(corners * turned, SHAPE.vertices[SHAPE.faces], atol=1e-6)


@pytest.mark.parametrize("name", ["a.ply", "a.obj", "a.glb"])
def test_vertex_colors_are_read(tmp_path: Path, name: str) -> None:
    (mesh,) = read_mesh(write_mesh(tmp_path / name, painted(vertex_colors=COLORS)))
    np.testing.assert_allclose(mesh.data.colors, COLORS[:, :3] / 255, atol=1e-6)
    assert mesh.shading == "unlit"
    assert mesh.data.color_space == ("linear" if name == "a.glb" else "srgb")


def test_face_colors_are_read(tmp_path: Path) -> None:
    colors = np.random.default_rng(3).integers(0, 255, (80, 4), np.uint8)
    (mesh,) = read_mesh(write_mesh(tmp_path / "a.ply", painted(face_colors=colors)))
    np.testing.assert_allclose(
        mesh.data.colors[mesh.data.faces], np.repeat(colors[:, None, :3], 3, 1) / 255, atol=1e-6
    )


def test_uncoloured_mesh_is_grey_and_lit(tmp_path: Path) -> None:
    (mesh,) = read_mesh(write_mesh(tmp_path / "a.stl", painted()))
    assert mesh.shading == "headlight"
    assert len(np.unique(mesh.data.colors)) == 1


def test_texture_is_multiplied_by_its_factor(tmp_path: Path) -> None:
    path = write_mesh(tmp_path / "a.glb", textured(baseColorFactor=[255, 128, 64, 255]))
    (mesh,) = read_mesh(path)
    assert np.array_equal(mesh.data.texture[..., :3], PICTURE)
    assert mesh.data.color_space == "srgb"
    linear = np.array([255, 128, 64]) / 255
    srgb = 1.055 * linear ** (1 / 2.4) - 0.055
    np.testing.assert_allclose(mesh.data.colors, np.tile(srgb, (42, 1)), atol=1e-6)


def test_a_factor_alone_is_linear(tmp_path: Path) -> None:
    original = painted(material=PBRMaterial(baseColorFactor=[255, 128, 64, 255]))
    (mesh,) = read_mesh(write_mesh(tmp_path / "a.glb", original))
    assert mesh.data.color_space == "linear"
    np.testing.assert_allclose(mesh.data.colors[0], np.array([255, 128, 64]) / 255)


def test_obj_material_files_are_read(tmp_path: Path) -> None:
    textured(baseColorFactor=[255, 128, 64, 255]).export(tmp_path / "a.obj")
    (mesh,) = read_mesh(tmp_path / "a.obj")
    assert np.array_equal(mesh.data.texture[..., :3], PICTURE)
    (tmp_path / "material.mtl").unlink()
    with pytest.warns(
        UserWarning, match=r"material\.mtl is missing in its folder; the mesh is drawn without"
    ):
        (bare,) = read_mesh(tmp_path / "a.obj")
    assert bare.data.texture is None
    assert bare.shading == "headlight"


def test_obj_of_two_materials_is_read_as_two_meshes(tmp_path: Path) -> None:
    """Without texture coordinates, where trimesh computes with NaN and NumPy warns."""
    (tmp_path / "a.mtl").write_text("newmtl red\nKd 0.8 0.1 0.1\nnewmtl blue\nKd 0.1 0.1 0.8\n")
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    lines = ["mtllib a.mtl", *(f"v {x} {y} {z}" for x, y, z in corners), "vn 0 1 0", "vn 1 0 0"]
    lines += ["usemtl red", "f 3//1 7//1 8//1 4//1", "f 5//2 6//2 8//2 7//2"]
    lines += ["usemtl blue", "f 1//1 2//1 6//1 5//1"]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    meshes = read_mesh(tmp_path / "a.obj")
    counts_by_color = {
        tuple(mesh.data.colors[0].round(1).astype(str)): len(mesh.data) for mesh in meshes
    }
    assert counts_by_color == {("0.8", "0.1", "0.1"): 4, ("0.1", "0.1", "0.8"): 2}


@pytest.mark.parametrize("corner", ["{0}", "{0}/{0}", "{0}//{0}", "{0}/{0}/{0}"])
def test_negative_indices_of_an_obj_count_back_from_their_face(tmp_path: Path, corner: str) -> None:
    """Two triangles, each after its own vertices, in a file of absolute and one of relative indices."""
    blocks = [
        "".join(f"v {x + shift} {y} 0\nvt {x} {y}\nvn 0 0 1\n" for x, y in ((0, 0), (1, 0), (0, 1)))
        for shift in (0, 5)
    ]

    def face(*indices: int) -> str:
        return f"f {' '.join(corner.format(index) for index in indices)}\n"

    absolute, relative = tmp_path / "absolute.obj", tmp_path / "relative.obj"
    absolute.write_text(blocks[0] + face(1, 2, 3) + blocks[1] + face(4, 5, 6))
    relative.write_text(blocks[0] + face(-3, -2, -1) + blocks[1] + face(-3, -2, -1))
    (expected,), (actual,) = read_mesh(absolute), read_mesh(relative)
    np.testing.assert_array_equal(
        actual.data.vertices[actual.data.faces], expected.data.vertices[expected.data.faces]
    )
    assert expected.data.vertices[expected.data.faces][1, :, 0].tolist() == [5, 6, 5]


@pytest.mark.parametrize("key", ["accessors", "bufferViews"])
def test_gltf_with_a_long_first_member_is_a_mesh(tmp_path: Path, key: str) -> None:
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps({key: [{"name": "x" * 300_000}], "asset": {"version": "2.0"}}))
    assert is_mesh(path)


def test_vertex_colours_beside_a_texture_by_face_are_named(tmp_path: Path) -> None:
    Image.new("RGB", (2, 2), (255, 0, 0)).save(tmp_path / "red.png")
    vertices = "".join(f"{x} {y} 0 0 255 0\n" for x, y in ((0, 0), (1, 0), (0, 1), (1, 1)))
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\ncomment TextureFile red.png\nelement vertex 4\n"
        "property float x\nproperty float y\nproperty float z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\n"
        "element face 2\nproperty list uchar int vertex_indices\n"
        f"property list uchar float texcoord\nend_header\n{vertices}"
        "3 0 1 2 6 0 0 1 0 0 1\n3 2 1 3 6 1 1 0 1 1 0\n"
    )
    with pytest.warns(FormatWarning, match="not used: vertex colours"):
        (mesh,) = read_mesh(tmp_path / "a.ply")
    assert mesh.data.texture is not None
    assert (mesh.data.texture[..., :3] == (255, 0, 0)).all()


def test_names_in_any_encoding_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_bytes(b"o caf\xe9\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 4 3\n")
    (mesh,) = read_mesh(path)
    assert len(mesh.data) == 2  # a quad is two triangles


def test_nodes_stand_where_they_say_and_share_what_they_show(tmp_path: Path) -> None:
    scene, away = trimesh.Scene(), np.eye(4)
    away[:3, 3] = 3, 2, 1
    scene.add_geometry(painted(), geom_name="ball", node_name="here")
    scene.graph.update(frame_to="there", matrix=away, geometry="ball")
    scene.add_geometry(textured())
    actual = read_mesh(write_mesh(tmp_path / "a.glb", scene))
    assert len(actual) == 3
    moved = next(entry for entry in actual if entry.transform[0, 3] != 0)
    np.testing.assert_allclose(moved.transform[:3, 3], [-3, -2, 1])
    assert sum(entry.data is moved.data for entry in actual) == 2


def test_splats_and_points_are_no_meshes(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    splats = Splats(
        position=rng.normal(size=(9, 3)).astype(np.float32),
        rotation=rng.normal(size=(9, 4)).astype(np.float32),
        log_scale=rng.normal(size=(9, 3)).astype(np.float32),
        logit_opacity=rng.normal(size=9).astype(np.float32),
        sh=rng.normal(size=(9, 1, 3)).astype(np.float32),
    )
    write_ply(tmp_path / "s.ply", splats)
    write_glb(tmp_path / "s.glb", splats)
    cloud = trimesh.PointCloud(SHAPE.vertices, COLORS)
    (tmp_path / "p.ply").write_bytes(cloud.export(file_type="ply"))
    for name in ("s.ply", "s.glb", "p.ply", "absent.glb", "."):
        assert not is_mesh(tmp_path / name)


def glb(document: dict[str, object]) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text


HOSTILE = {
    "empty.ply": (b"", r"begins with the bytes \(none\), expected a mesh"),
    "text.glb": (b"hello there", "begins with the bytes 68 65 6c 6c, expected a mesh"),
    "short.glb": (b"glTF\2\0\0\0", "cannot be read as GLB"),
    "deep.glb": (glb({"a": 1})[:-8] + b"[" * 8, "cannot be read as GLB"),
    "list.glb": (glb([1]), "JSON: the glTF document is a list, expected an object"),
    "many.glb": (
        glb({"accessors": [{"count": 10**12}]}),
        r"accessors\[0\]\.count: is 1000000000000, expected at most \d+ by the size of the file",
    ),
    "twice.glb": (
        glb({"nodes": [{"children": [2]}, {"children": [2]}, {}]}),
        "nodes: has a node with two parents",
    ),
    "ring.glb": (
        glb({"nodes": [{"children": [1]}, {"children": [0]}]}),
        r"nodes\[0\]: the node is its own ancestor",
    ),
    "packed.glb": (
        glb({"extensionsRequired": ["KHR_draco_mesh_compression"]}),
        "needs KHR_draco_mesh_compression",
    ),
    "many.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\n"
        b"element face 1\nproperty list uchar int vertex_indices\nend_header\n",
        r"element vertex: is 99999999999, expected at most \d+ by the size of the file",
    ),
    "many.stl": (b"\0" * 80 + b"\xff\xff\xff\xff" + b"\0" * 50, "triangles: is 4294967295"),
    "nan.obj": (b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "vertices: 1 of 3 rows"),
    "far.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "far.obj: "),
    "points.obj": (b"v 0 0 0\nv 1 0 0\n", "the mesh file has no triangles"),
    "x.fbx": (
        b"Kaydara FBX",
        "begins with the bytes 4b 61 79 64, expected a mesh\n.*GLB, glTF, OBJ",
    ),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_end_in_an_error(tmp_path: Path, name: str) -> None:
    content, match = HOSTILE[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SceneUnreadable, match=match):
        read_mesh(tmp_path / name)


def test_mutants_end_in_an_error_or_a_mesh(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    scene = trimesh.Scene([textured(), painted(vertex_colors=COLORS)])
    read = 0
    for suffix, mesh in (
        ("glb", scene),
        ("ply", painted()),
        ("stl", painted()),
        ("obj", painted()),
    ):
        whole = write_mesh(tmp_path / f"a.{suffix}", mesh).read_bytes()
        for number in range(40):
            mutant = bytearray(whole[: rng.integers(len(whole))] if number % 4 == 0 else whole)
            for _ in range(number % 4):
                mutant[rng.integers(min(len(mutant), 3000))] = rng.integers(256)
            path = tmp_path / f"m.{suffix}"
            path.write_bytes(mutant)
            try:
                read += bool(read_mesh(path))
            except SceneUnreadable:
                continue  # anything else fails this test
    assert 0 < read < 160


def test_texture_beyond_the_memory_limit_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_mesh(tmp_path / "a.glb", textured())
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 10)
    with pytest.raises(SceneUnreadable, match="textures: cannot be read for 1 of 1 parts"):
        read_mesh(path)


def test_missing_trimesh_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = write_mesh(tmp_path / "a.ply", painted())
    monkeypatch.setitem(sys.modules, "trimesh", None)
    assert is_mesh(path)
    with pytest.raises(SceneInvalid, match=r"trimesh, which is not installed\n.*runtime"):
        read_mesh(path)


def test_trimesh_is_imported_when_a_mesh_is_read() -> None:
    code = (
        "import sys, gsgen.runtime.renderer.renderer, gsgen.runtime.sources.source, gsgen.runtime.sources.scene_file;"
        "assert 'trimesh' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_nothing_is_read_from_other_folders(tmp_path: Path) -> None:
    secret = io.BytesIO()
    Image.fromarray(PICTURE).save(secret, "PNG")
    (tmp_path / "secret.png").write_bytes(secret.getvalue())
    inner = tmp_path / "inner"
    inner.mkdir()
    (inner / "a.mtl").write_text("newmtl m\nKd 1 1 1\nmap_Kd ../secret.png\n")
    lines = "mtllib a.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
    (inner / "a.obj").write_text(lines + "f 1/1 2/2 3/3\n")
    try:
        (mesh,) = read_mesh(inner / "a.obj")
    except SceneUnreadable:
        return
    assert mesh.data.texture is None or mesh.data.texture.shape[:2] != PICTURE.shape[:2]


def _gltf_of_nodes(nodes: list[dict[str, object]]) -> str:
    corners = np.eye(3, dtype="<f4").tobytes()
    return json.dumps(
        {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": nodes,
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "buffers": [
                {
                    "byteLength": 36,
                    "uri": f"data:application/octet-stream;base64,{b64encode(corners).decode()}",
                }
            ],
        }
    )


@pytest.mark.parametrize("shape", ["chain", "star"])
def test_time_of_a_gltf_grows_with_its_nodes(tmp_path: Path, shape: str) -> None:
    """Counted in products of matrices and calls of functions, which a loaded machine does not change."""
    calls = []
    for count in (300, 600):
        links = [[number + 1] for number in range(count - 1)] if shape == "chain" else []
        links = links or [list(range(1, count))]
        nodes: list[dict[str, object]] = [
            {"mesh": 0, "translation": [1, 0, 0]} for _ in range(count)
        ]
        for node, children in zip(nodes, links, strict=False):
            node["children"] = children
        file = tmp_path / f"{count}.gltf"
        file.write_text(_gltf_of_nodes(nodes))
        meshes = read_mesh(file)
        assert len(meshes) == count
        farthest = max(abs(mesh.transform[0, 3]) for mesh in meshes)
        assert farthest == (count if shape == "chain" else 2)
        profile = cProfile.Profile()
        profile.runcall(read_mesh, file)
        calls.append(sum(entry.callcount for entry in profile.getstats()))
    assert calls[1] < 2.5 * calls[0]


@pytest.mark.parametrize("kind", ["buffer", "picture", "material", "file"])
def test_pipe_in_the_place_of_a_file_is_refused(tmp_path: Path, kind: str) -> None:
    """Opening it would wait for ever: nothing writes to it."""
    os.mkfifo(tmp_path / "pipe")
    file = tmp_path / "mesh.gltf"
    document = json.loads(_gltf_of_nodes([{"mesh": 0}]))
    if kind == "buffer":
        document["buffers"][0]["uri"] = "pipe"
    document["images"] = [{"uri": "pipe"}]
    document["textures"] = [{"source": 0}]
    document["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    primitive = document["meshes"][0]["primitives"][0]
    primitive["material"] = 0
    primitive["attributes"]["TEXCOORD_0"] = 0
    file.write_text(json.dumps(document))
    if kind == "material":
        file = tmp_path / "mesh.obj"
        file.write_text("mtllib pipe\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        with pytest.warns(UserWarning, match="pipe is missing"):
            assert len(read_mesh(file)) == 1
        return
    if kind == "file":
        file = tmp_path / "pipe.gltf"
        os.mkfifo(file)
        assert not is_mesh(file)
        return
    with pytest.raises(SceneUnreadable, match=r"regular file|textures: cannot be read"):
        read_mesh(file)
