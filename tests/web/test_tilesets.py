"""Tilesets in a page: the tiles that Python selects, from servers that are slow or wrong."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.formats import Splats, open_splats, write_ply, write_sog
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.tiles.format.tileset import Z_UP_FROM_Y_UP
from gsgen.tiles.gltf.container import open_content
from gsgen.tiles.gltf.decoding import decode_content
from gsgen.tiles.loading.tileset_loader import load_tileset, open_tileset
from gsgen.tiles.selection.cut import cut_tree
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.serving.faults import NetworkFaults
from gsgen.tiles.stores.opening import open_store
from support.browser import CUT, FlakyBytes
from support.tiles import foreign_tiles as foreign
from support.tiles.builds import SMALL, build
from support.tiles.level_scenes import knot
from support.tiles.serving import served
from support.web.pages import WebSite, unpacked
from support.web.scenes import camera_of

pytestmark = pytest.mark.slow


_SIZE = {"width": 80, "height": 60}
CAMERAS = (
    Camera.look_at([0, -9, 2], [0, 0, 0], up=(0, 0, 1), **_SIZE),
    Camera.look_at([0.5, -1.5, 0.3], [1.5, 0, 0], up=(0, 0, 1), **_SIZE),
)
"""From afar, and near one side."""
MAX_ERROR = 8.0
_SLOT_ROWS = 4096


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tiles")
    write_ply(folder / "knot.ply", knot(5_000, degree=1))
    build([folder / "knot.ply"], folder / "tiles", replace(SMALL, leaf=900))
    return folder / "tiles"


def frames_of(
    site: WebSite, address: str, cameras: Sequence[Camera] = CAMERAS, **options: float
) -> Any:
    options = {"maxError": MAX_ERROR, "maxSplats": 10 * _SLOT_ROWS, **options}
    cameras = [camera_of(camera) for camera in cameras]
    return site.call("tilesetFrames", f"{address}/tileset.json", cameras, options)


def expected_sets(folder: Path, camera: Camera) -> dict[str, list[SplatSet]]:
    """Return the sets of each content that Python's selection draws, by uri."""
    store, index = open_store(folder)
    tileset = load_tileset(store, index)
    tree = TileTree.of_tileset(tileset, store)
    cut = cut_tree(tree, Frustum.from_camera(camera, tileset.transform), MAX_ERROR)
    sets = {}
    for row in np.flatnonzero(cut.selected):
        for content in tree.tiles[row].contents:
            container = open_content((folder / content.uri).read_bytes(), content.uri)
            frame = tileset.transform @ tree.tiles[row].transform @ Z_UP_FROM_Y_UP
            sets[content.uri] = [
                SplatSet(SplatData.from_splats(splats), frame @ matrix)
                for splats, matrix in decode_content(container, content.uri)
            ]
    return sets


def test_a_page_draws_the_tiles_that_python_selects(
    folder: Path, site: WebSite, renderer: Renderer
) -> None:
    """From a slow server; while tiles arrive, frames are drawn and no GPU objects are made."""
    with served(folder, NetworkFaults(bytes_per_second=200_000, latency=0.02), cors="*") as address:
        result = frames_of(site, address)
    assert (result["failures"], result["errors"]) == ([], [])
    counts = set()
    for camera, frame in zip(CAMERAS, result["frames"], strict=True):
        sets = expected_sets(folder, camera)
        assert frame["drawn"] == sorted(sets)
        counts.add(len(sets))
        drawing = renderer.draw(Scene([part for parts in sets.values() for part in parts]), camera)
        words = renderer.device.read(drawing.image, np.float32, 4 * camera.width * camera.height)
        np.testing.assert_allclose(unpacked(frame["image"], np.float32), words, atol=1e-4)
        assert frame["created"] == []
    assert len(counts) == len(CAMERAS)
    assert set(result["frames"][1]["levels"]) == {1}  # the coarse tile stands in for eight finer


def test_a_budget_keeps_coarser_tiles(folder: Path, site: WebSite) -> None:
    with served(folder, cors="*") as address:
        result = frames_of(site, address, maxSplats=3 * _SLOT_ROWS)
    assert result["failures"] == []
    far, near = result["frames"]
    assert far["drawn"] == sorted(expected_sets(folder, CAMERAS[0]))
    assert near["drawn"] == far["drawn"]  # its eight finer tiles do not fit
    assert near["live"] > 0


def test_tiles_of_a_known_path_come_before_they_are_seen_and_fade_in(
    folder: Path, site: WebSite
) -> None:
    """A second tileset takes half of the slots, until it goes."""
    distant = Camera.look_at([0, -90, 20], [0, 0, 0], up=(0, 0, 1), **_SIZE)
    cameras = [camera_of(camera) for camera in (distant, CAMERAS[1])]
    options = {"maxError": MAX_ERROR, "maxSplats": 20 * _SLOT_ROWS}
    with served(folder, cors="*") as address:
        result = site.call("knownPathAndBudget", f"{address}/tileset.json", cameras, options)
    assert (result["failures"], result["errors"]) == ([], [])
    alone, ahead, arrived = (result[name] for name in ("alone", "ahead", "arrived"))
    assert (alone["missing"], alone["held"]) == (0, 1)
    assert ahead["held"] > alone["held"]
    assert (arrived["missing"], arrived["holes"]) == (0, 0)
    assert arrived["received"] == ahead["received"]
    during, after = result["fades"]
    assert len(during) > len(after)  # what is replaced is drawn, too
    assert any(0 < opacity < 1 for opacity in during)
    assert set(after) == {1}
    assert [state["slots"] for state in result["shared"]] == [10, 10, 1]
    assert result["again"]["slots"] == alone["slots"] == 20


_ELEMENTS = """async ([address, slots]) => {
  const until = async (condition) => {
    for (let i = 0; i < 600 && !condition(); i++) await new Promise((resolve) => setTimeout(resolve, 20));
  };
  const element = (tag, attributes) => {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    document.body.append(made);
    return made;
  };
  const model = { "max-splats": 4096 * slots, "max-error": 8, "camera-orbit": "0deg 10deg 9", background: "#fff" };
  const first = element("gsgen-model", { ...model, src: address });
  const second = element("gsgen-model", { ...model, src: address });
  const models = [{ path: address }, { path: address, visible: false }];
  const scene = element("gsgen-model", { ...model, src: JSON.stringify({ models, up: "+z" }), hidden: "", loading: "eager" });
  await Promise.all([first, second, scene].map(({ ready }) => ready));
  const own = [first, second].map(({ _shown }) => _shown.model);
  const all = [...own, ...scene._shown.model.entries.map(({ model }) => model)];
  const shares = () => all.map(({ sets }) => sets.length);
  const settled = (expected) => until(() => shares().join() === expected.join() && !own.some(({ loading }) => loading));
  const results = {};
  const step = async (name, change, expected) => {
    change();
    await settled(expected);
    results[name] = shares();
  };
  const [whole, half, third] = [slots, slots / 2, slots / 3];
  await step("both in view", () => {}, [half, half, 1, 1]);
  const seen = await (await second.toBlob()).bytes();
  await step("hidden", () => (second.hidden = true), [whole, 1, 1, 1]);
  const requests = performance.getEntriesByType("resource").length;
  second.cameraOrbit = "90deg 0deg 1"; // asks for no tiles out of view
  await new Promise((resolve) => setTimeout(resolve, 300));
  results.asked = performance.getEntriesByType("resource").length - requests;
  second.cameraOrbit = model["camera-orbit"];
  await step("back", () => (second.hidden = false), [half, half, 1, 1]);
  const again = await (await second.toBlob()).bytes();
  results.isSame = seen.length === again.length && seen.every((byte, i) => byte === again[i]);
  await step("not displayed", () => (second.style.display = "none"), [whole, 1, 1, 1]);
  const see = second._see.bind(second);
  second._see = (isVisible) => {
    second.requestFrame(); // as turning elements do: the frame comes when they are away
    see(isVisible);
  };
  await step("shown again", () => (second.style = ""), [half, half, 1, 1]);
  await step("scrolled away", () => (second.style = "position: absolute; top: 9000px"), [whole, 1, 1, 1]);
  await new Promise((resolve) => setTimeout(resolve, 300));
  results["and later"] = shares();
  await second.toBlob({ width: 8, height: 8 });
  await step("with a picture", () => {}, [whole, 1, 1, 1]);
  await step("scrolled to", () => scrollTo(0, 9000), [1, whole, 1, 1]);
  await step("scrolled back", () => scrollTo(0, 0), [whole, 1, 1, 1]);
  await step("a scene", () => (scene.hidden = false), [half, 1, half, 1]);
  await step("a model of it", () => {
    scene._shown.model.entries[1].isVisible = true;
    scene.requestFrame();
  }, [third, 1, third, third]);
  await step("removed", () => [second, scene].forEach((other) => other.remove()), [whole, 1, 1, 1]);
  first.remove();
  return results;
}"""


def test_elements_out_of_view_give_their_slots_to_the_others(folder: Path, site: WebSite) -> None:
    """They keep one, request nothing, and show the same picture when they are back."""
    slots = 24
    site.contents["/shares.html"] = b"""<!doctype html><meta charset=utf-8>
      <style>gsgen-model { width: 64px; height: 48px; aspect-ratio: auto }</style>
      <script type=module src=/client/gsgen.js></script>"""
    site.open("/shares.html")
    site.page.wait_for_function("Boolean(customElements.get('gsgen-model'))")
    with served(folder, cors="*") as address:
        result = site.page.evaluate(_ELEMENTS, [f"{address}/tileset.json", slots])
    assert site.errors == []
    site.open()
    assert (result.pop("asked"), result.pop("isSame")) == (0, True)
    alone = [slots, 1, 1, 1]
    assert result == {
        "both in view": [slots // 2, slots // 2, 1, 1],
        "hidden": alone,
        "back": [slots // 2, slots // 2, 1, 1],
        "not displayed": alone,
        "shown again": [slots // 2, slots // 2, 1, 1],
        "scrolled away": alone,
        "and later": alone,
        "with a picture": alone,
        "scrolled to": [1, slots, 1, 1],
        "scrolled back": alone,
        "a scene": [slots // 2, 1, slots // 2, 1],
        "a model of it": [slots // 3, 1, slots // 3, slots // 3],
        "removed": alone,
    }


def test_tiles_are_kept_where_a_server_does_not_say_for_how_long(
    folder: Path, site: WebSite
) -> None:
    """A second visit asks for what is named by its bytes again only if the server forbids more."""
    files = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*.*")}
    for base, headers in (("/kept", {}), ("/fresh", {"Cache-Control": "no-cache"})):
        for name, path in files.items():
            site.contents[f"{base}/{name}"] = path.read_bytes()
            site.headers[f"{base}/{name}"] = headers
        for visit in range(2):
            site.requests.clear()
            frames_of(site, site.address + base, CAMERAS[:1])
            asked = [name for name in site.requests if name.endswith(".glb")]
            assert bool(asked) is (visit == 0 or bool(headers))
    # What a server sends in place of a tile is not kept.
    uri = min(expected_sets(folder, CAMERAS[0]))
    site.contents |= {f"/mended/{name}": path.read_bytes() for name, path in files.items()}
    site.contents[f"/mended/{uri}"] = b"<!doctype html>"
    assert frames_of(site, f"{site.address}/mended", CAMERAS[:1])["failures"]
    site.contents[f"/mended/{uri}"] = files[uri].read_bytes()
    assert frames_of(site, f"{site.address}/mended", CAMERAS[:1])["failures"] == []


def test_damaged_tile_is_reported_and_others_are_drawn(
    folder: Path, site: WebSite, tmp_path: Path
) -> None:
    tiles = tmp_path / "tiles"
    tiles.mkdir()
    for path in filter(Path.is_file, folder.rglob("*")):
        copy = tiles / path.relative_to(folder)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(path.read_bytes())
    uri = max(expected_sets(folder, CAMERAS[1]))
    (tiles / uri).write_bytes((folder / uri).read_bytes()[:-40])
    with served(tiles, cors="*") as address:
        result = frames_of(site, address, CAMERAS[1:])
    [failure] = result["failures"]
    assert uri in failure
    assert "expected" in failure
    [frame] = result["frames"]
    assert frame["live"] > 0
    assert uri not in frame["drawn"]


_FAULTS = {
    # The first answers of a server for a tile, and how often it is asked.
    "busy": ([503], 2),
    "twice busy": ([503, 503], 3),
    "three faults": ([500, 502, 504], 4),
    "too many requests": ([429], 2),
    "a timeout": ([408], 2),
    "cut off": ([CUT], 2),
    "busy, then cut off": ([503, CUT], 3),
    "busy for long": ([503] * 9, 4),
    "missing": ([404] * 9, 1),
    "gone": ([410] * 9, 1),
    "forbidden": ([403] * 9, 1),
}


def test_a_tile_is_asked_for_again_where_that_may_help(folder: Path, site: WebSite) -> None:
    """After faults of the network and the server, four times at most; what is left is reported."""
    files = {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }
    uri = max(expected_sets(folder, CAMERAS[0]))
    for number, (name, (failures, attempts)) in enumerate(_FAULTS.items()):
        base = f"/flaky/{number}"
        site.contents.update({f"{base}/{file}": content for file, content in files.items()})
        site.contents[f"{base}/{uri}"] = FlakyBytes.of(files[uri], failures)
        site.requests.clear()
        result = frames_of(site, site.address + base, CAMERAS[:1])
        assert site.requests.count(f"{base}/{uri}") == attempts, name
        [frame] = result["frames"]
        assert (uri in frame["drawn"]) is (attempts == len(failures) + 1), name
        assert len(result["failures"]) == (uri not in frame["drawn"]), name


def test_a_tile_may_hold_another_tileset(folder: Path, site: WebSite, tmp_path: Path) -> None:
    """Of a tileset that a tile moves, a page draws what it draws of the tileset alone."""
    shutil.copytree(folder, tmp_path / "inner")
    inner = json.loads((folder / "tileset.json").read_text("utf-8"))
    moved = Camera.look_at([3, -9, 2], [3, 0, 0], up=(0, 0, 1), **_SIZE)
    root = {
        "boundingVolume": {"sphere": [0, 0, 0, 9]},
        "transform": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3, 0, 0, 1],
        "geometricError": 1e-3,
        "refine": "REPLACE",
        "content": {"uri": "inner/tileset.json"},
    }
    outer_tileset = {
        "asset": inner["asset"],
        "geometricError": inner["geometricError"],
        "root": root,
    }
    (tmp_path / "tileset.json").write_text(json.dumps(outer_tileset), "utf-8")
    with served(tmp_path, cors="*") as address, served(folder, cors="*") as alone:
        [frame] = frames_of(site, address, [moved])["frames"]
        [expected] = frames_of(site, alone, CAMERAS[:1])["frames"]
    assert frame["drawn"] == expected["drawn"]
    pictures = [unpacked(text, np.float32) for text in (frame["image"], expected["image"])]
    assert np.ptp(pictures[1]) > 0.1
    np.testing.assert_allclose(pictures[0], pictures[1], atol=1e-4)


@pytest.fixture(scope="module")
def implicit_folder(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("implicit")
    build([folder.parent / "knot.ply"], target / "tiles", replace(SMALL, leaf=900, implicit=True))
    return target / "tiles"


def test_a_page_draws_the_implicit_tiles_that_python_selects(
    implicit_folder: Path, site: WebSite, renderer: Renderer
) -> None:
    with served(implicit_folder, cors="*") as address:
        result = frames_of(site, address)
    assert (result["failures"], result["errors"]) == ([], [])
    for camera, frame in zip(CAMERAS, result["frames"], strict=True):
        sets = expected_sets(implicit_folder, camera)
        assert frame["drawn"] == sorted(sets)
        drawing = renderer.draw(Scene([part for parts in sets.values() for part in parts]), camera)
        words = renderer.device.read(drawing.image, np.float32, 4 * camera.width * camera.height)
        np.testing.assert_allclose(unpacked(frame["image"], np.float32), words, atol=1e-4)


@pytest.mark.parametrize("is_implicit", [False, True], ids=["explicit", "implicit"])
def test_a_page_draws_coarse_files_first_and_the_finest_in_the_end(
    is_implicit: bool, folder: Path, site: WebSite, renderer: Renderer, tmp_path: Path
) -> None:
    """The root's coarsest file comes alone, each coarsest file before its finest."""
    parameters = replace(SMALL, leaf=900, qualities=(0, 2, 4), implicit=is_implicit)
    build([folder.parent / "knot.ply"], tmp_path, parameters)
    base = f"/qualities-{is_implicit}"
    files = {path.relative_to(tmp_path).as_posix(): path for path in tmp_path.rglob("*.*")}
    site.contents.update({f"{base}/{name}": path.read_bytes() for name, path in files.items()})
    site.requests.clear()
    result = frames_of(site, site.address + base, CAMERAS[:1])
    assert (result["failures"], result["errors"]) == ([], [])
    asked = [uri.removeprefix(f"{base}/") for uri in site.requests if uri.endswith(".glb")]
    tiles = [tile for tile in open_tileset(tmp_path).tiles() if tile.contents]
    assert asked[0] == tiles[0].files[2]
    [frame] = result["frames"]
    drawn = [tile for tile in tiles if tile.contents[0].uri in frame["drawn"]]
    for tile in drawn:
        assert [uri for uri in asked if uri in tile.files] == [tile.files[2], tile.files[0]]
    first_fine = next(index for index, uri in enumerate(asked) if uri == drawn[0].files[0])
    assert all(tile.files[2] in asked[:first_fine] for tile in drawn)
    sets = expected_sets(tmp_path, CAMERAS[0])
    assert frame["drawn"] == sorted(sets)
    drawing = renderer.draw(Scene([part for parts in sets.values() for part in parts]), CAMERAS[0])
    words = renderer.device.read(drawing.image, np.float32, 4 * _SIZE["width"] * _SIZE["height"])
    np.testing.assert_allclose(unpacked(frame["image"], np.float32), words, atol=1e-4)


def test_a_page_streams_the_leaves_of_a_lod_meta(
    site: WebSite, renderer: Renderer, tmp_path: Path
) -> None:
    """Each level of a leaf is a tile, all of which come; in the end the finest are drawn."""
    write_sog(tmp_path / "lod-meta.json", knot(9_000, degree=1))
    site.requests.clear()
    for path in filter(Path.is_file, tmp_path.rglob("*")):
        site.contents[f"/lod/{path.relative_to(tmp_path).as_posix()}"] = path.read_bytes()
    cameras = [camera_of(camera) for camera in CAMERAS[:1]]
    options = {"maxError": 0.05, "maxSplats": 40 * _SLOT_ROWS}
    address = f"{site.address}/lod/lod-meta.json"
    result = site.call("tilesetFrames", address, cameras, options)
    assert (result["failures"], result["errors"]) == ([], [])
    asked = [uri for uri in site.requests if uri.endswith("/meta.json")]
    assert {uri.split("/")[2] for uri in asked} == {"0_0", "1_0", "2_0", "3_0"}
    [frame] = result["frames"]
    splats = open_splats(tmp_path / "lod-meta.json")
    assert isinstance(splats, Splats)
    assert frame["live"] == len(splats)
    upright = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    scene = Scene([SplatSet(SplatData.from_splats(splats), upright)])
    drawing = renderer.draw(scene, CAMERAS[0])
    words = renderer.device.read(drawing.image, np.float32, 4 * _SIZE["width"] * _SIZE["height"])
    np.testing.assert_allclose(unpacked(frame["image"], np.float32), words, atol=1e-3)


def foreign_tree(folder: Path, rng: np.random.Generator, dimensions: int) -> Path:
    """Write a random implicit tree of two to three subtrees of two levels, without metadata."""
    names = "".join(f".{{{axis}}}" for axis in "xyz"[:dimensions])
    branching = 2**dimensions
    child_numbers = [int(k) for k in rng.permutation(branching)[:2]]  # tiles of the second level
    hanging_nodes = {branching * k + int(rng.integers(branching)) for k in child_numbers}
    tiles = {0} | {1 + k for k in child_numbers}
    files: dict[str, bytes] = {
        f"s/0{'.0' * dimensions}.subtree": foreign.subtree(
            2, branching, tiles, tiles, hanging_nodes
        )
    }
    for number in hanging_nodes:
        cells = [
            2 * (number // branching >> axis & 1) + (number % branching >> axis & 1)
            for axis in range(dimensions)
        ]
        leaves = {0, *(1 + int(k) for k in rng.permutation(branching)[:2])}
        name = f"s/2{''.join(f'.{cell}' for cell in cells)}.subtree"
        files[name] = foreign.subtree(2, branching, leaves, leaves - {0}, set())
    root = {
        "boundingVolume": {"box": [1, 2, 3, 9, 1, 0, -1, 8, 0, 0, 0, 7]},
        "geometricError": 64,
        "refine": "REPLACE",
        "content": {"uri": f"{{level}}{names}.glb"},
        "implicitTiling": {
            "subdivisionScheme": "OCTREE" if dimensions == 3 else "QUADTREE",
            "subtreeLevels": 2,
            "availableLevels": 4,
            "subtrees": {"uri": f"s/{{level}}{names}.subtree"},
        },
    }
    return foreign.write(folder, files | {"tileset.json": foreign.tileset(root)})


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_implicit_trees_have_the_tiles_of_python(
    seed: int, dimensions: int, site: WebSite, tmp_path: Path
) -> None:
    path = foreign_tree(tmp_path, np.random.default_rng(seed), dimensions)
    with served(path.parent, cors="*") as address:
        actual = site.call("implicitTiles", f"{address}/tileset.json")
    tiles = list(open_tileset(path).tiles())
    expected = {
        (
            tuple(content.uri for content in tile.contents),
            *np.round([*tile.volume.center, *tile.volume.half_axes.ravel()], 9).tolist(),
            tile.geometric_error,
        )
        for tile in tiles
    }
    assert {(tuple(uris), *np.round(box, 9).tolist(), e) for uris, box, e in actual} == expected
    assert len(actual) == len(tiles) > 6


@pytest.mark.parametrize(
    "root",
    [
        {"boundingVolume": {"region": [0, 0, 1, 1, 0, 9]}},
        {"boundingVolume": {"sphere": [0, 0, 0, 1]}, "implicitTiling": {}},
    ],
)
def test_volumes_that_pages_do_not_read_are_named(root: Any, site: WebSite) -> None:
    site.contents["/tileset.json"] = json.dumps(
        {"asset": {"version": "1.1"}, "root": root}
    ).encode()
    with pytest.raises(Exception, match="has a volume that is not a box"):
        frames_of(site, site.address, CAMERAS[:1])


@pytest.mark.parametrize(
    ("data", "message"),
    [(b"{}", "is not a binary subtree"), (b"subt" + bytes(40), "is not whole")],
    ids=["json", "cut off"],
)
def test_damaged_subtree_is_reported(
    data: bytes, message: str, implicit_folder: Path, site: WebSite, tmp_path: Path
) -> None:
    shutil.copytree(implicit_folder, tmp_path / "tiles")
    [subtree] = (tmp_path / "tiles").rglob("*.subtree")
    subtree.write_bytes(data)
    with served(tmp_path / "tiles", cors="*") as address:
        [failure] = frames_of(site, address, CAMERAS[:1])["failures"]
    assert message in failure
