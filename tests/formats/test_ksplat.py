import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.formats import (
    FileTruncated,
    FormatError,
    FormatNotRecognised,
    FormatWarning,
    HeaderMalformed,
    NotSupported,
    ValueInvalid,
    read_ksplat,
    read_ply,
    read_splat,
)
from support.commands import shared
from support.splat_files import GOLDENS, assert_near, ksplat, opacity, scene, turn_between

C0 = 0.28209479177387814
LEVELS = [0, 1, 2]


@settings(max_examples=25, deadline=None)
@given(
    level=st.sampled_from(LEVELS),
    degree=st.integers(0, 2),
    count=st.integers(1, 20),
    seed=st.integers(0, 2**32 - 1),
)
def test_handwritten_file_is_read(tmp_path_factory, level, degree, count, seed):
    splats = scene(count, degree, seed)
    file = tmp_path_factory.getbasetemp() / "a.ksplat"
    file.write_bytes(ksplat(splats, level))
    restored = read_ksplat(file)
    assert (len(restored), restored.degree) == (count, degree)
    half = 50 / 2 / 32767 / 2 * 1.01 if level else 0  # half a step of the buckets
    assert np.abs(restored.position - splats.position).max() <= half
    relative = 1 / 1024 if level else 1e-6  # of a float16
    np.testing.assert_allclose(np.exp(restored.log_scale), np.exp(splats.log_scale), rtol=relative)
    assert turn_between(restored.rotation, splats.rotation) <= relative
    assert np.abs(opacity(restored) - opacity(splats)).max() <= 1 / 509
    cut = np.clip(splats.sh[:, 0], -0.5 / C0, 0.5 / C0)
    assert np.abs(restored.sh[:, 0] - cut).max() <= 1 / 509 / C0
    higher = np.clip(splats.sh[:, 1:], -1.5, 1.5)
    quantization_error = {0: 0, 1: 1 / 1024, 2: 3 / 509}[level]
    assert np.abs(restored.sh[:, 1:] - higher).max(initial=0) <= quantization_error


@pytest.mark.parametrize("level", LEVELS)
def test_splat_transform_reads_ksplat_alike(level):
    here = read_ksplat(GOLDENS / f"level-{level}.ksplat")
    splats = read_ply(GOLDENS / f"level-{level}.ksplat.decoded.ply")
    assert_near(here, splats, rotation=1e-7, opacities=1e-7, sh=2e-7)


def test_ksplat_and_splat_of_one_scene_agree():
    here = read_ksplat(shared("data/twins/minimal.ksplat"))
    assert_near(here, read_splat(shared("data/twins/minimal.splat")))


def test_sections_of_several_degrees_become_the_highest(tmp_path):
    first, second = scene(4, 2), scene(3, 0, seed=1)
    file_bytes, other = ksplat(first, 1), ksplat(second, 1)
    head = bytearray(file_bytes[:4096])
    head[4:8] = struct.pack("<I", 3)  # a third section is empty
    sections = file_bytes[4096:5120] + other[4096:5120] + bytes(1024)
    file = tmp_path / "two.ksplat"
    file.write_bytes(bytes(head) + sections + file_bytes[5120:] + other[5120:])
    both = read_ksplat(file)
    assert (len(both), both.degree) == (7, 2)
    (tmp_path / "one.ksplat").write_bytes(file_bytes)
    alone = read_ksplat(tmp_path / "one.ksplat")
    np.testing.assert_array_equal(both.position[:4], alone.position)
    np.testing.assert_array_equal(both.sh[:4], alone.sh)
    np.testing.assert_allclose(both.position[4:], second.position, atol=1e-3)
    assert not both.sh[4:, 1:].any()


def test_the_range_of_harmonics_is_in_the_header(tmp_path):
    file = tmp_path / "a.ksplat"
    content = bytearray(ksplat(scene(4, 1), 2))
    file.write_bytes(content)
    narrow_harmonics = read_ksplat(file).sh[:, 1:]
    content[36:44] = struct.pack("<2f", -3, 3)
    file.write_bytes(content)
    np.testing.assert_allclose(read_ksplat(file).sh[:, 1:], 2 * narrow_harmonics, atol=1e-6)
    content[36:44] = bytes(8)  # writers before it leave both 0, and mean 1.5
    file.write_bytes(content)
    np.testing.assert_array_equal(read_ksplat(file).sh[:, 1:], narrow_harmonics)


FULL, PARTIAL, COUNT, MOST, BLOCK = 4096 + 32, 4096 + 36, 4096, 4100, 4096 + 16


@pytest.mark.parametrize(
    ("offset", "value", "kind", "text"),
    [
        (0, b"\x01", FormatNotRecognised, "first bytes: 01 01 00 00\n"),
        (1, b"\x02", NotSupported, "byte 1: the file has KSPLAT version 0.2\nexpected version 0.1"),
        (20, b"\x03", HeaderMalformed, "byte 20: the compression level is 3\nexpected 0, 1 or 2"),
        (
            4,
            b"\xff\xff\xff\xff",
            FileTruncated,
            "section headers: the data need 4398046510080 bytes",
        ),
        (COUNT, b"\x00", ValueInvalid, "sections: the file has 0 splats\nexpected at least one"),
        (
            COUNT,
            b"\x0d",
            HeaderMalformed,
            "section 0, byte 4096: the section has 13 splats, but a capacity of 12\nexpected at most 12 splats",
        ),
        (
            MOST,
            b"\xff\xff\xff\x7f",
            FileTruncated,
            "section 0, byte 4096: the data need 90194313218",
        ),
        (
            PARTIAL,
            b"\xff\xff\xff\x7f",
            HeaderMalformed,
            "section 0, byte 4096: the section has 3 buckets, stored",
        ),
        (
            PARTIAL,
            b"\x00",
            HeaderMalformed,
            "section 0, byte 4096: the section has 12 splats in 1 full and 0",
        ),
        (4096 + 40, b"\x03", HeaderMalformed, "section 0, byte 4096: the SH degree is 3\n"),
        (
            BLOCK,
            b"\0\0\xc0\x7f",
            HeaderMalformed,
            "section 0, byte 4096: the section has 3 buckets, stored in 12 byt",
        ),
        (5120, b"\x09", HeaderMalformed, "bucket lengths, byte 5120: a bucket holds 9 splats\n"),
        (
            5120,
            b"\x01",
            HeaderMalformed,
            "bucket lengths, byte 5120: the section has 12 splats, its buckets 11",
        ),
    ],
)
def test_inconsistent_ksplat_is_refused(tmp_path, offset, value, kind, text):
    content = bytearray(ksplat(scene(12, 1), 1))
    content[offset : offset + len(value)] = value
    file = tmp_path / "bad.ksplat"
    file.write_bytes(content)
    with pytest.raises(FormatError) as caught:
        read_ksplat(file)
    assert str(caught.value).removeprefix(f"{file}: ").startswith(text)
    assert type(caught.value) is kind


def test_every_truncated_file_is_refused(tmp_path):
    content = ksplat(scene(12, 1), 1)
    file = tmp_path / "short.ksplat"
    for size in (1, 4095, 4097, 5119, 5121, 5160, len(content) - 1):
        file.write_bytes(content[:size])
        with pytest.raises(FileTruncated):
            read_ksplat(file)


@pytest.mark.parametrize("level", LEVELS)
def test_bytes_after_the_last_section_are_named(tmp_path, level):
    file = tmp_path / "a.ksplat"
    content = ksplat(scene(9, 1), level)
    file.write_bytes(content)
    expected = read_ksplat(file)
    file.write_bytes(content + bytes(70))
    with pytest.warns(FormatWarning, match="not used: 70 bytes after the last section"):
        assert_near(read_ksplat(file), expected)
