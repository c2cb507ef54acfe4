"""The adapter fills private buffers of three's GaussianSplat, which exist in the pinned versions."""

import gzip
import json
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.runtime.web.pages import client_file
from support.web.packages import package
from support.web.pages import CLIENT
from support.web.without_webgpu import THREE

_SCRIPT = """
import * as three from "three/webgpu";
import * as splats from "three/addons/objects/GaussianSplat.js";
const { ThreeGaussians, THREE_REVISIONS, loadThree, threeSettings } = await import(process.argv[2]);
const load = (three) => async (name) => (name === "three/webgpu" ? three : splats);
threeSettings.load = load(three);
const rows = (count) => Float32Array.from({ length: 10 * count }, (_, i) => 1 + i);
const transform = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
const frames = { capacity: 3, channels: 12, space: "sh", transform, antialias: "classic" };
const gaussians = new ThreeGaussians(await loadThree(), frames);
const appearance = Float32Array.from({ length: 36 }, (_, i) => (i % 12 < 3 ? 0 : (i % 12) / 16 - 0.5));
const written = [rows(3), rows(3)];
for (const each of written) for (let row = 0; row < 3; row++) each[10 * row + 3] = 0.6;
written[1][10] = NaN;
const { object } = gaussians;
const results = [];
const show = (frame, camera) => {
  gaussians.fill(frame, camera);
  const { centerRead, covarianceARead, covarianceBRead, colorRead, sphericalHarmonics1Attribute } = object._buffers;
  const attributes = [centerRead.value, covarianceARead.value, covarianceBRead.value, colorRead.value];
  results.push({
    numbers: attributes.slice(0, 3).map(({ array }) => [...array]),
    colors: [...new Uint8Array(attributes[3].array.buffer)],
    band: [...new Uint8Array(sphericalHarmonics1Attribute.array.buffer)],
    positions: [...object._positionAttribute.array],
    versions: [...attributes, sphericalHarmonics1Attribute].map(({ version }) => version),
    isSorted: object._sortInitialized,
    radius: object.boundingSphere.radius,
  });
};
object._sortInitialized = true;
show({ rows: written[0], appearance, live: 3 });
show({ rows: written[1], appearance, live: 2 });
show({ rows: written[0], appearance, live: 1 }, { view: transform, fx: 1, fy: 1 });
const refusals = [];
for (const REVISION of [`${THREE_REVISIONS[0] - 1}`, `${THREE_REVISIONS[1] + 1}dev`]) {
  threeSettings.load = load({ ...three, REVISION });
  await loadThree().catch(({ message }) => refusals.push(message));
}
console.log(JSON.stringify({ results, refusals, revisions: THREE_REVISIONS, fields: Object.keys(object) }));
"""


@pytest.fixture(scope="module")
def answer(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("project")
    (folder / "node_modules").mkdir()
    (folder / "node_modules/three").symlink_to(package(THREE, needs_node=True))
    (folder / "fill.mjs").write_text(_SCRIPT, "utf-8")
    adapter = Path(CLIENT / "three_adapter.js").as_uri()
    result = subprocess.run(
        ["node", "fill.mjs", adapter], cwd=folder, capture_output=True, text=True, encoding="utf-8"
    )
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


def test_rows_are_packed_into_the_private_buffers(answer: Any) -> None:
    whole = answer["results"][0]
    rows = np.arange(1, 31.0).reshape(3, 10)
    centers, first, second = (np.reshape(numbers, (3, 4)) for numbers in whole["numbers"])
    np.testing.assert_array_equal(centers[:, :3], rows[:, :3])
    np.testing.assert_array_equal(np.reshape(whole["positions"], (3, 3)), rows[:, :3])
    np.testing.assert_array_equal(np.hstack([first, second[:, :2]]), rows[:, 4:])
    assert whole["colors"] == [128, 128, 128, 153] * 3
    expected = [round(128 * (number / 16 - 0.5) + 128) for number in range(3, 12)]
    assert whole["band"] == [*expected, 0, 0, 0] * 3
    assert whole["isSorted"] is False
    assert min(whole["versions"]) >= 1
    assert whole["radius"] > np.linalg.norm((rows[2] - rows[0])[:3]) / 2


def test_rows_that_are_not_live_or_not_finite_are_not_drawn(answer: Any) -> None:
    colors = np.reshape(answer["results"][1]["colors"], (3, 4))
    assert colors[:, 3].tolist() == [153, 0, 0]
    assert np.isfinite(answer["results"][1]["numbers"]).all()


def test_a_camera_widens_classic_gaussians_by_what_three_dims(answer: Any) -> None:
    _, first, second = (np.reshape(numbers, (3, 4)) for numbers in answer["results"][2]["numbers"])
    depth = 3
    expected = np.array([5, 6, 7, 8]) + 0.3 * depth**2 * np.array([1, 0, 0, 1])
    np.testing.assert_allclose(first[0], expected, rtol=1e-6)
    np.testing.assert_allclose(second[0, :2], [9, 10 + 0.3 * depth**2], rtol=1e-6)


def test_other_versions_are_refused_at_both_ends(answer: Any) -> None:
    low, high = answer["revisions"]
    expected = f"expected r{low} to r{high}"
    assert [text.endswith(expected) for text in answer["refusals"]] == [True, True]
    peers = json.loads(client_file("package.json"))["peerDependencies"]
    assert peers["three"] == f">=0.{low}.0 <0.{high + 1}.0"


def test_every_private_name_that_is_used_exists(answer: Any) -> None:
    text = client_file("three_adapter.js").decode("utf-8")
    used = set(re.findall(r"object\.(_\w+)", text)) | set(
        re.findall(r"\{ (_\w+): \w+, splatG", text)
    )
    assert {"_buffers", "_sortInitialized"} <= used
    assert used <= set(answer["fields"])


def test_the_adapter_is_small() -> None:
    assert len(gzip.compress(client_file("three_adapter.js"))) <= 6 * 1024
