import json
import math
import sys
import warnings
import zipfile
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from gsgen.formats import (
    ArchiveDamaged,
    FileTruncated,
    FileUnreadable,
    FormatError,
    FormatNotRecognised,
    FormatWarning,
    HeaderMalformed,
    NotSupported,
    PropertyMissing,
    SizeExceeded,
    Splats,
    open_splats,
    read_ply,
    read_sog,
)
from support.splat_files import GOLDENS, assert_near, sog_files, sog_version_1, webp, zipped


def naive_read(files: dict[str, bytes]) -> Splats:
    """One pixel at a time, as the format describes it."""
    meta = json.loads(files["meta.json"])

    def pixels(name: str) -> list[tuple[int, ...]]:
        image = Image.open(BytesIO(files[name])).convert("RGBA")
        return [image.getpixel((x, y)) for y in range(image.height) for x in range(image.width)]

    def numbers(group: str, values: tuple[int, ...]) -> list[float]:
        entry = meta[group]
        if "version" in meta:
            return [entry["codebook"][byte] for byte in values]
        least, most = entry["mins"], entry["maxs"]
        if group == "shN":  # one range for all
            least, most = [least] * 3, [most] * 3
        ends = zip(values, least, most, strict=True)
        return [low + (high - low) * byte / 255 for byte, low, high in ends]

    low, high = (pixels(name) for name in meta["means"]["files"])
    turns, sizes = pixels("quats.webp"), pixels("scales.webp")
    colors = pixels("sh0.webp")
    ends = zip(meta["means"]["mins"], meta["means"]["maxs"], strict=True)
    ends = list(ends)
    result = {"position": [], "rotation": [], "log_scale": [], "logit_opacity": [], "sh": []}
    count = meta["count"] if "version" in meta else meta["means"]["shape"][0]
    for row in range(count):
        recorded = []
        for axis, (a, b) in enumerate(ends):
            share = (low[row][axis] | high[row][axis] << 8) / 65535
            value = a + (b - a) * share
            recorded.append(math.copysign(math.exp(abs(value)) - 1, value))
        result["position"].append(recorded)
        quaternion, largest = [0.0] * 4, turns[row][3] - 252
        others = [k for k in range(4) if k != largest]
        for k, byte in zip(others, turns[row], strict=False):
            quaternion[k] = (byte / 255 * 2 - 1) / math.sqrt(2)
        quaternion[largest] = math.sqrt(max(0, 1 - sum(v * v for v in quaternion)))
        result["rotation"].append(quaternion)
        result["log_scale"].append(numbers("scales", sizes[row][:3]))
        if "version" in meta:
            alpha = colors[row][3] / 255
            logit = {0: -math.inf, 1: math.inf}.get(alpha) or math.log(alpha / (1 - alpha))
            result["logit_opacity"].append(logit)
        else:
            result["logit_opacity"].append(numbers("sh0", colors[row])[3])
        result["sh"].append([numbers("sh0", colors[row])[:3]])
    if "shN" in meta:
        centroids, label_image = meta["shN"]["files"]
        palette = Image.open(BytesIO(files[centroids])).convert("RGBA")
        sh_count = palette.width // 64
        labels = pixels(label_image)
        for row in range(count):
            label = labels[row][0] | labels[row][1] << 8
            for j in range(sh_count):
                texel = palette.getpixel(((label % 64) * sh_count + j, label // 64))
                result["sh"][row].append(numbers("shN", texel[:3]))
    return Splats(**{name: np.array(values, np.float32) for name, values in result.items()})


@pytest.mark.parametrize(("bands", "count"), [(0, 1), (1, 10), (2, 17), (3, 5)])
@pytest.mark.parametrize("version", [1, 2])
def test_sog_agrees_with_a_slow_decoder(tmp_path, bands, count, version):
    files = sog_files(count, bands)
    files = sog_version_1(files) if version == 1 else files
    file = tmp_path / "a.sog"
    file.write_bytes(zipped(files))
    assert_near(read_sog(file), naive_read(files), position=1e-5, rotation=1e-6)


def test_splat_transform_reads_its_file_alike():
    here = read_sog(GOLDENS / "scene.sog")
    splats = read_ply(GOLDENS / "scene.sog.decoded.ply")
    assert_near(here, splats, position=1e-6, opacities=1e-5)


def test_an_unpacked_sog_is_read_through_its_meta(tmp_path):
    for name, content in sog_files().items():
        (tmp_path / name).write_bytes(content)
    file = tmp_path / "a.sog"
    file.write_bytes(zipped(sog_files(), zipfile.ZIP_DEFLATED))
    first, other = open_splats(tmp_path / "meta.json"), open_splats(file)
    assert isinstance(first, Splats)
    assert isinstance(other, Splats)
    assert_near(first, other)


def test_invalid_rotation_tag_means_identity(tmp_path):
    files = sog_files(4)
    pixels = np.full((4, 4), 251, np.uint8)
    file = tmp_path / "a.sog"
    file.write_bytes(zipped(files | {"quats.webp": webp(pixels, 4)}))
    np.testing.assert_array_equal(read_sog(file).rotation, [[1, 0, 0, 0]] * 4)


def meta_changed(files: dict[str, bytes], path: str, value: object) -> dict[str, bytes]:
    """The files, with a member of meta.json at a dotted path changed."""
    meta = json.loads(files["meta.json"])
    *groups, key = path.split(".")
    target = meta
    for group in groups:
        target = target[group]
    target[key] = value
    return files | {"meta.json": json.dumps(meta).encode()}


@pytest.mark.parametrize(
    ("path", "value", "text"),
    [
        ("means.shape", None, "meta.json, means.shape: 'None'"),
        ("means.shape", [0, 3], "meta.json, means.shape: '0'"),
        ("scales.mins", [1, 2], "meta.json, scales.mins: '[1, 2]'"),
        ("sh0.maxs", [1, 2, 3], "meta.json, sh0.maxs: '[1, 2, 3]'"),
        ("shN.mins", "0", "meta.json, shN.mins: '0'"),
        ("shN.maxs", None, "meta.json, shN.maxs: 'None'"),
    ],
)
def test_inconsistent_meta_of_version_1_is_refused(tmp_path, path, value, text):
    files = meta_changed(sog_version_1(sog_files()), path, value)
    assert refusal(tmp_path, files, HeaderMalformed).startswith(text)


def test_palette_of_another_width_is_refused_in_version_1(tmp_path):
    files = sog_version_1(sog_files()) | {"centroids.webp": webp(np.zeros((100, 4)), 100)}
    text = refusal(tmp_path, files, HeaderMalformed)
    assert text.startswith("shN: an image of 100 × 1 pixels\nexpected a width of 192, 512, 960")


def notes_of(path) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", FormatWarning)
        read_sog(path)
    return [str(entry.message).removeprefix(f"{path}: ") for entry in caught]


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize(
    ("path", "value", "note"),
    [
        ("time", 0.5, "not used: key time"),
        ("camera", {"fov": 60}, "not used: key camera"),
        ("scales.unit", "cm", "not used: key scales.unit"),
        ("model", "surfels", "not used: key model"),
        ("asset", {"generator": "x"}, ""),
        ("model", "default", ""),
    ],
)
def test_key_that_is_not_used_is_named(tmp_path, version, path, value, note):
    files = sog_version_1(sog_files()) if version == 1 else sog_files()
    (tmp_path / "a.sog").write_bytes(zipped(files))
    assert notes_of(tmp_path / "a.sog") == []
    (tmp_path / "a.sog").write_bytes(zipped(meta_changed(files, path, value)))
    assert notes_of(tmp_path / "a.sog") == ([note] if note else [])


def test_file_of_an_archive_that_is_not_used_is_named(tmp_path):
    (tmp_path / "a.sog").write_bytes(zipped(sog_files() | {"camera.json": b"{}"}))
    assert notes_of(tmp_path / "a.sog") == ["not used: file 'camera.json'"]


def refusal(tmp_path, files: dict[str, bytes], kind: type[FormatError], **meta: object) -> str:
    """The text of the error over a SOG of ``files``, with ``meta`` changed."""
    if meta:
        files = files | {"meta.json": json.dumps(json.loads(files["meta.json"]) | meta).encode()}
    file = tmp_path / "bad.sog"
    file.write_bytes(zipped(files))
    with pytest.raises(FormatError) as caught:
        read_sog(file)
    assert caught.value.path == str(file)
    assert type(caught.value) is kind, str(caught.value)
    return str(caught.value).removeprefix(f"{file}: ")


MEANS = {"mins": [-1, -2, -3], "maxs": [1, 2, 3], "files": ["l.webp", "u.webp"]}


@pytest.mark.parametrize(
    ("meta", "kind", "text"),
    [
        ({"version": 1}, HeaderMalformed, "meta.json, means.shape: 'None'\nexpected a whole num"),
        ({"version": 3}, NotSupported, "meta.json: the SOG version is '3'\nexpected version 1 or"),
        ({"lodLevels": 3}, NotSupported, "meta.json: the file is a streamed SOG of several levels"),
        ({"count": 0}, HeaderMalformed, "meta.json, count: '0'\nexpected a whole number from 1"),
        ({"count": "x"}, HeaderMalformed, "meta.json, count: 'x'\n"),
        ({"count": True}, HeaderMalformed, "meta.json, count: 'True'\n"),
        ({"count": 10**30}, HeaderMalformed, "meta.json, count: "),
        ({"count": 10**9}, SizeExceeded, "the 1000000000 splats take about 236000000000 bytes\n"),
        (
            {"count": 10**7},
            FileTruncated,
            "meta.json, count: meta.json declares 10000000 splats, but their posi",
        ),
        ({"count": 1000}, FileTruncated, "means: an image of 4 × 3 pixels\nexpected 1000 pix"),
        (
            {"means": 3},
            HeaderMalformed,
            "meta.json: the JSON object lacks the key 'means'\nexpected an object",
        ),
        ({"means": MEANS | {"files": ["l.webp"]}}, HeaderMalformed, "meta.json, means.files"),
        ({"means": MEANS | {"files": [1, 2]}}, HeaderMalformed, "meta.json, means.files: "),
        (
            {"means": MEANS | {"files": ["x", "y"]}},
            PropertyMissing,
            "archive: the archive holds no file 'x'",
        ),
        ({"means": MEANS | {"mins": [0, 0]}}, HeaderMalformed, "meta.json, means.mins: "),
        ({"means": MEANS | {"mins": [0, 0, "a"]}}, HeaderMalformed, "meta.json, means.mins:"),
        ({"shN": {"count": 70000}}, HeaderMalformed, "meta.json, shN.count: '70000'\n"),
        ({"shN": {"count": 1, "bands": 4}}, HeaderMalformed, "meta.json, shN.bands: '4'\n"),
        ({"sh0": {"codebook": [1], "files": ["sh0.webp"]}}, HeaderMalformed, "meta.json, sh0."),
    ],
)
def test_inconsistent_meta_is_refused(tmp_path, meta, kind, text):
    assert refusal(tmp_path, sog_files(), kind, **meta).startswith(text)


@pytest.mark.parametrize(
    ("content", "kind", "text"),
    [
        (
            b"{",
            FormatNotRecognised,
            "meta.json: the file has invalid JSON (Expecting property name",
        ),
        (b"[1]", FormatNotRecognised, "this is a JSON list\n"),
        (b"{}", FormatNotRecognised, "this is a JSON document without keys\n"),
        (b"\xff\xfe\x00", FormatNotRecognised, "first bytes: ff fe 00"),
        (
            b'{"a":' * 100_000,
            FormatNotRecognised,
            "meta.json: the file has invalid JSON (it nests too deeply)",
        ),
    ],
)
def test_other_json_is_not_recognised_as_meta(tmp_path, content, kind, text):
    files = sog_files() | {"meta.json": content}
    assert refusal(tmp_path, files, kind).startswith(text)


@pytest.mark.parametrize(
    ("name", "content", "kind", "text"),
    [
        ("quats.webp", b"RIFF....WEBPVP8L", ArchiveDamaged, "quats: the SOG image cannot be unp"),
        ("quats.webp", b"", ArchiveDamaged, "quats: the SOG image cannot be unpacked (Unident"),
        ("sh0.webp", webp(np.zeros((9, 4)), 3), FileTruncated, "sh0: an image of 3 × 3 pix"),
        ("sh0.webp", webp(np.zeros((90_000, 4)), 300), HeaderMalformed, "sh0: an image of 300"),
        ("centroids.webp", webp(np.zeros((640, 4)), 64), HeaderMalformed, "shN: an image of 64"),
        (
            "labels.webp",
            webp(np.full((10, 4), 255), 4),
            HeaderMalformed,
            "shN: a palette label is 65535\nexpected 0 to 64",
        ),
    ],
)
def test_invalid_image_is_refused(tmp_path, name, content, kind, text):
    files = sog_files() | {name: content}
    assert refusal(tmp_path, files, kind).startswith(text)


def test_a_zip_bomb_is_not_unpacked(tmp_path):
    file = tmp_path / "bomb.sog"
    files = sog_files() | {"l.webp": bytes(5_000_000)}
    file.write_bytes(zipped(files, zipfile.ZIP_DEFLATED))
    assert file.stat().st_size < 100_000
    with pytest.raises(SizeExceeded, match=r"file 'l\.webp': the file has more than 524448 bytes"):
        read_sog(file)


def test_a_meta_that_names_files_elsewhere_is_refused(tmp_path):
    folder = tmp_path / "inner"
    folder.mkdir()
    files = sog_files()
    (tmp_path / "l.webp").write_bytes(files["l.webp"])
    meta = json.loads(files["meta.json"])
    meta["means"]["files"] = ["../l.webp", "u.webp"]
    (folder / "meta.json").write_text(json.dumps(meta))
    with pytest.raises(HeaderMalformed, match="the name of a file in the same folder"):
        read_sog(folder / "meta.json")
    meta["means"]["files"] = ["l.webp", "u.webp"]
    (folder / "meta.json").write_text(json.dumps(meta))
    with pytest.raises(FileUnreadable):
        read_sog(folder / "meta.json")


def test_a_sog_needs_pillow(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(NotSupported) as caught:
        read_sog(GOLDENS / "scene.sog")
    assert str(caught.value).endswith("pip install 'gsgen[formats]'")


def test_a_zip_of_other_files_has_no_meta(tmp_path):
    file = tmp_path / "a.sog"
    file.write_bytes(zipped({"a.txt": b"a"}))
    with pytest.raises(PropertyMissing, match=r"holds no file 'meta\.json'"):
        read_sog(file)
