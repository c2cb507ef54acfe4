"""The browser client reads and refuses the scene files that Python reads and refuses."""

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.contract.errors import GsgenError
from gsgen.runtime.errors import SceneUnreadable
from gsgen.runtime.sources.key_frames import EASINGS, KeyFrames
from gsgen.runtime.sources.scene_file import read_scene
from gsgen.runtime.web.pages import files_shown
from support.scene_documents import READ, WRONG
from support.web.packages import package
from support.web.pages import CLIENT

_SCRIPT = """
const { readScene } = await import(process.argv[1]);
const read = (document) => {
  const warnings = [];
  try {
    const scene = readScene(document, "scene.json", (...warning) => warnings.push(warning.join(" ")));
    return { scene, warnings };
  } catch (error) {
    if (error.name !== "GsgenError") throw error;
    return { where: error.where, message: error.message };
  }
};
let text = "";
for await (const part of process.stdin) text += part;
console.log(JSON.stringify(JSON.parse(text).map(read)));
"""


@pytest.fixture(scope="module")
def results() -> list[dict[str, Any]]:
    """Return what the client makes of all documents, in one run of Node.js."""
    package("types-0.1.74", needs_node=True)
    documents = [document for document, _ in WRONG.values()] + READ
    command = ["node", "--input-type=module", "--eval", _SCRIPT]
    result = subprocess.run(
        [*command, (CLIENT / "scene_file.js").as_uri()],
        input=json.dumps(documents).replace("NaN", "1e999"),
        capture_output=True,
        text=True,
        encoding="utf-8",
    )
    assert result.stderr == ""
    return list(json.loads(result.stdout))


def test_what_python_refuses_is_refused_at_the_same_place(
    results: list[dict[str, Any]], tmp_path: Path
) -> None:
    path = tmp_path / "scene.json"
    for name, (document, _) in WRONG.items():
        path.write_text(json.dumps(document), "utf-8")
        with pytest.raises(GsgenError) as caught:
            read_scene(path)
        result = results[list(WRONG).index(name)]
        assert "where" in result, f"{name}: {result}"
        assert result["where"] == caught.value.where.replace(str(path), "scene.json"), name


def test_what_python_reads_has_the_same_values(
    results: list[dict[str, Any]], tmp_path: Path
) -> None:
    path = tmp_path / "scene.json"
    for document, result in zip(READ, results[len(WRONG) :], strict=True):
        path.write_text(json.dumps(document), "utf-8")
        expected = read_scene(path)
        assert result["warnings"] == []
        scene = result["scene"]
        sound = expected.sound
        places = sound and [tmp_path / scene["sound"]["path"], scene["sound"]["start"]]
        assert places == (sound and [sound.path, sound.start])
        for model, own in zip(scene["models"], expected.models, strict=True):
            transform = np.reshape(model["transform"], (4, 4))
            np.testing.assert_allclose(transform, own.transform, atol=1e-15, rtol=1e-14)
            assert model["opacity"] == own.settings.opacity_scale
            assert model["isVisible"] == own.visible
        for mesh, own in zip(scene["meshes"], expected.meshes, strict=True):
            np.testing.assert_allclose(np.reshape(mesh["transform"], (4, 4)), own.transform)
            assert (mesh["shading"], mesh["isVisible"]) == (own.shading, own.visible)
            is_whole = mesh["opacity"] == 1 and mesh["animation"] is None
            assert is_whole == (not own.page_only)
        for note, own in zip(scene["annotations"], expected.annotations, strict=True):
            assert (note["position"], note["text"]) == (own.position.tolist(), own.text)
            assert note["normal"] == (None if own.normal is None else own.normal.tolist())
            assert (note["camera"] is None) == (own.camera is None)
        background = expected.background
        assert scene["background"] == (None if background is None else list(background))
        length, loop = (expected.span.seconds, expected.span.loop) if expected.span else (0, False)
        assert (scene["seconds"], scene["loop"]) == (length, loop)


def test_key_frames_have_the_values_of_python() -> None:
    """Of every easing, before, at, between and after key frames."""
    package("types-0.1.74", needs_node=True)
    script = (
        "const { valueAt } = await import(process.argv[1]);"
        "const [keys, moments] = JSON.parse(process.argv[2]);"
        "console.log(JSON.stringify(moments.map((moment) => valueAt(keys, moment))));"
    )
    values = [[float(i), i**2 - 3.0] for i in range(len(EASINGS) + 1)]
    easings = [*EASINGS, "linear"]
    keys = KeyFrames(tuple(0.5 + i for i in range(len(values))), np.array(values), tuple(easings))
    moments = np.linspace(0, len(values) + 1, 113).tolist()
    described = [
        {"at": at, "value": value, "easing": easing}
        for at, value, easing in zip(keys.times, values, easings, strict=True)
    ]
    module, text = (CLIENT / "key_frames.js").as_uri(), json.dumps([described, moments])
    command = ["node", "--input-type=module", "--eval", script, module, text]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.stderr == ""
    expected = [keys.at(moment) for moment in moments]
    np.testing.assert_allclose(json.loads(result.stdout), expected, atol=1e-15, rtol=1e-14)


@pytest.mark.parametrize(
    ("name", "data", "is_given"),
    [
        ("speech.wav", b"RIFF\0\0\0\0WAVEfmt ", True),
        ("speech.mp3", b"ID3\x04 and more", True),
        ("speech.aac", b"\xff\xf1\x50\x80", True),
        ("speech.m4a", b"\0\0\0\x20ftypM4A ", True),
        ("speech.vtt", b"\xef\xbb\xbfWEBVTT\n\n", True),
        ("passwd", b"root:x:0:0:root:/root:/bin/bash\n", False),
        ("speech.wav", b"-----BEGIN OPENSSH PRIVATE KEY-----", False),
        ("speech.wav", b"", False),
        ("none.wav", None, False),
        ("speech\0.wav", None, False),
    ],
)
def test_pages_get_no_other_file_as_sound(
    tmp_path: Path, name: str, data: bytes | None, is_given: bool
) -> None:
    """A scene file of others may name any file, also by a path out of its folder."""
    (tmp_path / "scene").mkdir()
    scene = tmp_path / "scene" / "scene.json"
    sound = {"path": f"../{name}"}
    models = [{"path": "still.ply"}]
    scene.write_text(json.dumps({"gsgen_scene": "1.0", "models": models, "sound": sound}))
    if data is not None:
        (tmp_path / name).write_bytes(data)
    _, file = files_shown([scene])
    if is_given:
        assert file.content() == data
        return
    with pytest.raises(SceneUnreadable, match=r"is no sound|No such file|null byte"):
        file.content()
