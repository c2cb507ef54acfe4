"""Tilesets like those of CesiumJS's tests: exact counts and positions, and the right verdict."""

import json
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.formats import FormatWarning
from gsgen.tiles import validate
from gsgen.tiles.errors import TilesetInvalid
from gsgen.tiles.loading.leaves import read_leaves
from gsgen.tiles.loading.tileset_loader import open_tileset
from support.commands import gsgen as run
from support.tiles import foreign_tiles as foreign
from tiles.cesium import first_draft

SH_C0 = 0.28209479177387814


def findings(path: Path) -> dict[str, str]:
    return {finding.rule: finding.certainty for finding in validate(path).findings}


def test_the_first_draft_is_read_whole(tmp_path: Path) -> None:
    """Five splats on a diagonal: the values of the buffer, and the node's quarter turn by hand."""
    path = foreign.write(tmp_path, first_draft.five_splats())
    with pytest.warns(FormatWarning, match="_ROTATION, _SCALE"):
        leaves = read_leaves(path)
    steps = np.arange(-2, 3)
    expected = steps[:, None] + [2.0, 7.0, 12.0]
    assert np.abs(leaves.position - expected).max() < 1e-6
    assert np.allclose(np.exp(leaves.log_scale), np.exp(1 + 0.1 * np.arange(5))[:, None], 1e-6)
    colors = first_draft.COLORS / 255
    assert np.abs(leaves.sh[:, 0] * SH_C0 + 0.5 - colors[:, :3]).max() < 1e-6
    opacity = 1 / (1 + np.exp(-leaves.logit_opacity))
    assert np.abs(opacity - colors[:, 3]).max() < 1e-6
    # The first splat has no turn but that of the node, −90° about x, and of the viewer, +90°.
    assert np.abs(np.abs(leaves.rotation[0]) - [1, 0, 0, 0]).max() < 1e-6


def test_the_first_draft_is_named_in_the_report(tmp_path: Path) -> None:
    """CesiumJS 1.145 draws points in place of its splats, as GT007 says; nothing else is wrong.

    A radius of 3σ is more than its box, which counts only for tilesets of gsgen's profile.
    """
    actual = findings(foreign.write(tmp_path, first_draft.five_splats()))
    assert actual == {"GT003": "possible", "GT007": "confirmed", "GT019": "confirmed"}


@pytest.mark.parametrize("legacy", [False, True])
def test_splats_on_the_globe_keep_five_millimetres(legacy: bool, tmp_path: Path) -> None:
    """Splats in a box far from the frame's origin stand within 5 mm of their positions."""
    index: Any = first_draft.tower(is_legacy=legacy)
    box = np.array(index["root"]["boundingVolume"]["box"])
    cloud = foreign.cloud(11)
    cloud["position"] = np.asarray(cloud["position"] / 30, np.float32).astype(np.float64)
    node = np.eye(4)
    node[:3, 3] = [box[0], box[2], -box[1]]  # the viewer makes (x, −z, y) of it
    content = foreign.spz_glb(cloud, node, drafts=legacy)
    path = foreign.write(tmp_path, {"tileset.json": json.dumps(index).encode(), "0/0.glb": content})
    with pytest.warns(FormatWarning, match="KHR_spz") if legacy else nullcontext():
        leaves = read_leaves(path)
    tileset = open_tileset(path)
    assert len(leaves) == foreign.COUNT
    world = np.reshape(index["root"]["transform"], (4, 4)).T
    expected = foreign.moved_positions(
        foreign.turned_up(foreign.moved_positions(cloud["position"], node)), world
    )
    actual = foreign.moved_positions(leaves.position, tileset.transform)
    assert float(np.linalg.norm(np.asarray(actual - expected, float), axis=1).max()) < 0.005
    assert findings(path) == ({"GT007": "confirmed", "GT019": "confirmed"} if legacy else {})


@pytest.mark.parametrize("name", ["EXT_meshopt_compression", "KHR_meshopt_compression"])
@pytest.mark.parametrize("embedded", [False, True])
def test_compressed_attributes_are_refused_by_name(
    name: str, embedded: bool, tmp_path: Path
) -> None:
    data = foreign.gltf(foreign.cloud(1), embedded=True)
    document = json.loads(data)
    document["extensionsRequired"] = [name]
    document["buffers"] = [{"byteLength": 4, "extensions": {name: {"fallback": True}}}]
    content = json.dumps(document).encode() if embedded else foreign.glb(document, bytes(4))
    uri = "a.gltf" if embedded else "a.glb"
    root = {
        "boundingVolume": foreign.box(40),
        "geometricError": 0,
        "refine": "ADD",
        "content": {"uri": uri},
    }
    path = foreign.write(tmp_path, {"tileset.json": foreign.tileset(root), uri: content})
    with pytest.raises(TilesetInvalid, match=f"{uri}, extensionsRequired.*needs {name}"):
        read_leaves(path)
    assert findings(path) == {"GT005": "confirmed"}
    completed = run("convert", path, tmp_path / "out.ply")
    assert completed.code == 4
    assert f"needs {name}, which is not decoded" in completed.err
