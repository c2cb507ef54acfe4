import os
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from gsgen.formats import FileUnwritable, PointCloud, Splats, ValueInvalid, read_ply, write_ply
from gsgen.formats.ply import write
from gsgen.formats.ply.write import PlyFrames

ENCODINGS = ["ascii", "binary_little_endian", "binary_big_endian"]


def naive_read(content: bytes) -> dict[str, list[float]]:
    """The columns of a file of floats and bytes, read one value at a time."""
    head, _, body = content.partition(b"end_header\n")
    lines = head.decode().splitlines()
    encoding = lines[1].split()[1]
    count = int(lines[2].split()[2])
    names = [line.split()[2] for line in lines[3:]]
    codes = ["f" if line.split()[1] == "float" else "B" for line in lines[3:]]
    if encoding == "ascii":
        rows = [[float(word) for word in line.split()] for line in body.splitlines()]
    else:
        order = "<" if "little" in encoding else ">"
        rows = [list(row) for row in struct.iter_unpack(order + "".join(codes), body)]
    assert len(rows) == count
    return {name: [row[i] for row in rows] for i, name in enumerate(names)}


def some_splats(count: int, coefficients: int) -> Splats:
    random = np.random.default_rng(0)

    def draw(*shape: int) -> np.ndarray:
        return random.normal(size=(count, *shape)).astype(np.float32)

    return Splats(
        position=draw(3),
        rotation=draw(4),
        log_scale=draw(3),
        logit_opacity=draw(),
        sh=draw(coefficients, 3),
    )


def some_points(count: int) -> PointCloud:
    position = np.random.default_rng(0).normal(size=(count, 3)).astype(np.float32)
    color = np.arange(3 * count).reshape(count, 3) % 256 / np.float32(255)
    return PointCloud(position, color.astype(np.float32))


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("coefficients", [1, 4, 9, 16, 25])
def test_splats_are_written_under_the_names_of_the_training_code(tmp_path, coefficients, encoding):
    splats = some_splats(3, coefficients)
    file = tmp_path / "splats.ply"
    write_ply(file, splats, format=encoding)
    columns = naive_read(file.read_bytes())

    remaining = coefficients - 1
    expected = dict(zip("xyz", splats.position.T, strict=True))
    expected |= {f"f_dc_{c}": splats.sh[:, 0, c] for c in range(3)}
    expected |= {
        f"f_rest_{i}": splats.sh[:, 1 + i % remaining, i // remaining] for i in range(3 * remaining)
    }
    expected |= {"opacity": splats.logit_opacity}
    expected |= {f"scale_{i}": splats.log_scale[:, i] for i in range(3)}
    expected |= {f"rot_{i}": splats.rotation[:, i] for i in range(4)}
    assert list(columns) == list(expected)
    for name, values in expected.items():
        assert np.float32(columns[name]).tolist() == values.tolist()


def floats_of(*shape: int) -> st.SearchStrategy[np.ndarray]:
    finite = st.floats(width=32, allow_nan=False, allow_infinity=False, max_value=88)
    return arrays.arrays(np.float32, shape, elements=finite)


@settings(max_examples=40, deadline=None)
@given(
    encoding=st.sampled_from(ENCODINGS),
    position=floats_of(2, 3),
    rotation=arrays.arrays(np.float32, (2, 4), elements=st.floats(2**-60, 88, width=32)),
    log_scale=floats_of(2, 3),
    logit_opacity=arrays.arrays(np.float32, 2, elements=st.floats(width=32, allow_nan=False)),
    sh=st.sampled_from([1, 4]).flatmap(lambda count: floats_of(2, count, 3)),
)
def test_splats_come_back_bit_for_bit(tmp_path_factory, encoding, **fields):
    file = tmp_path_factory.getbasetemp() / "round_trip.ply"
    write_ply(file, Splats(**fields), format=encoding)
    splats = read_ply(file)
    for name, field in fields.items():
        assert getattr(splats, name).tobytes() == field.tobytes()


def test_frames_are_written_as_files_alone(tmp_path, monkeypatch):
    """Frames keep, change and lose colours, lose rows, change flags, and fail."""
    frames, first = PlyFrames(), some_splats(50, 16)
    moved = replace(first, position=first.position + 1, logit_opacity=first.logit_opacity * 2)
    turned = replace(moved, rotation=first.rotation[::-1].copy(), log_scale=first.log_scale - 1)
    recolored = replace(turned, sh=first.sh[::-1].copy())
    broken = [
        replace(first, position=np.full_like(first.position, np.nan)),
        replace(first, sh=np.full_like(first.sh, np.inf)),
    ]
    for splats in (
        first, moved, turned, recolored, moved, some_splats(7, 4), some_splats(7, 1), first,
        broken[0], first, broken[1], replace(first, antialiased=True), moved,
    ):  # fmt: skip
        expected, file = tmp_path / "expected.ply", tmp_path / "frame.ply"
        if splats in broken:
            with pytest.raises(ValueInvalid, match=r"frame\.ply"):
                frames.write(file, splats)
            continue
        write_ply(expected, splats)
        frames.write(file, splats)
        assert file.read_bytes() == expected.read_bytes()
    monkeypatch.setattr(write, "_MAX_SH_BYTES", 50 * 16 * 3 * 4 - 1)
    PlyFrames().write(file, moved)
    assert file.read_bytes() == expected.read_bytes()


def test_colors_that_a_frame_keeps_are_not_copied_again(tmp_path):
    frames, splats = PlyFrames(), some_splats(5, 4)
    frames.write(tmp_path / "0.ply", splats)
    splats.sh[2] = 9  # in place, which a caller may not do: the rows of the last file show it
    frames.write(tmp_path / "1.ply", splats)
    assert (tmp_path / "1.ply").read_bytes() == (tmp_path / "0.ply").read_bytes()


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("count", [1, 4095, 4096, 4097])  # both sides of a chunk
def test_points_of_byte_colours_come_back_exactly(tmp_path, encoding, count):
    cloud = some_points(count)
    file = tmp_path / "points.ply"
    write_ply(file, cloud, format=encoding)
    restored = read_ply(file)
    assert isinstance(restored, PointCloud)
    np.testing.assert_array_equal(restored.position, cloud.position)
    np.testing.assert_array_equal(restored.color, cloud.color)
    assert naive_read(file.read_bytes())["blue"][:2] == [2, 5][:count]


def test_other_colours_come_back_to_within_half_a_step(tmp_path):
    color = np.linspace(0, 1, 300, dtype=np.float32).reshape(100, 3)
    file = tmp_path / "points.ply"
    write_ply(file, PointCloud(np.zeros((100, 3), np.float32), color))
    restored = read_ply(file)
    assert isinstance(restored, PointCloud)
    np.testing.assert_allclose(restored.color, color, atol=1 / 510 + 1e-6, rtol=0)


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (
            PointCloud(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)),
            "element 'vertex': the data have 0 splats or points\nexpected at least one\n"
            "the program that wrote the file may have dropped every point",
        ),
        (
            PointCloud(np.full((2, 3), np.nan, np.float32), np.zeros((2, 3), np.float32)),
            "property x: 2 of 2 rows are invalid: row 0 is nan\nexpected a finite number",
        ),
        (
            PointCloud(np.zeros((2, 3), np.float32), np.full((2, 3), 2, np.float32)),
            "property red: 2 of 2 rows are invalid: row 0 is 2\nexpected 0 <= value <= 1\n"
            "store colours from 0 to 255 as bytes (uchar, uint8)",
        ),
    ],
)
def test_unreadable_values_are_not_written(tmp_path, content, text):
    file = tmp_path / "bad.ply"
    with pytest.raises(ValueInvalid) as caught:
        write_ply(file, content)
    assert str(caught.value) == f"{file}: {text}"
    assert not list(tmp_path.iterdir())


def test_an_unknown_format_is_refused(tmp_path):
    file = tmp_path / "a.ply"
    with pytest.raises(ValueInvalid) as caught:
        write_ply(file, some_points(1), format="binary")  # type: ignore[arg-type]
    assert str(caught.value) == (
        f"{file}: format: 'binary'\nexpected ascii, binary_little_endian, binary_big_endian"
    )


def test_a_file_in_place_is_replaced_and_nothing_is_left_behind(tmp_path):
    file = tmp_path / "points.ply"
    file.write_text("old")
    write_ply(file, some_points(2))
    assert isinstance(read_ply(file), PointCloud)
    assert [*tmp_path.iterdir()] == [file]


def test_a_failed_write_leaves_the_old_file_and_no_part(tmp_path, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    file = tmp_path / "points.ply"
    file.write_text("old")
    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(FileUnwritable) as caught:
        write_ply(file, some_points(2))
    assert str(caught.value) == f"{file}: the file cannot be written: No space left on device"
    assert file.read_text() == "old"
    assert [*tmp_path.iterdir()] == [file]


@pytest.mark.parametrize(
    ("location", "reason"), [("no/a.ply", "No such file or directory"), (".", "Is a directory")]
)
def test_unwritable_path_is_named(tmp_path: Path, location, reason):
    with pytest.raises(FileUnwritable) as caught:
        write_ply(tmp_path / location, some_points(1))
    assert caught.value.path == str(tmp_path / location)
    assert reason in str(caught.value)
    assert not list(tmp_path.iterdir())
