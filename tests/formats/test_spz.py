import gzip
import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.formats import (
    ArchiveDamaged,
    FileTruncated,
    FormatError,
    FormatNotRecognised,
    FormatWarning,
    HeaderMalformed,
    NotSupported,
    SizeExceeded,
    Splats,
    ValueInvalid,
    read_ply,
    read_spz,
    write_spz,
)
from gsgen.formats.spz import zstd
from support.commands import shared
from support.splat_files import FIELDS, GOLDENS, assert_near, scene

VERSIONS = [1, 2, 3, 4]


def naive_read(content: bytes) -> Splats:
    """Versions 1 to 3 of degree 0 to 3, one number at a time, as the format describes them."""
    body = gzip.decompress(content)
    _, version, count, degree, fraction, flags = struct.unpack_from("<IIIBBB", body)
    at = 16
    sh_count = (degree + 1) ** 2 - 1

    def some(item_size: int) -> list[bytes]:
        nonlocal at
        rows = [body[at + item_size * row : at + item_size * (row + 1)] for row in range(count)]
        at += item_size * count
        return rows

    def coordinate(part: bytes) -> float:
        return int.from_bytes(part, "little", signed=True) / 2**fraction

    if version == 1:
        places = [struct.unpack("<3e", row) for row in some(6)]
    else:
        places = [[coordinate(row[k : k + 3]) for k in (0, 3, 6)] for row in some(9)]
    alphas = [row[0] / 255 for row in some(1)]
    colors = [[(c / 255 - 0.5) / 0.15 for c in row] for row in some(3)]
    scales = [[s / 16 - 10 for s in row] for row in some(3)]
    turns = [naive_turn(row, version) for row in some(4 if version == 3 else 3)]
    higher = [[(b - 128) / 128 for b in row] for row in some(3 * sh_count)]
    assert at == len(body)

    def logit(share: float) -> float:
        return {0.0: -math.inf, 1.0: math.inf}.get(share) or math.log(share / (1 - share))

    # From x right, y up, z back to x right, y down, z forward; 3DGS harmonics of degree 1 are
    # y, z, x, of degree 2 xy, yz, z², xz, x²−y², of degree 3 y, xyz, y, z, x, z, x by parity.
    signs = [-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1][:sh_count]
    sh = [
        [color, *(np.array(row).reshape(sh_count, 3) * np.array(signs)[:, None])]
        for color, row in zip(colors, higher, strict=True)
    ]
    return Splats(
        position=np.array(places, np.float32) * np.float32([1, -1, -1]),
        rotation=np.array(turns, np.float32) * np.float32([1, 1, -1, -1]),
        log_scale=np.array(scales, np.float32),
        logit_opacity=np.array([logit(alpha) for alpha in alphas], np.float32),
        sh=np.array(sh, np.float32).reshape(count, sh_count + 1, 3),
        antialiased=bool(flags & 1),
    )


def naive_turn(row: bytes, version: int) -> list[float]:
    if version < 3:
        x, y, z = (v / 127.5 - 1 for v in row)
        return [math.sqrt(max(0, 1 - x * x - y * y - z * z)), x, y, z]
    word = int.from_bytes(row, "little")
    largest, xyzw = word >> 30, [0.0] * 4
    for index in (3, 2, 1, 0):
        if index != largest:
            size = (word & 511) / 511 / math.sqrt(2)
            xyzw[index] = -size if word & 512 else size
            word >>= 10
    xyzw[largest] = math.sqrt(max(0, 1 - sum(v * v for v in xyzw)))
    return [xyzw[3], *xyzw[:3]]


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("version", [1, 2, 3])
def test_spz_agrees_with_a_slow_decoder(tmp_path, version, degree):
    file = tmp_path / "a.spz"
    write_spz(file, scene(9, degree, antialiased=degree == 1), version=version)
    here, reference = read_spz(file), naive_read(file.read_bytes())
    assert_near(here, reference, rotation=2e-7, opacities=1e-7, log_scale=1e-6, sh=1e-6)
    assert here.antialiased is reference.antialiased is (degree == 1)


@pytest.mark.parametrize("name", ["scene.v3.spz", "scene.v4.spz"])
def test_splat_transform_reads_its_files_alike(name):
    assert_near(read_spz(GOLDENS / name), read_ply(GOLDENS / f"{name}.decoded.ply"))


@pytest.mark.parametrize("version", [3, 4])
def test_the_code_of_the_format_reads_degree_4_alike(version):
    name = f"degree-4.v{version}.spz"
    splats = read_spz(GOLDENS / name)
    assert splats.antialiased
    assert_near(splats, read_ply(GOLDENS / f"{name}.decoded.ply"), opacities=1e-7)


@pytest.mark.parametrize("version", [3, 4])
def test_the_code_of_the_format_rounds_alike(tmp_path, version):
    file = tmp_path / "a.spz"
    write_spz(file, read_ply(GOLDENS / "degree-4.ply"), version=version)
    assert_near(read_spz(file), read_spz(GOLDENS / f"degree-4.v{version}.spz"), rotation=0)


def test_spz_and_ply_of_one_training_agree():
    name = "data/twins/test-splat.3-points-from-train"
    with pytest.warns(FormatWarning, match="not used: properties nx, ny, nz"):
        source_splats = read_ply(shared(f"{name}.ply"))
    twin = read_spz(shared(f"{name}.spz"))
    rounded = {"position": 1 / 8000, "rotation": 0.02, "log_scale": 1 / 31}
    assert_near(source_splats, twin, **rounded, opacities=1 / 509, sh=0.067)


@pytest.mark.parametrize("name", ["raw", "v2", "v3", "v4"])
def test_spz_versions_of_one_scene_agree(name):
    splats = read_spz(shared(f"data/twins/minimal-{name}.spz"))
    z = 1 if name in ("raw", "v2") else -1  # of these two the axes were never turned
    places = [[-1, 0, z], [0, 0, z], [-1, 0, 0], [0, 0, 0]]
    np.testing.assert_array_equal(splats.position, places)
    np.testing.assert_array_equal(splats.log_scale, np.full((4, 3), -2.3125))


ROTATION_STEP = {1: 1 / 127.5, 2: 1 / 127.5, 3: 1 / 511 / math.sqrt(2), 4: 1 / 511 / math.sqrt(2)}


@settings(max_examples=25, deadline=None)
@given(
    version=st.sampled_from(VERSIONS),
    degree=st.integers(0, 4),
    seed=st.integers(0, 2**32 - 1),
    flag=st.booleans(),
    bits=st.tuples(st.integers(1, 8), st.integers(1, 8)),
)
def test_round_trip_error_is_within_half_a_step(
    tmp_path_factory, version, degree, seed, flag, bits
):
    splats = scene(6, degree, seed, antialiased=flag)
    file = tmp_path_factory.getbasetemp() / "round.spz"
    write_spz(file, splats, version=version, sh_bits=bits)
    restored = read_spz(file)
    assert restored.antialiased is flag
    reach = np.abs(splats.position).max()
    half = 1 / 8192 if version > 1 else reach / 2048
    assert np.abs(restored.position - splats.position).max() <= half * 1.001
    assert np.abs(restored.log_scale - np.maximum(splats.log_scale, -10)).max() <= 1 / 32 + 1e-6
    opacity = [1 / (1 + np.exp(-scene_splats.logit_opacity)) for scene_splats in (splats, restored)]
    assert np.abs(opacity[0] - opacity[1]).max() <= 1 / 510 + 1e-6
    constant = np.clip(splats.sh[:, 0], -0.5 / 0.15, 0.5 / 0.15)
    assert np.abs(restored.sh[:, 0] - constant).max() <= 1 / 510 / 0.15 + 1e-6
    for part, bit_count in ((slice(1, 4), bits[0]), (slice(4, None), bits[1])):
        width = 2 ** (8 - bit_count)
        cut = np.clip(splats.sh[:, part], -1, 127 / 128)
        apart = np.abs(restored.sh[:, part] - cut).max(initial=0)
        # Half a bucket, and half a step of the rounding before it.
        assert apart <= (width / 2 + 0.5) / 128


@settings(max_examples=25, deadline=None)
@given(version=st.sampled_from(VERSIONS), seed=st.integers(0, 2**32 - 1))
def test_rotations_come_back_as_close_as_the_bits_allow(tmp_path_factory, version, seed):
    splats = scene(40, 0, seed)
    file = tmp_path_factory.getbasetemp() / "turned.spz"
    write_spz(file, splats, version=version)
    restored = read_spz(file).rotation.astype(np.float64)
    unit_rotations = splats.rotation / np.linalg.norm(splats.rotation, axis=1, keepdims=True)
    dots = np.abs(np.sum(unit_rotations * restored, axis=1))
    # Half a step for each stored component; where w is near 0, bytes lose more of it.
    max_rotation_error = 0.02 if version <= 2 else 1.5 * (ROTATION_STEP[version] / 2) ** 2 * 4
    assert 1 - dots.min() <= max_rotation_error


def test_rewriting_gives_the_same_bytes(tmp_path):
    first, other = tmp_path / "one.spz", tmp_path / "other.spz"
    for version in (2, 3, 4):
        write_spz(first, scene(20, 2), version=version)
        write_spz(other, read_spz(first), version=version)
        assert first.read_bytes() == other.read_bytes()


@pytest.mark.parametrize(
    ("reach", "step"), [(2047.5, 1 / 4096), (2049, 1 / 2048), (8e6, 1.0), (0, 1 / 4096)]
)
def test_a_large_scene_gets_larger_steps(tmp_path, reach, step):
    position = np.float32([[reach, -reach, 0], [0.3, 0.3, 0.3]])
    splats = scene(2, 0)
    large_scene = Splats(
        position=position,
        rotation=splats.rotation,
        log_scale=splats.log_scale,
        logit_opacity=splats.logit_opacity,
        sh=splats.sh,
    )
    write_spz(tmp_path / "big.spz", large_scene)
    restored = read_spz(tmp_path / "big.spz").position
    assert np.abs(restored - position).max() <= step / 2
    np.testing.assert_array_equal(restored / step, np.rint(restored / step))


@pytest.mark.parametrize("version", VERSIONS)
def test_extreme_values_are_clamped(tmp_path, version):
    original = scene(3, 1)
    odd = Splats(
        position=original.position,
        rotation=np.float32([[1e-30, 0, 0, 0], [-1, 0, 0, 0], [1e-30, 0, 1e-30, 0]]),
        log_scale=np.float32([[-np.inf, -20, 9]] * 3),
        logit_opacity=np.float32([np.inf, -np.inf, 0]),
        sh=np.float32([[[9, -9, 0]] * 4] * 3),
    )
    write_spz(tmp_path / "odd.spz", odd, version=version)
    restored = read_spz(tmp_path / "odd.spz")
    np.testing.assert_array_equal(restored.log_scale, [[-10, -10, 5.9375]] * 3)
    np.testing.assert_array_equal(restored.logit_opacity[:2], [np.inf, -np.inf])
    assert np.abs(restored.rotation[0, 0]) > 0.9999
    assert np.abs(restored.rotation[1, 0]) > 0.9999
    half = math.sqrt(0.5)
    np.testing.assert_allclose(np.abs(restored.rotation[2]), [half, 0, half, 0], atol=0.01)
    np.testing.assert_allclose(restored.sh[0, 1], [1, -1, 0], atol=1 / 16)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"version": 0}, "version: the version of SPZ is 0\nexpected 1, 2, 3 or 4"),
        ({"version": 5}, "version: the version of SPZ is 5\nexpected 1, 2, 3 or 4"),
        ({"sh_bits": (0, 4)}, "sh_bits: the SH bits are (0, 4)\nexpected two numbers, 1 to 8"),
    ],
)
def test_invalid_options_are_refused(tmp_path, change, text):
    with pytest.raises(ValueInvalid) as caught:
        write_spz(tmp_path / "a.spz", scene(1, 0), **change)
    assert str(caught.value) == f"{tmp_path / 'a.spz'}: {text}"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("version", "reach"), [(1, 7e4), (3, 1e7)])
def test_a_scene_beyond_the_format_is_refused(tmp_path, version, reach):
    original = scene(1, 0)
    far = Splats(
        position=np.full((1, 3), reach, np.float32),
        rotation=original.rotation,
        log_scale=original.log_scale,
        logit_opacity=original.logit_opacity,
        sh=original.sh,
    )
    with pytest.raises(ValueInvalid, match="scale the scene down"):
        write_spz(tmp_path / "a.spz", far, version=version)


def refusal(tmp_path, content: bytes, kind: type[FormatError], **options: int) -> str:
    file = tmp_path / "bad.spz"
    file.write_bytes(content)
    with pytest.raises(FormatError) as caught:
        read_spz(file, **options)
    assert type(caught.value) is kind
    return str(caught.value).removeprefix(f"{file}: ")


def plain_file(**change: int) -> bytes:
    """A header, and too little behind it."""
    fields = {"version": 3, "count": 2, "degree": 0, "fraction": 12, "flags": 0} | change
    head = struct.pack(
        "<4sIIBBBB", b"NGSP", *(fields[k] for k in ("version", "count", "degree")),
        fields["fraction"], fields["flags"], 0,
    )  # fmt: skip
    return gzip.compress(head + bytes(40))


@pytest.mark.parametrize(
    ("change", "kind", "text"),
    [
        ({"version": 0}, NotSupported, "byte 4: the file has SPZ version 0\nexpected 1, 2, 3 or 4"),
        (
            {"version": 4},
            HeaderMalformed,
            "byte 4: the gzip file has SPZ version 4\nexpected 1, 2 or 3",
        ),
        ({"count": 0}, ValueInvalid, "byte 8: the file has 0 splats\nexpected at least one"),
        ({"degree": 5}, HeaderMalformed, "byte 12: the SH degree is 5\nexpected 0 to 4"),
        (
            {"fraction": 25},
            HeaderMalformed,
            "byte 13: the positions have 25 fractional bits\nexpected 0 to 24",
        ),
        (
            {"count": 3},
            FileTruncated,
            "3 splats, unpacked: the data need 60 bytes from byte 16 on, but 40 are left\n"
            "expected a file of 76 bytes or more; it has 56\ncopy or download the file again",
        ),
        (
            {"count": 1},
            HeaderMalformed,
            "unpacked data: the file has more than the 36 bytes of 1 splats of degree 0\n"
            "expected 36 bytes\ncopy or download the file again",
        ),
    ],
)
def test_invalid_header_is_refused(tmp_path, change, kind, text):
    assert refusal(tmp_path, plain_file(**change), kind) == text


def test_a_count_beyond_what_gzip_can_hold_is_refused_before_unpacking(tmp_path):
    bomb = plain_file(count=2**31)
    text = refusal(tmp_path, bomb, FileTruncated)
    assert text.startswith(
        f"byte 8: the header declares {2**31} splats in a file of {len(bomb)} bytes\nexpected "
    )


def test_unpacked_size_beyond_the_limit_is_refused(tmp_path):
    write_spz(tmp_path / "a.spz", scene(50, 0))
    content = (tmp_path / "a.spz").read_bytes()
    text = refusal(tmp_path, content, SizeExceeded, max_bytes=1000)
    assert text.startswith("the file unpacks to 1016 bytes\nexpected 1000 bytes or fewer\n")


def test_other_files_are_not_recognised(tmp_path):
    assert refusal(tmp_path, gzip.compress(bytes(99)), FormatNotRecognised).startswith(
        "this is a file that begins with zeros"
    )
    assert refusal(tmp_path, b"\xfe\xffcd" + bytes(60), FormatNotRecognised).startswith(
        "first bytes"
    )


def test_damaged_data_is_refused(tmp_path):
    for version in (3, 4):
        write_spz(tmp_path / "a.spz", scene(50, 1), version=version)
        content = bytearray((tmp_path / "a.spz").read_bytes())
        content[len(content) // 2] ^= 255
        assert "cannot be unpacked" in refusal(tmp_path, bytes(content), ArchiveDamaged)


def with_record(kind: int, payload: bytes) -> bytes:
    content = (GOLDENS / "degree-4.v4.spz").read_bytes()
    head = bytearray(content[:32])
    record = struct.pack("<II", kind, len(payload)) + payload
    head[14] |= 2
    head[16:20] = struct.pack("<I", 32 + len(record))
    return bytes(head) + record + content[32:]


def test_a_declared_coordinate_system_is_followed(tmp_path):
    file = tmp_path / "luf.spz"
    file.write_bytes(with_record(0xADBE0003, struct.pack("<I", 7)))
    original, turned = read_spz(GOLDENS / "degree-4.v4.spz"), read_spz(file)
    # Left up forward, where right up back was meant: to PLY −x −y z instead of x −y −z.
    np.testing.assert_array_equal(turned.position, original.position * [-1, 1, -1])
    file.write_bytes(with_record(0xADBE0003, struct.pack("<I", 4)))
    np.testing.assert_array_equal(read_spz(file).position, original.position)


def test_a_space_of_swapped_axes_is_refused(tmp_path):
    text = refusal(tmp_path, with_record(0xADBE0003, struct.pack("<I", 9)), NotSupported)
    assert text.startswith("extension SPZ_ADOBE_coordinate_system: the coordinate system is 9\n")


def test_an_unknown_extension_is_warned_of(tmp_path):
    file = tmp_path / "a.spz"
    file.write_bytes(with_record(0x12345, b"abc"))
    with pytest.warns(FormatWarning, match="not used: extension 0x12345"):
        read_spz(file)
    file.write_bytes(with_record(0xADBE0002, bytes(12)))
    read_spz(file)  # a camera changes nothing


@pytest.mark.parametrize(
    ("offset", "value", "text"),
    [
        (
            15,
            5,
            "byte 15: the SPZ file has 5 attribute streams\nexpected 6, one for each attribute",
        ),
        (16, 8, "byte 16: the table of contents is at byte 8\nexpected byte 32 or more"),
        (40, 1, "byte 40: stream positions unpacks to 257 bytes\nexpected 360 bytes"),
    ],
)
def test_invalid_table_of_contents_is_refused(tmp_path, offset, value, text):
    content = bytearray((GOLDENS / "scene.v4.spz").read_bytes())
    content[offset] = value
    assert refusal(tmp_path, bytes(content), HeaderMalformed) == text


def test_unreadable_scenes_are_not_written(tmp_path):
    splat = scene(1, 0)
    repeated = Splats(**{name: np.repeat(getattr(splat, name), 200_000, axis=0) for name in FIELDS})
    with pytest.raises(FileTruncated, match="200000 splats in a file of"):
        write_spz(tmp_path / "a.spz", repeated, version=4)
    assert not list(tmp_path.iterdir())
    write_spz(tmp_path / "a.spz", repeated, version=3)
    assert len(read_spz(tmp_path / "a.spz")) == 200_000


def test_zstd_needs_its_package(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "zstandard", None)
    with pytest.raises(NotSupported) as caught:
        read_spz(GOLDENS / "scene.v4.spz")
    assert str(caught.value).endswith("pip install 'gsgen[formats]'")
    with pytest.raises(NotSupported):
        write_spz(tmp_path / "a.spz", scene(1, 0), version=4)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("axes", ["RUB", "RDF", "luf", "LDB"])
def test_other_axes_are_read_as_they_were_written(tmp_path, axes):
    splats = scene(40, 2)
    write_spz(tmp_path / "plain.spz", splats)
    write_spz(tmp_path / "a.spz", splats, axes=axes)
    expected = read_spz(tmp_path / "plain.spz")
    restored = read_spz(tmp_path / "a.spz", axes=axes)
    # Steps are not symmetric about zero: the other sign rounds to the next one.
    assert_near(restored, expected, rotation=0.004, sh=2**-3)
    if axes == "RDF":  # numbers in the file are those of the PLY, which readers take for RUB
        turned = read_spz(tmp_path / "a.spz")
        np.testing.assert_allclose(turned.position * [1, -1, -1], expected.position)


@pytest.mark.parametrize("axes", ["", "RU", "URB", "XYZ", "RUBB"])
def test_invalid_axes_are_refused(tmp_path, axes):
    with pytest.raises(ValueInvalid, match="expected R or L, U or D, F or B"):
        write_spz(tmp_path / "a.spz", scene(3, 0), axes=axes)


@pytest.mark.parametrize(("size", "words"), [(999, "more than 999"), (1001, "1000"), (0, "more")])
def test_zstd_data_of_another_size_is_refused(size, words):
    with pytest.raises(ArchiveDamaged, match=f"unpacks to {words}") as caught:
        zstd.unpack(zstd.pack(bytes(1000)), size, "the body")
    assert caught.value.expected == f"{size}"
    assert zstd.unpack(zstd.pack(bytes(1000)), 1000, "the body") == bytes(1000)


@pytest.mark.parametrize(
    ("version", "offset", "value", "note"),
    [
        *((version, 14, 0x04, "flags 0x04 of the header") for version in (1, 2, 3, 4)),
        *((version, 14, 0x81, "flags 0x80 of the header") for version in (1, 4)),
        *((version, 15, 0x07, "reserved bytes 07") for version in (1, 2, 3)),
        (4, 31, 0x02, "reserved bytes 00 00 00 00 00 00 00 00 00 00 00 02"),
    ],
)
def test_undefined_bits_of_a_header_are_named(tmp_path, version, offset, value, note):
    is_long_header = version == 4
    file = tmp_path / "a.spz"
    write_spz(file, scene(9, 1), version=version)
    content = file.read_bytes() if is_long_header else gzip.decompress(file.read_bytes())
    expected = read_spz(file)
    changed = content[:offset] + bytes([value]) + content[offset + 1 :]
    file.write_bytes(changed if is_long_header else gzip.compress(changed))
    with pytest.warns(FormatWarning, match=f"not used: {note}"):
        assert_near(read_spz(file), expected)


def test_bytes_after_the_gzip_stream_are_named(tmp_path):
    file = tmp_path / "a.spz"
    write_spz(file, scene(9, 1), version=3)
    file.write_bytes(file.read_bytes() + bytes(5))
    with pytest.warns(FormatWarning, match="not used: 5 bytes after the end of the gzip stream"):
        read_spz(file)
