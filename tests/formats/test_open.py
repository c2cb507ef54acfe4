import os
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import (
    FileTruncated,
    FileUnreadable,
    FormatNotRecognised,
    FormatWarning,
    PackedRows,
    PointCloud,
    Splats,
    ValueInvalid,
    codec_named,
    codec_of_suffix,
    open_splats,
    read_npz,
    read_ply,
    write_ply,
)
from gsgen.formats.codecs import recognise_codec
from support.splat_files import samples

SHARED = Path(os.environ.get("GSGEN_SHARED", Path(__file__).parents[3] / "shared"))
with tempfile.TemporaryDirectory() as _folder:
    SAMPLES = samples(Path(_folder))
READERS = [open_splats, read_ply, read_npz]

shared_only = pytest.mark.skipif(
    not (SHARED / "data").is_dir(), reason=f"no data under GSGEN_SHARED ({SHARED})"
)


def test_the_content_decides_and_not_the_name(tmp_path):
    cloud = PointCloud(np.zeros((1, 3), np.float32), np.zeros((1, 3), np.float32))
    ply, npz = tmp_path / "really_ply.npz", tmp_path / "really_npz"
    write_ply(ply, cloud)
    with npz.open("wb") as file:
        np.savez(file, gaussians=np.zeros((1, 10), "f4"), appearance=np.zeros((1, 3), "f4"))
    assert isinstance(open_splats(ply), PointCloud)
    assert isinstance(open_splats(str(npz)), PackedRows)


def test_carriage_returns_are_no_other_format(tmp_path):
    file = tmp_path / "crlf.ply"
    file.write_bytes(
        b"ply\r\nformat ascii 1.0\r\nelement vertex 0\r\nproperty float x\r\n"
        b"property float y\r\nproperty float z\r\nproperty uchar r\r\n"
        b"property uchar g\r\nproperty uchar b\r\nend_header\r\n"
    )
    with pytest.raises(ValueInvalid, match="0 splats or points"):
        open_splats(file)


@pytest.mark.parametrize("name", [*SAMPLES])
def test_every_format_is_told_by_its_content(tmp_path, name):
    for content in SAMPLES[name]:
        file = tmp_path / "a.bin"
        file.write_bytes(content)
        with file.open("rb") as stream:
            codec = recognise_codec(stream)
        assert codec is not None
        # A compressed PLY file begins like any other; its reader sees the difference.
        assert codec.name == name.removeprefix("compressed-")
        here, reference = open_splats(file), codec_named(name).read(file)
        assert type(here) is type(reference)
        assert len(here) == len(reference)


def test_a_json_file_that_is_no_sog_is_refused(tmp_path):
    file = tmp_path / "scene.gltf"
    file.write_text('{"asset": {"version": "2.0"}}')
    with pytest.raises(FormatNotRecognised, match="a JSON document with the keys asset"):
        open_splats(file)


@pytest.mark.parametrize(
    ("content", "actual"), [(b"\xfe\xdc\xba\x98\x01\x00", "fe dc ba 98 01"), (b"\xf0", "f0")]
)
def test_other_content_is_refused_by_its_first_bytes(tmp_path, content, actual):
    file = tmp_path / "scene.abc"
    file.write_bytes(content)
    with pytest.raises(FormatNotRecognised) as caught:
        open_splats(file)
    assert str(caught.value) == (
        f"{file}: first bytes: {actual}\n"
        "expected a file of splats: PLY, compressed PLY, SPZ, GLB, SOG, KSPLAT, SPLAT, "
        "PyTorch checkpoint or NPZ\n"
        "If it is of another format, convert it to one of these first."
    )


@pytest.mark.parametrize(
    ("suffix", "kind"),
    [("splat", FileTruncated), ("ksplat", FileTruncated), ("ply", FormatNotRecognised)],
)
def test_unrecognised_file_is_explained_by_the_format_of_its_suffix(tmp_path, suffix, kind):
    file = tmp_path / f"scene.{suffix}"
    file.write_bytes(bytes(33))
    with pytest.raises(kind):
        open_splats(file)


@pytest.mark.parametrize(
    ("name", "codec"),
    [
        ("a.ply", "ply"),
        ("a.compressed.ply", "compressed-ply"),
        ("A.SPZ", "spz"),
        ("meta.json", "sog"),
        ("a.tar", None),
    ],
)
def test_the_longest_suffix_names_the_format(name, codec):
    actual = codec_of_suffix(name)
    assert (actual.name if actual else None) == codec


def unreadable(path: Path, read: object) -> str:
    assert callable(read)
    with pytest.raises(FileUnreadable) as caught:
        read(path)
    assert caught.value.path == str(path)
    return str(caught.value).removeprefix(f"{path}: ")


@pytest.mark.parametrize("read", READERS)
def test_a_file_that_cannot_be_opened_is_refused(tmp_path, read):
    empty, pipe = tmp_path / "empty", tmp_path / "pipe"
    empty.touch()
    os.mkfifo(pipe)
    (tmp_path / "sub").mkdir()
    missing = "the file cannot be read: No such file or directory"
    assert unreadable(tmp_path / "missing", read) == missing
    assert unreadable(tmp_path / "sub", read).startswith("the path is a folder")
    assert unreadable(pipe, read) == (
        "the path is a device, pipe or socket\nexpected a regular file"
    )
    assert unreadable(empty, read) == (
        "the file is empty\nwrite it again: the program that wrote it may have failed"
    )
    # Python's own words.
    since_3_13 = "stat: embedded null character in path"
    words = since_3_13 if sys.version_info >= (3, 13) else "embedded null byte"
    assert unreadable(tmp_path / "a\0b", read) == f"the file cannot be read: {words}"


@pytest.mark.parametrize("read", READERS)
def test_file_without_read_permission_is_refused(tmp_path, read, monkeypatch):
    def closed(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    file = tmp_path / "closed"
    file.write_bytes(b"ply\n")
    monkeypatch.setattr("builtins.open", closed)  # the tests may run as root
    assert unreadable(file, read) == "the file cannot be read: Permission denied"


@shared_only
def test_splats_of_a_real_training_are_read():
    with pytest.warns(FormatWarning, match="not used: properties nx, ny, nz"):
        splats = open_splats(SHARED / "data/twins/test-splat.3-points-from-train.ply")
    assert isinstance(splats, Splats)
    assert (len(splats), splats.degree) == (3, 3)
    np.testing.assert_allclose(splats.position[0], [2.0078, 0.0811, 1.3286], atol=2e-4)


@shared_only
def test_splats_agree_with_the_same_scene_in_another_format():
    """The 32-byte records beside it: position, linear scale, colour, quaternion."""
    with pytest.warns(FormatWarning, match="not used: properties nx, ny, nz"):
        splats = open_splats(SHARED / "data/twins/test-splat.3-points-from-train.ply")
    assert isinstance(splats, Splats)
    record = [("position", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("q", "u1", 4)]
    twin = np.fromfile(SHARED / "data/twins/test-splat.3-points-from-train.splat", record)
    splats_at = [
        int(np.argmin(np.abs(splats.position - location).sum(axis=1)))
        for location in twin["position"]
    ]
    assert sorted(splats_at) == [0, 1, 2]
    np.testing.assert_array_equal(twin["position"], splats.position[splats_at])
    np.testing.assert_allclose(twin["scale"], np.exp(splats.log_scale[splats_at]), rtol=1e-5)
    opacity = 1 / (1 + np.exp(-splats.logit_opacity[splats_at]))
    np.testing.assert_allclose(twin["rgba"][:, 3] / 255, opacity, atol=1 / 255)
    rotation = splats.rotation[splats_at]
    rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
    np.testing.assert_allclose(twin["q"] / 128 - 1.0, rotation, atol=1 / 64)
    color = np.clip(0.5 + 0.28209479 * splats.sh[splats_at, 0], 0, 1)
    np.testing.assert_allclose(twin["rgba"][:, :3] / 255, color, atol=1 / 255)


@shared_only
def test_points_of_a_real_capture_are_read():
    with pytest.warns(FormatWarning, match="not used: array"):
        cloud = open_splats(SHARED / "data/garden/test_garden.npz")
    assert isinstance(cloud, PointCloud)
    assert len(cloud) == 138_766
    assert cloud.color.min() >= 0
    assert cloud.color.max() <= 1
