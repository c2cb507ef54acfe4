"""Models of one world stand beside each other, wherever their local origins are."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsgen.conformance.fixtures import find
from gsgen.contract.spec.manifest import Space
from gsgen.runtime.sources.opening import open_source
from gsgen.runtime.sources.source import Source
from gsgen.runtime.sources.world_origins import align_world_origins
from support.commands import gsgen_here

UTM = (449_123.25, 5_411_042.5, 88.125)


def source(folder: Path, name: str, space: Space | None) -> Source:
    path = folder / f"{name}.onnx"
    find("still_rgb").draw().with_manifest(space=space).write(path)
    return open_source(path)


def world_centers(placed: Source, first: Space) -> np.ndarray:
    """Return the Gaussians' centres in metres of the author's world, float64."""
    splats = placed.splats(None, None)
    local = splats.data.rows[: splats.data.count, :3].astype(np.float64)
    matrix = np.array(splats.transform)
    return (np.array(first.origin) + local @ matrix[:3, :3].T + matrix[:3, 3]) * 0.5


@pytest.mark.parametrize("unit", [0.5, 2.0])
def test_a_model_stands_where_its_origin_says(tmp_path: Path, unit: float) -> None:
    first = Space(origin=UTM, metres_per_unit=0.5)
    other_origin = tuple(0.5 / unit * x + d for x, d in zip(UTM, (3.0, -2.0, 0.25), strict=True))
    other = Space(origin=other_origin, metres_per_unit=unit)
    sources = [source(tmp_path, "a", first), source(tmp_path, "b", other)]
    placed = align_world_origins(sources)
    assert placed[0] is sources[0]
    local = sources[1].data.rows[: sources[1].data.count, :3].astype(np.float64)
    expected = (np.array(other_origin) + local) * unit
    np.testing.assert_allclose(world_centers(placed[1], first), expected, rtol=0, atol=1e-6)
    for opened in placed:
        opened.close()


def test_models_of_the_same_or_of_no_origin_stay(tmp_path: Path) -> None:
    spaces = [None, Space(origin=UTM), Space(), Space(origin=UTM)]
    sources = [source(tmp_path, str(number), space) for number, space in enumerate(spaces)]
    assert align_world_origins(sources) == sources
    for opened in sources:
        opened.close()


def test_a_picture_is_that_of_a_scene_file_with_the_offset(tmp_path: Path) -> None:
    east = (UTM[0] + 1.5, UTM[1], UTM[2])
    for name, space in (("a", Space(origin=UTM)), ("b", Space(origin=east)), ("c", None)):
        source(tmp_path, name, space).close()
    moved = {"path": "c.onnx", "translate": [1.5, 0, 0]}
    scene = {"gsgen_scene": "1.0", "models": ["a.onnx", moved]}
    (tmp_path / "scene.json").write_text(json.dumps(scene), "utf-8")
    options = ("--camera", "orbit:20,10,6", "--width", "48", "--height", "32")
    for words in (("a.onnx", "b.onnx", "-o", "origins.png"), ("scene.json", "-o", "scene.png")):
        completed = gsgen_here("render", *words, *options, cwd=tmp_path)
        assert completed.code == 0, completed.err
    pictures = [np.array(Image.open(tmp_path / f"{name}.png")) for name in ("origins", "scene")]
    assert len(np.unique(pictures[0].reshape(-1, pictures[0].shape[2]), axis=0)) > 20
    np.testing.assert_array_equal(*pictures)
