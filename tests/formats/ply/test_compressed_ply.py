import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.formats import (
    FileTruncated,
    FormatError,
    HeaderMalformed,
    PropertyMissing,
    Splats,
    ValueInvalid,
    compressed_order,
    read_ply,
    write_compressed_ply,
)
from gsgen.formats.shared.morton import morton_order
from support.splat_files import GOLDENS, assert_near, opacity, scene, turn_between

C0 = 0.28209479177387814


def naive_read(content: bytes) -> Splats:
    """One number at a time, as the format describes it."""
    head, _, body = content.partition(b"end_header\n")
    counts = {
        line.split()[1]: int(line.split()[2])
        for line in head.decode().splitlines()
        if line.startswith("element")
    }
    sh_rest = head.count(b"f_rest_")
    boxes = [struct.unpack_from("<18f", body, 72 * k) for k in range(counts["chunk"])]
    start = 72 * counts["chunk"]
    rows = []
    for row in range(counts["vertex"]):
        box = boxes[row // 256]
        location, turn, size, color = struct.unpack_from("<4I", body, start + 16 * row)

        def inside(word: int, low: tuple, high: tuple) -> list[float]:
            shares = [(word >> 21) / 2047, (word >> 11 & 1023) / 1023, (word & 2047) / 2047]
            return [a + (b - a) * s for a, b, s in zip(low, high, shares, strict=True)]

        quaternion, largest = [0.0] * 4, turn >> 30
        others = [k for k in range(4) if k != largest]
        for k, shift in zip(others, (20, 10, 0), strict=True):
            quaternion[k] = ((turn >> shift & 1023) / 1023 - 0.5) * math.sqrt(2)
        quaternion[largest] = math.sqrt(max(0, 1 - sum(v * v for v in quaternion)))
        shares = [(color >> shift & 255) / 255 for shift in (24, 16, 8, 0)]
        shown = [a + (b - a) * s for a, b, s in zip(box[12:15], box[15:], shares[:3], strict=True)]
        alpha = shares[3]
        logit = {0: -math.inf, 1: math.inf}.get(alpha) or math.log(alpha / (1 - alpha))
        rows.append(
            (
                inside(location, box[0:3], box[3:6]),
                quaternion,
                inside(size, box[6:9], box[9:12]),
                logit,
                [(c - 0.5) / C0 for c in shown],
            )
        )
    start += 16 * counts["vertex"]

    def harmonic(byte: int) -> float:
        share = {0: 0.0, 255: 1.0}.get(byte, (byte + 0.5) / 256)
        return (share - 0.5) * 8

    sh = np.zeros((len(rows), sh_rest // 3 + 1, 3), np.float32)
    for row, parts in enumerate(rows):
        sh[row, 0] = parts[4]
        stored = [harmonic(b) for b in body[start + sh_rest * row : start + sh_rest * (row + 1)]]
        sh[row, 1:] = np.array(stored).reshape(3, sh_rest // 3).T
    names = ("position", "rotation", "log_scale", "logit_opacity")
    columns = zip(names, list(zip(*rows, strict=True))[:4], strict=True)
    return Splats(**{name: np.array(column, np.float32) for name, column in columns}, sh=sh)


@pytest.mark.parametrize(("count", "degree"), [(1, 0), (9, 1), (256, 2), (257, 3), (30, 4)])
def test_compressed_ply_agrees_with_a_slow_decoder(tmp_path, count, degree):
    file = tmp_path / "a.ply"
    write_compressed_ply(file, scene(count, degree))
    here, reference = read_ply(file), naive_read(file.read_bytes())
    assert isinstance(here, Splats)
    assert_near(here, reference, position=1e-5, log_scale=1e-5, rotation=1e-6, sh=1e-5)


def test_splat_transform_reads_its_file_alike():
    name = "scene.compressed.ply"
    here, reference = read_ply(GOLDENS / name), read_ply(GOLDENS / f"{name}.decoded.ply")
    assert_near(here, reference)


def test_splat_transform_packs_alike(tmp_path):
    """Its order differs from ours, so the rows are matched by their rotations' words."""
    write_compressed_ply(tmp_path / "a.ply", read_ply(GOLDENS / "scene.ply"))
    ours, reference_splats = (
        read_ply(tmp_path / "a.ply"),
        read_ply(GOLDENS / "scene.compressed.ply"),
    )
    assert isinstance(ours, Splats)
    assert isinstance(reference_splats, Splats)
    a, b = (np.lexsort(array.sh[:, 1].T) for array in (ours, reference_splats))
    np.testing.assert_array_equal(ours.rotation[a], reference_splats.rotation[b])
    np.testing.assert_array_equal(ours.sh[a, 1:], reference_splats.sh[b, 1:])
    np.testing.assert_allclose(ours.sh[a, 0], reference_splats.sh[b, 0], atol=1e-6)
    np.testing.assert_allclose(ours.position[a], reference_splats.position[b], atol=1e-6)
    np.testing.assert_allclose(ours.log_scale[a], reference_splats.log_scale[b], atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    degree=st.integers(0, 4),
    count=st.sampled_from([1, 2, 255, 256, 257, 600]),
)
def test_round_trip_error_is_within_half_a_step(tmp_path_factory, seed, degree, count):
    splats = scene(count, degree, seed)
    file = tmp_path_factory.getbasetemp() / "round.ply"
    write_compressed_ply(file, splats)
    restored, order = read_ply(file), compressed_order(splats)
    assert isinstance(restored, Splats)
    assert sorted(order) == list(range(count))
    steps = np.array([2047, 1023, 2047])
    for name in ("position", "log_scale"):
        before, after = getattr(splats, name)[order].astype(float), getattr(restored, name)
        for index in range(0, count, 256):
            part = slice(index, index + 256)
            half = np.ptp(before[part], axis=0) / steps / 2
            assert (np.abs(before[part] - after[part]) <= half + 2e-6).all()
    assert np.abs(opacity(splats)[order] - opacity(restored)).max() <= 1 / 509
    assert turn_between(splats.rotation[order], restored.rotation) <= 2 * math.sqrt(2) / 1023
    color = splats.sh[order, 0]
    for index in range(0, count, 256):
        part = slice(index, index + 256)
        half = np.ptp(color[part], axis=0) / 255 / 2
        assert (np.abs(color[part] - restored.sh[part, 0]) <= half + 2e-6).all()
    assert np.abs(splats.sh[order, 1:] - restored.sh[:, 1:]).max(initial=0) <= 1 / 64 + 1e-6


def test_a_point_and_a_plane_have_boxes_without_size(tmp_path):
    original = scene(3, 0)
    flat = Splats(
        position=np.float32([[1, 2, 3]] * 3),
        rotation=original.rotation,
        log_scale=np.float32([[-np.inf, -30, 30]] * 3),
        logit_opacity=np.float32([np.inf, -np.inf, 0]),
        sh=original.sh,
    )
    write_compressed_ply(tmp_path / "a.ply", flat)
    restored = read_ply(tmp_path / "a.ply")
    assert isinstance(restored, Splats)
    np.testing.assert_array_equal(restored.position, flat.position)
    np.testing.assert_array_equal(restored.log_scale, [[-20, -20, 20]] * 3)
    np.testing.assert_array_equal(restored.logit_opacity[:2], [np.inf, -np.inf])


def test_old_files_have_no_boxes_of_colours(tmp_path):
    splats = scene(5, 0)
    write_compressed_ply(tmp_path / "new.ply", splats)
    content = (tmp_path / "new.ply").read_bytes()
    head, _, body = content.partition(b"end_header\n")
    for end in ("min", "max"):
        for channel in "rgb":
            head = head.replace(f"property float {end}_{channel}\n".encode(), b"")
    (tmp_path / "old.ply").write_bytes(head + b"end_header\n" + body[:48] + body[72:])
    old = read_ply(tmp_path / "old.ply")
    assert isinstance(old, Splats)
    words = struct.iter_unpack("<4I", body[72:])
    shown = [[(word[3] >> shift & 255) / 255 for shift in (24, 16, 8)] for word in words]
    np.testing.assert_allclose(0.5 + C0 * old.sh[:, 0], shown, atol=1e-6)


def test_the_order_follows_the_curve():
    corners = np.float32([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    shuffled = np.random.default_rng(0).permutation(8)
    np.testing.assert_array_equal(corners[shuffled][morton_order(corners[shuffled])], corners)
    same = np.ones((5, 3), np.float32)
    np.testing.assert_array_equal(morton_order(same), np.arange(5))


def edited(tmp_path, before: bytes, after: bytes, *, degree: int = 1) -> str:
    """The text of the error over a file in which ``before`` was replaced."""
    file = tmp_path / "bad.ply"
    write_compressed_ply(file, scene(300, degree))
    content = file.read_bytes()
    assert before in content
    file.write_bytes(content.replace(before, after, 1))
    with pytest.raises(FormatError) as caught:
        read_ply(file)
    assert caught.value.path == str(file)
    edited.kind = type(caught.value)  # type: ignore[attr-defined]
    return str(caught.value).removeprefix(f"{file}: ")


@pytest.mark.parametrize(
    ("before", "after", "kind", "text"),
    [
        (
            b"chunk 2",
            b"chunk 1",
            HeaderMalformed,
            "element 'chunk': the element has 1 rows\nexpected 2 or more",
        ),
        (
            b"vertex 300",
            b"vertex 0  ",
            ValueInvalid,
            "element 'vertex': the data have 0 splats or points\n",
        ),
        (
            b"sh 300",
            b"sh 299",
            HeaderMalformed,
            "element 'sh': the element has 299 rows\nexpected 300, as vertex has",
        ),
        (
            b"element chunk",
            b"element chank",
            PropertyMissing,
            "the PLY file has no element 'chunk'\n",
        ),
        (
            b"uchar f_rest_8",
            b"uchar f_rest_9",
            PropertyMissing,
            "element 'sh': the properties f_rest_8 are miss",
        ),
        (
            b"property uchar f_rest_8\n",
            b"",
            PropertyMissing,
            "element 'sh': the element has 8 properties\n",
        ),
        (b"uint packed_scale", b"int packed_scale", PropertyMissing, "element 'vertex': "),
        (
            b"float max_b",
            b"int max_b",
            PropertyMissing,
            "element 'chunk': the properties max_b are missing or",
        ),
        (
            b"vertex 300",
            b"vertex 99999999999",
            HeaderMalformed,
            "element 'chunk': the element has 2 rows\n",
        ),
    ],
)
def test_inconsistent_compressed_ply_is_refused(tmp_path, before, after, kind, text):
    assert edited(tmp_path, before, after).startswith(text)
    assert edited.kind is kind  # type: ignore[attr-defined]


def test_a_truncated_file_is_refused(tmp_path):
    file = tmp_path / "short.ply"
    write_compressed_ply(file, scene(20, 1))
    content = file.read_bytes()
    for size in (len(content) - 1, len(content) - 190, len(content) - 500):
        file.write_bytes(content[:size])
        with pytest.raises(FileTruncated):
            read_ply(file)


def test_a_box_of_nan_is_refused(tmp_path):
    file = tmp_path / "nan.ply"
    write_compressed_ply(file, scene(20, 0))
    head, _, body = file.read_bytes().partition(b"end_header\n")
    file.write_bytes(head + b"end_header\n" + struct.pack("<f", math.nan) + body[4:])
    with pytest.raises(
        ValueInvalid, match=r"position\[:, 0\]: 20 of 20 rows are invalid: row 0 is nan"
    ):
        read_ply(file)


def test_ascii_compressed_ply_is_read(tmp_path):
    """No writer makes it, but the header may say so."""
    file = tmp_path / "text.ply"
    write_compressed_ply(file, scene(3, 0))
    splats = read_ply(file)
    head, _, body = file.read_bytes().partition(b"end_header\n")
    lines = [" ".join(f"{v:.9g}" for v in struct.unpack_from("<18f", body))]
    lines += [" ".join(map(str, words)) for words in struct.iter_unpack("<4I", body[72:])]
    text = head.replace(b"binary_little_endian", b"ascii") + b"end_header\n"
    file.write_bytes(text + "\n".join(lines).encode() + b"\n")
    assert isinstance(splats, Splats)
    again = read_ply(file)
    assert isinstance(again, Splats)
    assert_near(splats, again)
