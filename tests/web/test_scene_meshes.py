"""Meshes in scene files of pages: three.js draws them among the Gaussians, as Python draws them."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from gsgen.conformance.viewer_kit.write import kit_cases
from gsgen.formats import write_ply, write_spz
from gsgen.reference_plugins.images.synthetic_images import write_denoiser
from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.web.onnxruntime_web import ORT_FILES
from gsgen.runtime.web.pages import ModelView
from gsgen.runtime.web.serving import ModelServer
from support import glb_files
from support.commands import gsgen_here
from support.tiles.builds import SMALL, build
from support.web import pages
from support.web.packages import package
from support.web.scene_pages import HEIGHT, WIDTH, decibels, picture, rendered, shown
from support.web.without_webgpu import IMPORT_MAP, THREE

pytestmark = pytest.mark.slow

_WHOLE, _SPLATS = 40, 90  # decibels to Python
_PAGE = f"""<!doctype html><meta charset=utf-8>{IMPORT_MAP}
  <style>gsgen-scene {{ width: {WIDTH}px; height: {HEIGHT}px; aspect-ratio: auto }}</style>
  <script type=module src=/client/scene.js></script><body></body>""".encode()
_GENERATORS = {"time-in-seconds", "view-row", "count-changes"}
_EYES = ["look-at:0.4,-1.2,-7,0,0,0", "look-at:3,-1,-6,0.2,0,0"]


@pytest.fixture(scope="module")
def site(browser: Any, ort_folder: Path) -> Iterator[pages.WebSite]:
    with pages.site(browser, three=package(THREE)) as site:
        for name in ORT_FILES:
            site.contents[f"/client/ort/{name}"] = (ort_folder / name).read_bytes()
        yield site


def checkered(shape: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return a shape with a checkered texture, and a factor of its colours."""
    uv = 0.25 * shape.vertices @ np.array([[1, 0.2], [0.3, 1], [0.7, -0.6]])
    squares = (np.indices((8, 8)).sum(axis=0) % 2)[..., None] * np.uint8([225, 180, 90]) + 20
    material = PBRMaterial(
        baseColorTexture=Image.fromarray(squares.astype(np.uint8)),
        baseColorFactor=[255, 230, 200, 255],
    )
    shape.visual = TextureVisuals(uv=uv, material=material)
    return shape


def colored(shape: trimesh.Trimesh) -> trimesh.Trimesh:
    shape.visual.vertex_colors = np.random.default_rng(0).integers(
        0, 255, (len(shape.vertices), 4), np.uint8
    )
    return shape


def animated_glb(path: Path) -> None:
    """Write a GLB whose red box is two units to the right after a second."""
    shape = trimesh.creation.box((1, 1, 1))
    shape.visual = TextureVisuals(material=PBRMaterial(baseColorFactor=[255, 0, 0, 255]))
    document, binary = glb_files.parts(trimesh.Scene([shape]).export(file_type="glb"))
    times, places = np.float32([0, 1]), np.float32([[0, 0, 0], [2, 0, 0]])
    for numbers, kind in ((times, "SCALAR"), (places, "VEC3")):
        view = {"buffer": 0, "byteOffset": len(binary), "byteLength": numbers.nbytes}
        document["bufferViews"].append(view)
        accessor = {"bufferView": len(document["bufferViews"]) - 1, "componentType": 5126}
        bounds = {"min": [0], "max": [1]} if kind == "SCALAR" else {}
        document["accessors"].append(accessor | {"count": 2, "type": kind} | bounds)
        binary += numbers.tobytes()
    document["buffers"][0]["byteLength"] = len(binary)
    last = len(document["accessors"])
    node = next(i for i, node in enumerate(document["nodes"]) if "mesh" in node)
    document["nodes"][node].pop("matrix", None)
    document["animations"] = [
        {
            "name": "slide",
            "samplers": [{"input": last - 2, "output": last - 1}],
            "channels": [{"sampler": 0, "target": {"node": node, "path": "translation"}}],
        }
    ]
    path.write_bytes(glb_files.built(document, binary))


_FBX = """; FBX 7.4.0 project file
FBXHeaderExtension:  {
\tFBXVersion: 7400
}
Objects:  {
\tGeometry: 1000, "Geometry::", "Mesh" {
\t\tVertices: *9 {
\t\t\ta: -1,-1,0,1,-1,0,0,1,0
\t\t}
\t\tPolygonVertexIndex: *3 {
\t\t\ta: 0,1,-3
\t\t}
\t}
\tModel: 2000, "Model::triangle", "Mesh" {
\t}
\tMaterial: 3000, "Material::green", "" {
\t\tShadingModel: "phong"
\t\tProperties70:  {
\t\t\tP: "DiffuseColor", "Color", "", "A",0,1,0
\t\t}
\t}
}
Connections:  {
\tC: "OO",2000,0
\tC: "OO",1000,2000
\tC: "OO",3000,2000
}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two splat files, three generators, a tileset, a denoiser, and meshes in each format."""
    folder = tmp_path_factory.mktemp("scene")
    write_ply(folder / "knot.ply", torus_knot(600, degree=1))
    write_spz(folder / "knot.spz", torus_knot(500, degree=1))
    build([folder / "knot.ply"], folder / "tiles", replace(SMALL, leaf=200))
    for case in kit_cases():
        if case.name in _GENERATORS:
            case.spec().write(folder / f"{case.name}.onnx")
    checkpoint = write_denoiser(folder / "checkpoint", {"block_out_channels": [8, 8]})
    denoiser = ("--checkpoint", checkpoint, "--size", "any", "-o", folder / "denoiser.onnx")
    result = gsgen_here("export", "denoiser", *denoiser)
    assert result.code == 0, result.err
    box = trimesh.creation.box((2, 2, 2))
    ball = trimesh.creation.icosphere(subdivisions=1)
    checkered(box.copy()).export(folder / "box.glb")
    checkered(box.copy()).export(folder / "box.obj")
    for name, content in trimesh.exchange.gltf.export_gltf(
        trimesh.Scene([checkered(box.copy())])
    ).items():
        (folder / name.replace("model", "box")).write_bytes(content)
    for name in ("colored.glb", "colored.ply", "colored.obj"):
        colored(ball.copy()).export(folder / name)
    for name in ("grey.glb", "grey.obj", "grey.stl"):
        ball.export(folder / name)
    animated_glb(folder / "slide.glb")
    (folder / "triangle.fbx").write_text(_FBX)
    return folder


@pytest.fixture(scope="module")
def page(site: pages.WebSite, folder: Path) -> Iterator[Any]:
    for path in folder.rglob("*"):
        if path.is_file():
            site.contents[f"/{path.relative_to(folder).as_posix()}"] = path.read_bytes()
    site.contents["/meshes.html"] = _PAGE
    site.open("/meshes.html")
    site.page.wait_for_function("Boolean(customElements.get('gsgen-scene'))")
    yield site.page
    site.open()


def save(path: Path, image: np.ndarray) -> None:
    Image.fromarray((255 * np.clip(image, 0, 1)).astype(np.uint8)).resize(
        (4 * WIDTH, 4 * HEIGHT), Image.Resampling.NEAREST
    ).save(path)


_TIMELINE: dict[str, Any] = {
    "models": [
        "knot.ply",
        {
            "path": "knot.spz",
            "translate": [1.5, 0.5, 1],
            "rotate": {"axis": [1, 2, 3], "degrees": 40},
            "scale": [0.6, 0.8, 0.5],
            "opacity_scale": 0.7,
        },
        {
            "path": "time-in-seconds.onnx",
            "translate": [-1.5, 0, 0],
            "inputs": {"time": {"keys": [{"at": 0, "value": 3}, {"at": 2, "value": 9}]}},
        },
        {"path": "count-changes.onnx", "translate": [0, 1, -1]},
        {"path": "tiles/tileset.json", "translate": [-1, 1.5, 1], "scale": 0.6},
        {"path": "view-row.onnx", "rotate": [0.9, 0.1, 0.2, 0], "scale": 1.2},
    ],
    "meshes": [
        {
            "path": "box.glb",
            "rotate": {"axis": [1, 2, 3], "degrees": 40},
            "scale": 0.7,
            "translate": [0.5, 0, 0.3],
        }
    ],
    "posts": ["denoiser.onnx"],
    "background": [0.1, 0.2, 0.3],
    "camera": {"keys": [{"at": 0, "value": _EYES[0]}, {"at": 2, "value": _EYES[1]}]},
    "fov": 40,
}


def test_a_scene_with_everything_is_drawn_like_python(
    page: Any, site: pages.WebSite, folder: Path, renderer: Renderer, tmp_path: Path
) -> None:
    """At three times, with the denoiser and without; see the pictures with --basetemp."""
    result = shown(site, _TIMELINE)
    assert result["errors"] == result["warnings"] == []
    results = []
    images = rendered(folder, _TIMELINE, renderer, frames=3)
    plain = rendered(folder, _TIMELINE | {"posts": []}, renderer, frames=3)
    assert max(map(decibels, images, plain)) < _WHOLE - 10
    for number, expected in enumerate(images):
        actual = picture(page, float(number))
        save(tmp_path / f"{number}-page.png", actual)
        save(tmp_path / f"{number}-python.png", expected)
        results.append(decibels(actual, expected))
    assert min(results) >= _WHOLE, results
    splats = {**_TIMELINE, "meshes": [], "posts": []}
    shown(site, splats)
    images = rendered(folder, splats, renderer, frames=3)
    results = [decibels(picture(page, float(i)), image) for i, image in enumerate(images)]
    assert min(results) >= _SPLATS, results


@pytest.mark.parametrize(
    "names",
    [
        ("box.glb", "box.gltf", "box.obj"),
        ("colored.glb", "colored.ply", "colored.obj"),
        ("grey.glb", "grey.obj", "grey.stl"),
    ],
)
def test_meshes_of_each_format_have_the_colours_of_python(
    page: Any,
    site: pages.WebSite,
    folder: Path,
    renderer: Renderer,
    tmp_path: Path,
    names: tuple[str, ...],
) -> None:
    """The first with a headlight, or without, other than its file says."""
    other = "unlit" if names[0].startswith("grey") else "headlight"
    document = {
        "meshes": [
            {
                "path": name,
                "translate": [2.4 * i - 2.4, 0, 0],
                "rotate": {"axis": [3, 2, 1], "degrees": 50},
            }
            | ({"shading": other} if i == 0 else {})
            for i, name in enumerate(names)
        ],
        "camera": "look-at:0.4,-1.2,-8,0,0,0",
        "fov": 40,
    }
    result = shown(site, document)
    assert result["errors"] == result["warnings"] == []
    [expected] = rendered(folder, document, renderer)
    actual = picture(page)
    save(tmp_path / "page.png", actual)
    save(tmp_path / "python.png", expected)
    assert expected.std() > 0.1
    assert decibels(actual, expected) >= _WHOLE
    # Beside edges, where one sample decides, nothing differs by more than texels are rounded.
    assert np.median(np.abs(actual - expected).max(axis=2)[expected.sum(axis=2) > 0]) < 0.004


def test_meshes_move_fade_and_hide(page: Any, site: pages.WebSite, folder: Path) -> None:
    """Animations, opacity and visibility, and the scene file of what is shown."""
    document = {
        "models": [{"path": "knot.ply", "visible": False}],
        "meshes": [
            {"path": "slide.glb", "animation": "slide"},
            {"path": "box.glb", "translate": [0, 0, 3], "scale": 2, "visible": False},
        ],
        "background": "white",
        "camera": "look-at:0,0,-8,0,0,0",
    }
    result = shown(site, document)
    assert result["errors"] == []
    assert result["duration"] == pytest.approx(1)

    def red() -> np.ndarray:
        """Return how red each column is: glTF's right is the left of the picture."""
        image = picture(page, moment)
        return np.clip(image[..., 0] - image[..., 1], 0, 1).sum(axis=0)

    columns = np.arange(WIDTH)
    moment = 0.0
    first = red()
    moment = 0.5
    second = red()
    assert (first @ columns) / first.sum() == pytest.approx(WIDTH / 2 - 0.5, abs=0.5)
    assert (second @ columns) / second.sum() < WIDTH / 2 - 4
    assert second.sum() == pytest.approx(first.sum(), rel=0.1)
    scene = "document.querySelector('gsgen-scene')"
    page.evaluate(f"{scene}.stage.meshes[0].opacity = 0.5; null")
    assert red().sum() == pytest.approx(second.sum() / 2, rel=0.1)
    page.evaluate(
        f"""(() => {{
          const [slide, box] = {scene}.stage.meshes;
          slide.isVisible = false;
          box.isVisible = true;
          box.transform = box.transform.with(3, 0.25);
          {scene}.stage.entries[0].isVisible = true;
        }})()"""
    )
    assert picture(page, moment).min() < 0.5  # of the box
    written = json.loads(page.evaluate(f"JSON.stringify({scene})"))
    assert [mesh["path"] for mesh in written["meshes"]] == ["slide.glb", "box.glb"]
    slide, box = written["meshes"]
    assert (slide["opacity_scale"], slide["visible"], slide["animation"]) == (0.5, False, "slide")
    assert box["transform"][0] == [2, 0, 0, 0.25]
    assert "visible" not in box
    assert "visible" not in written["models"][0]
    assert page.evaluate(f"{scene}.pick(48, 32).then((hit) => hit.point[2])") == pytest.approx(1)


def test_pages_draw_fbx(page: Any, site: pages.WebSite) -> None:
    result = shown(site, {"meshes": ["triangle.fbx"], "camera": "look-at:0,0,-4,0,0,0"})
    assert result["errors"] == []
    image = picture(page)
    assert (image[..., 1] > 0.99).mean() > 0.09
    assert image[..., 0].max() < 0.01


def test_annotations_of_a_scene_file_stand_at_their_points(page: Any, site: pages.WebSite) -> None:
    document = {
        "models": ["knot.ply"],
        "camera": "look-at:0,0,-8,0,0,0",
        "annotations": [
            {"position": [0, 0, 0], "text": "middle"},
            {"position": [1, 0, 0], "text": "right", "camera": "look-at:8,0,0,0,0,0"},
            {"position": [0, 0, 0], "text": "behind", "normal": [0, 0, 1]},
        ],
    }
    result = shown(site, document)
    assert result["errors"] == result["warnings"] == []
    scene = "document.querySelector('gsgen-scene')"
    script = f"""() => [...{scene}.shadowRoot.querySelectorAll("[part=annotation]")].map((label) => {{
      const {{ left, width }} = label.getBoundingClientRect();
      const isShown = label.checkVisibility();
      return [label.textContent, isShown, left + width / 2 - {scene}.getBoundingClientRect().left];
    }})"""
    middle, right, behind = page.evaluate(script)
    assert middle == ["middle", True, pytest.approx(WIDTH / 2, abs=1)]
    assert right[:2] == ["right", True]
    assert right[2] > WIDTH / 2 + 5
    assert behind[:2] == ["behind", False]
    page.evaluate(f"""{scene}.shadowRoot.querySelector("button[part=annotation]").click()""")
    assert page.evaluate(f"{scene}.orbit.radius") == pytest.approx(8)
    assert (
        json.loads(page.evaluate(f"JSON.stringify({scene})"))["annotations"]
        == (document["annotations"])
    )


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        ({"path": "knot.ply"}, "is a PLY of splats, expected a mesh"),
        ({"path": "slide.glb", "animation": "slid"}, "is no animation of slide.glb"),
        ({"path": "none.glb"}, "cannot be loaded"),
    ],
)
def test_meshes_that_cannot_be_drawn_are_errors(
    page: Any, site: pages.WebSite, mesh: dict[str, Any], message: str
) -> None:
    [error] = shown(site, {"models": ["knot.ply"], "meshes": [mesh]})["errors"]
    assert message in error["message"]


def test_commands_bring_three_where_a_scene_has_meshes(
    browser: Any, folder: Path, renderer: Renderer, ort_folder: Path, tmp_path: Path
) -> None:
    """Served, and in a file that opens from disk: with materials and textures of the mesh."""
    document = {
        "models": ["knot.ply"],
        "meshes": ["box.obj", {"path": "box.gltf", "translate": [2, 1, 1]}],
        "background": "white",
        "camera": _EYES[0],
        "fov": 40,
    }
    for path in folder.iterdir():
        if path.is_file():
            (tmp_path / path.name).write_bytes(path.read_bytes())
    [expected] = rendered(tmp_path, document, renderer)
    target, scene = tmp_path / "scene.html", tmp_path / "scene.json"
    three = package(THREE)
    result = gsgen_here("export", "html", scene, "-o", target, "--three", three)
    assert result.code == 0, result.err
    context = browser.new_context(viewport={"width": 300, "height": 200})
    page = context.new_page()
    page.set_default_timeout(90_000)
    ready = "document.querySelector('gsgen-scene')?.report"
    server = ModelServer([scene], ModelView(play=False), ort=None, three=three)
    with pages.running(server) as address:
        for location in (target.as_uri(), address):
            page.goto(location)
            page.wait_for_function(ready)
            assert page.evaluate(f"{ready}.errors") == []
            assert decibels(picture(page), expected) >= _WHOLE
    context.close()
