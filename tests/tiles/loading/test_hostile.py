"""Files that would take all memory or time are refused before they do."""

import gzip
import json
import resource
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from gsgen.tiles.errors import Fault, StoreUnavailable, TilesetInvalid
from gsgen.tiles.format.uris import resolve_uri
from gsgen.tiles.loading.leaves import read_leaves
from gsgen.tiles.loading.tileset_loader import Limits, load_tileset, open_tileset
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.serving.faults import NetworkFaults
from gsgen.tiles.stores.folder_store import FolderStore
from gsgen.tiles.validation.sketches import edit_glb, explicit_sketch
from support.tiles import foreign_tiles as foreign
from support.tiles.serving import served

_ROOM = 700 << 20


def bounded(path: Path) -> subprocess.CompletedProcess[str]:
    """Validate in a process that may take no more than a bound."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_DATA, (_ROOM, _ROOM))

    return subprocess.run(
        [sys.executable, "-m", "gsgen.cli", "validate", str(path), "--json"],
        capture_output=True,
        text=True,
        preexec_fn=limit,
        timeout=120,
    )


def leaf(uri: str) -> dict[str, object]:
    return {
        "boundingVolume": foreign.box(100),
        "geometricError": 0,
        "refine": "ADD",
        "content": {"uri": uri},
    }


def implicit(**changes: object) -> bytes:
    tiling = {
        "subdivisionScheme": "OCTREE",
        "subtreeLevels": 3,
        "availableLevels": 20,
        "subtrees": {"uri": "s.json"},
    }
    root = leaf("t.glb") | {"implicitTiling": tiling | changes}
    return foreign.tileset(root)


def test_a_tree_of_all_tiles_is_refused_by_their_number(tmp_path: Path) -> None:
    """Every subtree says that all tiles and all subtrees are there: 8^21 tiles."""
    full = {
        "tileAvailability": {"constant": 1},
        "contentAvailability": [{"constant": 1}],
        "childSubtreeAvailability": {"constant": 1},
    }
    files = {"tileset.json": implicit(availableLevels=21, subtrees={"uri": "{level}.json"})}
    for level in range(0, 21, 3):
        last = {"childSubtreeAvailability": {"constant": int(level < 18)}}
        files[f"{level}.json"] = json.dumps(full | last).encode()
    path = foreign.write(tmp_path, files | {"t.glb": foreign.gltf(foreign.cloud(0))})
    strict_limits = Limits(tiles=5000)
    with FolderStore(tmp_path) as store, pytest.raises(TilesetInvalid, match="more than 5,000"):
        load_tileset(store, path.name, limits=strict_limits)


def test_subtrees_are_bounded_before_their_bits_are_read(tmp_path: Path) -> None:
    path = foreign.write(tmp_path, {"tileset.json": implicit(subtreeLevels=20)})
    with pytest.raises(TilesetInvalid, match="subtreeLevels"):
        open_tileset(path)


def test_external_tilesets_that_double_are_refused(tmp_path: Path) -> None:
    """Thirty files, each with the next one twice: a billion tiles."""
    files = {}
    for number in range(30):
        lower = [leaf(f"{number + 1}.json")] * 2
        root = {**leaf("x.glb"), "children": lower, "geometricError": 1}
        name = "tileset.json" if not number else f"{number}.json"
        files[name] = foreign.tileset(root)
    files["30.json"] = foreign.tileset(leaf("x.glb"))
    path = foreign.write(tmp_path, files | {"x.glb": foreign.gltf(foreign.cloud(0))})
    strict_limits = Limits(documents=500)
    with FolderStore(tmp_path) as store, pytest.raises(TilesetInvalid, match="more than 500"):
        load_tileset(store, path.name, limits=strict_limits)


def test_a_tileset_within_itself_is_named(tmp_path: Path) -> None:
    files = {"tileset.json": foreign.tileset(leaf("a/b.json"))}
    files["a/b.json"] = foreign.tileset(leaf("../tileset.json"))
    path = foreign.write(tmp_path, files)
    with pytest.raises(TilesetInvalid, match="within itself") as caught:
        open_tileset(path)
    assert caught.value.fault is Fault.URI
    assert "a/b.json, root.content.uri" in caught.value.location


def test_forty_nested_tilesets_are_refused(tmp_path: Path) -> None:
    files = {"tileset.json": foreign.tileset(leaf("0.json"))}
    for number in range(40):
        files[f"{number}.json"] = foreign.tileset(leaf(f"{number + 1}.json"))
    path = foreign.write(tmp_path, files)
    with pytest.raises(TilesetInvalid, match="32 external"):
        open_tileset(path)


def test_thirty_two_within_each_other_are_read(tmp_path: Path) -> None:
    files = {"tileset.json": foreign.tileset(leaf("0.json"))}
    for number in range(31):
        files[f"{number}.json"] = foreign.tileset(leaf(f"{number + 1}.json"))
    files["31.json"] = foreign.tileset(leaf("x.glb"))
    path = foreign.write(tmp_path, files | {"x.glb": foreign.gltf(foreign.cloud(0))})
    assert len(read_leaves(path)) == foreign.COUNT


def test_spz_that_unpacks_to_gigabytes_is_refused(tmp_path: Path) -> None:
    """A header of 2^27 splats, and zeros for as many as gzip packs into a megabyte."""
    header = struct.pack("<IIIBBBB", 0x5053474E, 2, 1 << 27, 0, 12, 0, 0)
    body = gzip.compress(header + bytes(1 << 27), 9, mtime=0)
    content = foreign.spz_glb(foreign.cloud(0))
    size = struct.unpack_from("<I", content, 12)[0]
    document = json.loads(content[20 : 20 + size])
    document["bufferViews"][0]["byteLength"] = len(body)
    document["buffers"][0]["byteLength"] = len(body)
    del document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    files = {"tileset.json": foreign.tileset(leaf("x.glb"), foreign.SPZ)}
    files["x.glb"] = foreign.glb(document, body)
    done = bounded(foreign.write(tmp_path, files))
    assert done.returncode == 1, done.stderr
    assert "GT005" in done.stdout


def test_json_that_nests_is_refused(tmp_path: Path) -> None:
    nested = b'{"a":' * 100_000 + b"1" + b"}" * 100_000
    path = foreign.write(tmp_path, {"tileset.json": nested})
    done = bounded(path)
    assert done.returncode == 4
    assert "nests too deeply" in done.stderr
    tile: dict[str, object] = leaf("x.glb")
    for _ in range(300):
        tile = {**leaf("x.glb"), "children": [tile]}
    path = foreign.write(tmp_path, {"tileset.json": foreign.tileset(tile)})
    with pytest.raises(TilesetInvalid, match="levels of tiles"):
        open_tileset(path)


@pytest.mark.parametrize(
    "uri",
    [
        "../x.glb",
        "a/../../x.glb",
        "%2e%2e/x.glb",
        "/etc/passwd",
        "file:///etc/passwd",
        "https://example.org/x.glb",
        "//example.org/x.glb",
        "C:/x.glb",
        "..\\x.glb",
        "a%00.glb",
        "",
        ".",
        "?x",
    ],
)
def test_uris_that_leave_are_refused(uri: str) -> None:
    with pytest.raises(TilesetInvalid) as caught:
        resolve_uri("tileset.json", uri, "here")
    assert caught.value.fault is Fault.URI


@pytest.mark.parametrize(
    ("base", "uri", "path"),
    [
        ("tileset.json", "t/0/a.glb", "t/0/a.glb"),
        ("a/tileset.json", "../b.glb?v=1#x", "b.glb"),
        ("a/b/c.json", "./d%20e.glb", "a/b/d e.glb"),
        ("tileset.json", "..a.glb", "..a.glb"),
    ],
)
def test_uris_within_are_resolved(base: str, uri: str, path: str) -> None:
    assert resolve_uri(base, uri, "here") == path


def test_a_tile_of_too_many_splats_is_not_decoded(tmp_path: Path) -> None:
    spec = explicit_sketch(codec="khr", record=False)
    uri = spec.document["root"]["content"]["uri"]

    def enlarge(document: dict[str, Any]) -> dict[str, Any]:
        for accessor in document["accessors"]:
            accessor["count"] = 60_000_000
        return document

    spec.files[uri] = edit_glb(spec.files[uri], document=enlarge)
    del spec.document["root"]["metadata"]
    path = tmp_path / "tileset.json"
    spec.write(path)
    done = bounded(path)
    assert done.returncode == 1
    assert "GT005" in done.stdout
    assert "60,000,000 splats" in done.stdout


def test_sixty_thousand_external_tilesets_are_refused_before_the_first_is_read(
    tmp_path: Path,
) -> None:
    root = {**leaf("x.glb"), "children": [leaf(f"{number}.json?v=1") for number in range(60_000)]}
    path = foreign.write(tmp_path, {"tileset.json": foreign.tileset(root)})
    with pytest.raises(TilesetInvalid, match="more than 50,000 JSON") as caught:
        open_tileset(path)
    assert "tileset.json" in caught.value.location


def test_external_tilesets_that_take_long_end_in_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each file is in time, and all of them together are not."""
    monkeypatch.setenv("GSGEN_FETCH_SECONDS", "0.1")
    root = {**leaf("x.glb"), "children": [leaf(f"{number}.json") for number in range(200)]}
    files = {f"{number}.json": foreign.tileset(leaf("x.glb")) for number in range(200)}
    path = foreign.write(tmp_path, {"tileset.json": foreign.tileset(root), **files})
    with (
        served(path.parent, NetworkFaults(latency=0.02)) as address,
        pytest.raises(StoreUnavailable, match=r"reading the tileset took 0\.5 s; \d+ JSON"),
    ):
        open_tileset(f"{address}tileset.json")


@pytest.mark.parametrize("count", [-1, 1 << 70, "many", [1], None, True, 1e300])
@pytest.mark.parametrize("name", ["splats", "bytes"])
def test_declared_counts_of_any_kind_stream(tmp_path: Path, name: str, count: object) -> None:
    entry = {**leaf("x.glb"), "metadata": {"class": "tile", "properties": {name: count}}}
    files = {"tileset.json": foreign.tileset(entry), "x.glb": foreign.gltf(foreign.cloud(0))}
    tileset = open_tileset(foreign.write(tmp_path, files))
    with FolderStore(tmp_path) as store:
        tree = TileTree.of_tileset(tileset, store)
    assert (tree.size >= 0).all()
    assert (tree.splats >= 0).all()
