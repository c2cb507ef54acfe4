"""The page frames a scene as Python does: the box of all Gaussians but floaters is the same."""

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.framing import box_around
from runtime.sources.test_framing import SHAPES, floaters, splats
from support.web.packages import package
from support.web.pages import CLIENT

_SCRIPT = """
import { readFileSync } from "node:fs";
const [module, folder, number] = process.argv.slice(1);
const { boxAround } = await import(module);
const boxes = [];
for (let i = 0; i < Number(number); i++) {
  const rows = new Float32Array(new Uint8Array(readFileSync(`${folder}/${i}.bin`)).buffer);
  boxes.push(boxAround({ rows, count: rows.length / 10 }));
}
console.log(JSON.stringify(boxes));
"""


def boxes_of_client(scenes: list[SplatData], folder: Path) -> list[dict[str, list[float]] | None]:
    package("types-0.1.74", needs_node=True)  # Node.js is there where other packages are
    for number, data in enumerate(scenes):
        (folder / f"{number}.bin").write_bytes(data.rows.tobytes())
    module = (CLIENT / "framing.js").as_uri()
    command = ["node", "--input-type=module", "--eval", _SCRIPT, module, folder, str(len(scenes))]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.stderr == ""
    return json.loads(result.stdout)


def assert_same_boxes(scenes: list[SplatData], folder: Path) -> None:
    for data, box in zip(scenes, boxes_of_client(scenes, folder), strict=True):
        expected = box_around(data)
        assert (box is None) == (expected is None)
        if box is not None and expected is not None:
            np.testing.assert_allclose([box["low"], box["high"]], expected, rtol=1e-9, atol=1e-9)


def unusual_scenes(rng: np.random.Generator) -> Iterator[SplatData]:
    """Scenes without Gaussians, with invisible ones, and with numbers that cannot be drawn."""
    for count in (0, 1, 49, 50, 51):
        yield splats(rng.normal(size=(count, 3)), 0.1)
    yield splats(np.zeros((200, 3)), 0.0)
    yield splats(rng.normal(size=(200, 3)), 0.1, opacity=0.0)
    for column, value in ((0, np.nan), (2, np.inf), (3, np.nan), (4, np.nan), (7, np.inf), (9, -1)):
        data = splats(rng.normal(size=(300, 3)), 0.1)
        data.rows[::7, column] = value
        yield data
    for sigma in (1e-4, 0.3, 5.0, 1e6):
        data = splats(rng.normal(size=(400, 3)), 0.05)
        data.rows[:20, [4, 7, 9]] = sigma**2
        data.rows[:, 3] = rng.uniform(size=400)
        yield data
    yield splats(rng.normal(size=(300, 3)) * 1e30, 0.1)


@pytest.mark.parametrize("sigma", [0.002, 0.03, 0.3])
def test_client_finds_the_box_of_objects_with_and_without_floaters(
    sigma: float, tmp_path: Path
) -> None:
    rng = np.random.default_rng(3)
    scenes = []
    for shape in SHAPES.values():
        points = shape(rng)
        far = floaters(rng, points, max(1, len(points) // 200))
        scenes += [splats(points, sigma), splats(np.concatenate([points, far]), sigma)]
    assert_same_boxes(scenes, tmp_path)


def test_client_finds_the_box_of_unusual_scenes(tmp_path: Path) -> None:
    assert_same_boxes(list(unusual_scenes(np.random.default_rng(5))), tmp_path)


def test_client_finds_the_box_of_a_sample_of_many_gaussians(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    points = rng.normal(size=(300_000, 3))
    scenes = [splats(np.concatenate([points, floaters(rng, points[:9999], 50)]), 0.01)]
    assert_same_boxes(scenes, tmp_path)
