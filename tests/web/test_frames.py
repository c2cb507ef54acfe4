"""Frames of models as arrays: those of Python, by each provider."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.formats import read_ply, write_glb, write_ply
from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.sdk.binding import FrameSession
from support.web.pages import WebSite, float32_result

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("ort")]

_RUN = """async ([address, provider, value]) => {
  const { open } = await import("/client/frames.js");
  const frames = await open(address, { provider });
  const frame = await frames.run(value === null ? {} : { time: value });
  const { capacity, channels } = frames;
  const numbers = [[frame.live, capacity, channels], frame.rows, frame.appearance];
  frames.destroy();
  return Float32Array.from(numbers.flatMap((part) => [...part]));
}"""


@pytest.mark.parametrize("provider", ["webgpu", "wasm"])
def test_frames_of_a_generator_are_those_of_python(
    provider: str, site: WebSite, walking_person: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "walk.onnx"
    path.write_bytes(walking_person)
    site.contents["/walk.onnx"] = walking_person
    numbers = float32_result(site.page, _RUN, ["/walk.onnx", provider, 0.3])
    with FrameSession(path, provider="cpu") as session:
        assert isinstance(session.manifest, GeneratorManifest)
        outputs = session.run({"time": 0.3}, copy=True)
        specs = session.manifest.outputs
        assert specs.gaussians is not None
        assert specs.appearance is not None
        rows, colors = outputs[specs.gaussians.name], outputs[specs.appearance.name]
    live, capacity, channels = numbers[:3]
    assert (live, capacity, channels) == (len(rows), len(rows), colors.shape[1])
    expected = np.concatenate([rows.ravel(), colors.ravel()])
    np.testing.assert_allclose(numbers[3:], expected, atol=2e-3)


def test_a_splat_file_is_one_frame(site: WebSite, tmp_path: Path) -> None:
    write_ply(tmp_path / "knot.ply", torus_knot(50, degree=1))
    site.contents["/knot.ply"] = (tmp_path / "knot.ply").read_bytes()
    numbers = float32_result(site.page, _RUN, ["/knot.ply", "wasm", None])
    assert numbers[:3].tolist() == [50, 50, 12]
    rows = numbers[3:503].reshape(50, 10)
    np.testing.assert_array_equal(rows[:, :3], read_ply(tmp_path / "knot.ply").position)


def test_a_file_of_several_parts_is_refused(site: WebSite, tmp_path: Path) -> None:
    """Each part has a place of its own, and one frame has one."""
    write_glb(tmp_path / "two.glb", torus_knot(50, degree=0))
    data = (tmp_path / "two.glb").read_bytes()
    length = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + length])
    document["nodes"] = [{"children": [1, 2]}, {"mesh": 0}, {"mesh": 0, "translation": [1, 2, 3]}]
    document["scenes"] = [{"nodes": [0]}]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + data[20 + length :]
    site.contents["/two.glb"] = struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
    with pytest.raises(Exception, match=r"two\.glb.*holds several parts, expected one"):
        site.page.evaluate(_RUN, ["/two.glb", "wasm", None])


def test_an_unknown_provider_is_refused(site: WebSite) -> None:
    site.contents["/knot.ply"] = b"ply"
    with pytest.raises(Exception, match="provider: is cuda, expected webgpu or wasm"):
        site.page.evaluate(_RUN, ["/knot.ply", "cuda", None])
