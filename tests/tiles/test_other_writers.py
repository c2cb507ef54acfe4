"""A tileset of a content that another program wrote: counts, positions, verdict."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from gsgen.contract import validate
from gsgen.formats import read_ply
from gsgen.tiles.leaves import read_leaves
from gsgen.tiles.volumes import ecef
from support.commands import ROOT

SPLATS = "KHR_gaussian_splatting"
GOLDENS = ROOT / "tests" / "formats" / "goldens"


@pytest.mark.parametrize("place", [None, (8.27, 46.01, 500.0)], ids=["local", "globe"])
def test_splats_of_another_program_are_read_whole(
    place: tuple[float, float, float] | None, tmp_path: Path
) -> None:
    """Splats of playcanvas/splat-transform, in the original and in its file of glTF."""
    source = read_ply(GOLDENS / "scene.ply")
    transform = np.eye(4)
    if place is not None:
        east, north, height = np.radians(place[0]), np.radians(place[1]), place[2]
        transform[:3, 0] = -np.sin(east), np.cos(east), 0
        up = np.array([np.cos(north) * np.cos(east), np.cos(north) * np.sin(east), np.sin(north)])
        transform[:3, 1], transform[:3, 2] = np.cross(up, transform[:3, 0]), up
        transform[:3, 3] = ecef(*np.array([[east], [north], [height]]))[0]
    shutil.copy(GOLDENS / "scene.glb", tmp_path)
    reach = float(np.abs(source.position).max() + 5 * np.exp(source.log_scale).max())
    root = {
        "boundingVolume": {"box": [0, 0, 0, reach, 0, 0, 0, reach, 0, 0, 0, reach]},
        "geometricError": 0,
        "refine": "REPLACE",
        "transform": transform.T.ravel().tolist(),
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
