"""Tilesets that others wrote: counts are exact, and splats stand where they should."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from gsgen.contract.spec.geometry import covariance_upper, symmetric
from gsgen.formats import FormatWarning, read_ply
from gsgen.tiles import validate
from gsgen.tiles.loading.leaves import finest_contents, open_splats, read_contents, read_leaves
from gsgen.tiles.loading.tileset_loader import load_tileset, open_tileset
from gsgen.tiles.stores.opening import open_store
from gsgen.tiles.stores.zip_store import write_archive
from support.commands import ROOT
from support.commands import gsgen as run
from support.tiles import foreign_tiles as foreign

SPLATS = "KHR_gaussian_splatting"
GOLDENS = ROOT / "tests" / "formats" / "goldens"


def on_globe(path: Path) -> np.ndarray:
    """All leaves in the world, through the reader under test."""
    store, index = open_store(path)
    with store:
        tileset = load_tileset(store, index)
        placed = read_contents(store, tileset, finest_contents(tileset))
        parts = [part.positions() for part in placed]
    local = np.concatenate(parts)
    return local @ tileset.transform[:3, :3].T + tileset.transform[:3, 3]


def conforms(path: Path) -> bool:
    report = validate(path)
    assert not [f for f in report.findings if f.certainty == "confirmed"], report.findings
    return report.verdict == "conforms"


def test_explicit_tileset_reads_add_and_replace(tmp_path: Path) -> None:
    parts = {name: foreign.cloud(n) for n, name in enumerate(("coarse", "fine", "more"))}
    files = {f"{name}.glb": foreign.gltf(part) for name, part in parts.items()}
    leaf = {
        "boundingVolume": foreign.box(25),
        "geometricError": 0,
        "content": {"uri": "fine.glb"},
        "refine": "ADD",
    }
    more = {**leaf, "content": {"uri": "more.glb"}}
    files["tileset.json"] = foreign.tileset(
        {
            "boundingVolume": foreign.box(30),
            "geometricError": 100,
            "refine": "REPLACE",
            "content": {"uri": "coarse.glb"},
            "children": [{**leaf, "geometricError": 10, "children": [more]}],
        }
    )
    path = foreign.write(tmp_path, files)
    expected = np.concatenate(
        [foreign.turned_up(parts[name]["position"]) for name in ("fine", "more")]
    )
    leaves = read_leaves(path)
    assert len(leaves) == 2 * foreign.COUNT
    assert np.abs(leaves.position - expected).max() < 1e-5
    assert conforms(path)


@pytest.mark.parametrize("spz", [False, True])
def test_ecef_with_harmonics_and_nested_transforms(tmp_path: Path, spz: bool) -> None:
    """Positions on the globe are within 5 mm of those in extended precision."""
    cloud = foreign.cloud(3, degree=0 if spz else 2)
    cloud["position"] = np.asarray(cloud["position"], np.float32).astype(np.float64)
    node = np.eye(4)
    node[:3, 3] = [120.5, -3.25, 77.0]
    globe = foreign.east_north_up(2.2945, 48.8584, 35.0)
    inner = np.eye(4)
    inner[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    inner[:3, :3] *= 1.5
    inner[:3, 3] = [1000.25, -2000.5, 10.0]
    content = foreign.spz_glb(cloud, node) if spz else foreign.gltf(cloud, matrix=node)
    child = {
        "boundingVolume": foreign.box(300),
        "geometricError": 0,
        "transform": inner.T.ravel().tolist(),
        "content": {"uri": "a%20b/one.glb"},
    }
    root = {
        "boundingVolume": foreign.box(4000),
        "geometricError": 100,
        "refine": "REPLACE",
        "transform": globe.T.ravel().tolist(),
        "children": [child],
    }
    extensions = foreign.SPZ if spz else foreign.GLTF
    path = foreign.write(
        tmp_path, {"tileset.json": foreign.tileset(root, extensions), "a b/one.glb": content}
    )
    positions = foreign.turned_up(foreign.moved_positions(cloud["position"], node))
    expected = foreign.moved_positions(foreign.moved_positions(positions, inner), globe)
    actual = on_globe(path)
    assert actual.shape == (foreign.COUNT, 3)
    assert float(np.abs(actual - expected).max()) < 0.005
    assert conforms(path)


def test_positions_in_ecef_without_a_root_transform(tmp_path: Path) -> None:
    """The place on the globe may stand in the content's node alone: float32 would lose metres."""
    cloud = foreign.cloud(4)
    cloud["position"] = np.asarray(cloud["position"], np.float32).astype(np.float64)
    globe = foreign.east_north_up(139.7, 35.6, 12.0)
    z_up = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    node = z_up.T @ globe @ z_up  # so that the viewer's turn gives the globe's frame
    center = globe[:3, 3]
    root = {
        "boundingVolume": {"sphere": [*center.tolist(), 60.0]},
        "geometricError": 0,
        "refine": "ADD",
        "content": {"uri": "one.glb"},
    }
    path = foreign.write(
        tmp_path,
        {"tileset.json": foreign.tileset(root), "one.glb": foreign.gltf(cloud, matrix=node)},
    )
    expected = foreign.moved_positions(foreign.turned_up(cloud["position"]), globe)
    assert float(np.abs(on_globe(path) - expected).max()) < 0.005
    with pytest.warns(FormatWarning, match="relative to"):
        leaves = read_leaves(path)
    spread = expected - expected.mean(axis=0)
    apart = leaves.position - leaves.position.mean(axis=0)
    assert float(np.abs(spread - apart).max()) < 0.005
    assert conforms(path)


@pytest.mark.parametrize(("scheme", "branching"), [("QUADTREE", 4), ("OCTREE", 8)])
def test_implicit_tileset_gives_exact_tiles_and_splats(
    tmp_path: Path, scheme: str, branching: int
) -> None:
    """Subtrees of two levels, three levels in all; cells are those of the specification."""
    octree = branching == 8
    name = "{level}-{x}-{y}-{z}.glb" if octree else "{level}-{x}-{y}.glb"
    subs = "s/{level}.{x}.{y}.{z}.subtree" if octree else "s/{level}.{x}.{y}.subtree"

    def named(template: str, level: int, cell: tuple[int, ...]) -> str:
        text = template.replace("{level}", str(level))
        for axis, value in zip("xyz", cell, strict=False):
            text = text.replace(f"{{{axis}}}", str(value))
        return text

    # Child 3 of the root is x = y = 1; below it, its child 2 is x = 0, y = 1: cell (2, 3).
    files = {}
    child, leaf = ((1, 1, 0), (2, 3, 0)) if octree else ((1, 1), (2, 3))
    root_sub = named(subs, 0, (0, 0, 0))
    files[root_sub] = foreign.subtree(2, branching, {0, 1 + 3}, {1 + 3}, {3 * branching + 2})
    files[named(subs, 2, leaf)] = foreign.subtree(2, branching, {0}, {0}, set())
    center = np.array([-100 + 50 * (v + 0.5) for v in leaf[:2]] + [0.0])
    if octree:
        center[2] = -100 + 25
    cloud = foreign.cloud(8)
    x, y, z = center
    cloud["position"] = np.asarray(cloud["position"] + [x, z, -y], np.float32).astype(float)
    files[named(name, 1, child)] = foreign.gltf({key: value[::2] for key, value in cloud.items()})
    files[named(name, 2, leaf)] = foreign.gltf(cloud)
    files["tileset.json"] = foreign.tileset(
        {
            "boundingVolume": foreign.box(100),
            "geometricError": 64,
            "refine": "REPLACE",
            "content": {"uri": name},
            "implicitTiling": {
                "subdivisionScheme": scheme,
                "subtreeLevels": 2,
                "availableLevels": 3,
                "subtrees": {"uri": subs},
            },
        }
    )
    path = foreign.write(tmp_path, files)
    tileset = open_tileset(path)
    tiles = list(tileset.tiles())
    assert [tile.level for tile in tiles] == [0, 1, 2]
    assert [tile.geometric_error for tile in tiles] == [64, 32, 16]
    volume = tiles[2].volume
    assert np.allclose(volume.center, center)
    assert np.allclose(np.diag(volume.half_axes), [25, 25, 25 if octree else 100])
    leaves = read_leaves(path)
    assert np.abs(leaves.position - foreign.turned_up(cloud["position"])).max() < 1e-4
    assert conforms(path)


def test_external_tilesets_contents_and_gltf(tmp_path: Path) -> None:
    clouds = [foreign.cloud(n) for n in range(3)]
    inner = foreign.tileset(
        {
            "boundingVolume": foreign.box(30),
            "geometricError": 0,
            "refine": "ADD",
            "contents": [{"uri": "../b.gltf"}, {"uri": "deep/c.glb"}],
        }
    )
    outer_tileset = foreign.tileset(
        {
            "boundingVolume": foreign.box(40),
            "geometricError": 50,
            "refine": "ADD",
            "content": {"uri": "a.glb"},
            "children": [
                {
                    "boundingVolume": foreign.box(35),
                    "geometricError": 20,
                    "content": {"uri": "sub/tileset.json"},
                }
            ],
        }
    )
    path = foreign.write(
        tmp_path,
        {
            "tileset.json": outer_tileset,
            "sub/tileset.json": inner,
            "a.glb": foreign.gltf(clouds[0]),
            "b.gltf": foreign.gltf(clouds[1], embedded=True),
            "sub/deep/c.glb": foreign.gltf(clouds[2]),
        },
    )
    expected = np.concatenate([foreign.turned_up(c["position"]) for c in clouds])
    assert np.abs(read_leaves(path).position - expected).max() < 1e-5
    assert conforms(path)
    archive = tmp_path / "all.3tz"
    write_archive(tmp_path, archive)
    assert np.array_equal(read_leaves(archive).position, read_leaves(path).position)
    assert conforms(archive)


def test_ellipsoids_and_colours_turn_with_the_axes(tmp_path: Path) -> None:
    """Σ and the colour seen from a direction are those of glTF, turned by hand."""
    cloud = foreign.cloud(5, degree=3)
    root = {
        "boundingVolume": foreign.box(40),
        "geometricError": 0,
        "refine": "ADD",
        "content": {"uri": "a.glb"},
    }
    files = {"tileset.json": foreign.tileset(root), "a.glb": foreign.gltf(cloud)}
    leaves = read_leaves(foreign.write(tmp_path, files))
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    wxyz = cloud["rotation"][:, [3, 0, 1, 2]]
    before = symmetric(covariance_upper(cloud["scale"], wxyz))
    after = symmetric(covariance_upper(np.exp(leaves.log_scale), leaves.rotation))
    assert np.abs(after - turn @ before @ turn.T).max() < 1e-6
    from gsgen.contract.spec.spherical_harmonics import evaluate

    rng = np.random.default_rng(1)
    direction = rng.normal(size=(foreign.COUNT, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    actual = evaluate(cloud["sh"], direction)
    assert np.abs(evaluate(leaves.sh, direction @ turn.T) - actual).max() < 1e-5


def test_names_of_drafts_are_read_with_a_notice(tmp_path: Path) -> None:
    cloud = foreign.cloud(6)
    root = {
        "boundingVolume": foreign.box(40),
        "geometricError": 0,
        "refine": "ADD",
        "content": {"uri": "a.glb"},
    }
    content = foreign.gltf(cloud, drafts=True)
    path = foreign.write(tmp_path, {"tileset.json": foreign.tileset(root), "a.glb": content})
    with pytest.warns(FormatWarning, match="_ROTATION, _SCALE"):
        leaves = read_leaves(path)
    assert np.abs(leaves.position - foreign.turned_up(cloud["position"])).max() < 1e-5
    report = validate(path)
    assert {finding.rule for finding in report.findings} == {"GT019"}


def test_convert_writes_all_leaves(tmp_path: Path) -> None:
    cloud = foreign.cloud(7)
    root = {
        "boundingVolume": foreign.box(40),
        "geometricError": 0,
        "refine": "ADD",
        "content": {"uri": "a.glb"},
    }
    files = {"tileset.json": foreign.tileset(root), "a.glb": foreign.gltf(cloud)}
    path = foreign.write(tmp_path, files)
    completed = run("convert", path, tmp_path / "out.ply")
    assert completed.code == 0, completed.err
    expected = foreign.turned_up(cloud["position"])
    assert np.abs(read_ply(tmp_path / "out.ply").position - expected).max() < 1e-5
    assert len(open_splats(tmp_path)) == foreign.COUNT
    (tmp_path / "a.glb").unlink()
    failed = run("convert", path, tmp_path / "other.ply")
    assert failed.code == 4
    assert "a.glb" in failed.err
    assert "Traceback" not in failed.err
    assert json.loads(files["tileset.json"])["root"]["content"]["uri"] == "a.glb"


def test_splats_of_another_program_are_read_whole(tmp_path: Path) -> None:
    """Splats of playcanvas/splat-transform, in the original and in its file of glTF."""
    source = read_ply(GOLDENS / "scene.ply")
    shutil.copy(GOLDENS / "scene.glb", tmp_path)
    reach = float(np.abs(source.position).max() + 5 * np.exp(source.log_scale).max())
    root = {
        "boundingVolume": {"box": [0, 0, 0, reach, 0, 0, 0, reach, 0, 0, 0, reach]},
        "geometricError": 0,
        "refine": "REPLACE",
        "content": {"uri": "scene.glb"},
    }
    extension = {"extensionsUsed": [SPLATS], "extensionsRequired": [SPLATS]}
    document = {
        "asset": {"version": "1.1"},
        "extensionsUsed": ["3DTILES_content_gltf"],
        "extensionsRequired": ["3DTILES_content_gltf"],
        "extensions": {"3DTILES_content_gltf": extension},
        "geometricError": 10,
        "root": root,
    }
    (tmp_path / "tileset.json").write_text(json.dumps(document))
    leaves = read_leaves(tmp_path)
    assert len(leaves) == len(source)
    # The program turns its scenes by half a turn about z; glTF has y up, tiles have z up.
    expected = source.position[:, [0, 2, 1]] * [-1, -1, -1]
    assert np.abs(leaves.position - expected).max() < 1e-6
    np.testing.assert_allclose(np.sort(leaves.log_scale), np.sort(source.log_scale), atol=1e-5)
    np.testing.assert_allclose(leaves.logit_opacity, source.logit_opacity, atol=1e-4)
    np.testing.assert_allclose(leaves.sh[:, 0], source.sh[:, 0], atol=1e-5)
    # The program keeps quaternions as they are, and those of the original have random lengths.
    lengths = np.linalg.norm(source.rotation, axis=1)
    (finding,) = validate(tmp_path / "tileset.json").findings
    assert finding.rule == "GT012"
    assert f"{(np.abs(lengths - 1) > 0.02).sum()} of {len(source)} quaternions" in finding.message
