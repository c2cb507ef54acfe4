import io
import subprocess
import sys
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.formats import (
    ArchiveDamaged,
    FormatError,
    FormatNotRecognised,
    FormatWarning,
    NotSupported,
    PackedRows,
    PointCloud,
    PropertyMissing,
    SizeExceeded,
    ValueInvalid,
    read_npz,
)

GAUSSIANS = np.arange(40, dtype=np.float32).reshape(4, 10)
APPEARANCE = np.arange(12, dtype=np.float32).reshape(4, 3)
POINTS = np.arange(12, dtype=np.float32).reshape(4, 3)
COLORS = np.arange(0, 240, 20, dtype=np.uint8).reshape(4, 3)
RETRY_HINT = "copy, download or save the file again"


def saved(file: Path, **arrays: np.ndarray) -> Path:
    np.savez(file, **arrays)
    return file


def zipped(file: Path, **entries: bytes) -> Path:
    """An archive of arrays given as the bytes of their .npy files."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(f"{name}.npy", content)
    return file


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def refusal(file: Path, kind: type[FormatError]) -> str:
    """The text of the error over ``file``, without the path that it begins with."""
    with pytest.raises(FormatError) as caught:
        read_npz(file)
    assert type(caught.value) is kind
    assert caught.value.path == str(file)
    return str(caught.value).removeprefix(f"{file}: ")


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize("halves", [(np.float32, np.float16), (np.float16, np.float16)])
def test_packed_rows_keep_their_data_types(tmp_path, save, halves):
    file = tmp_path / "frame.npz"
    gaussians, appearance = GAUSSIANS.astype(halves[0]), APPEARANCE.astype(halves[1])
    save(file, gaussians=gaussians, appearance=appearance, view=np.eye(4))
    with pytest.warns(FormatWarning, match="not used: array view$"):
        packed = read_npz(file)
    assert isinstance(packed, PackedRows)
    assert (packed.gaussians.dtype, packed.appearance.dtype) == halves
    np.testing.assert_array_equal(packed.gaussians, gaussians)
    np.testing.assert_array_equal(packed.appearance, appearance)


def test_packed_rows_of_any_layout_become_native_and_contiguous(tmp_path):
    file = saved(
        tmp_path / "frame.npz",
        gaussians=np.asfortranarray(GAUSSIANS.astype(">f4")),
        appearance=APPEARANCE.astype(">f2"),
    )
    packed = read_npz(file)
    assert isinstance(packed, PackedRows)
    assert packed.gaussians.dtype == np.float32
    assert packed.gaussians.flags.c_contiguous
    np.testing.assert_array_equal(packed.gaussians, GAUSSIANS)


def test_packed_rows_of_nan_are_read(tmp_path):
    file = saved(tmp_path / "a.npz", gaussians=GAUSSIANS * np.nan, appearance=APPEARANCE)
    assert isinstance(read_npz(file), PackedRows)


@pytest.mark.parametrize("key", ["points", "xyz", "means3d"])
@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_points_with_byte_colours(tmp_path, key, dtype):
    arrays = {key: POINTS.astype(dtype), "colors": COLORS, "Ks": np.zeros((3, 3, 3))}
    with pytest.warns(FormatWarning, match="not used: array Ks$"):
        cloud = read_npz(saved(tmp_path / "cloud.npz", **arrays))
    assert isinstance(cloud, PointCloud)
    np.testing.assert_array_equal(cloud.position, POINTS)
    np.testing.assert_array_equal(cloud.color, COLORS / np.float32(255))


def test_points_with_float_colours(tmp_path):
    color = np.linspace(0, 1, 12).reshape(4, 3)
    cloud = read_npz(saved(tmp_path / "cloud.npz", xyz=POINTS, colors=color))
    assert isinstance(cloud, PointCloud)
    np.testing.assert_array_equal(cloud.color, color.astype(np.float32))


def test_other_arrays_may_be_anything(tmp_path):
    names = np.array(["a", {"b": 1}], dtype=object)
    file = tmp_path / "cloud.npz"
    np.savez(file, points=POINTS, colors=COLORS, names=names)
    with pytest.warns(FormatWarning, match="not used: array names$"):
        assert isinstance(read_npz(file), PointCloud)


@pytest.mark.parametrize(
    ("arrays", "kind", "text"),
    [
        (
            {"gaussians": GAUSSIANS, "colors": COLORS},
            PropertyMissing,
            "the archive holds the arrays gaussians, colors\nexpected gaussians and appearance, "
            "or colors and one of points, xyz, means3d",
        ),
        (
            {"xyz": POINTS, "means3d": POINTS, "colors": COLORS},
            NotSupported,
            "the archive holds several arrays of positions: xyz, means3d\nexpected only one of them",
        ),
        (
            {"gaussians": GAUSSIANS.astype(float), "appearance": APPEARANCE},
            ValueInvalid,
            "gaussians: the array is float64 [4, 10]\nexpected float16 or float32 [n, 10]",
        ),
        (
            {"gaussians": GAUSSIANS, "appearance": APPEARANCE[:3]},
            ValueInvalid,
            "appearance: the array is float32 [3, 3]\nexpected float16 or float32 [4, c]",
        ),
        (
            {"gaussians": GAUSSIANS[:0], "appearance": APPEARANCE[:0]},
            ValueInvalid,
            "array gaussians: the data have 0 splats or points\nexpected at least one\n"
            "the program that wrote the file may have dropped every point",
        ),
        (
            {"xyz": POINTS[:0], "colors": COLORS[:0]},
            ValueInvalid,
            "array xyz: the data have 0 splats or points\nexpected at least one\n"
            "the program that wrote the file may have dropped every point",
        ),
        (
            {"xyz": POINTS.astype(int), "colors": COLORS},
            ValueInvalid,
            "array xyz: the array is int64 [4, 3]\nexpected float [n, 3]",
        ),
        (
            {"xyz": np.float32(3), "colors": COLORS},
            ValueInvalid,
            "array xyz: the array is float32 []\nexpected float [n, 3]",
        ),
        (
            {"xyz": POINTS, "colors": np.zeros((4, 4), np.uint8)},
            ValueInvalid,
            "array colors: the array is uint8 [4, 4]\nexpected uint8 or float [n, 3]",
        ),
        (
            {"xyz": POINTS, "colors": COLORS[:2]},
            ValueInvalid,
            "array colors: the array has 2 rows\nexpected 4, the number of rows of xyz",
        ),
        (
            {"xyz": POINTS, "colors": COLORS.astype(np.float32)},
            ValueInvalid,
            "array colors[:, 0]: 3 of 4 rows are invalid: row 1 is 60\nexpected 0 <= value <= 1\n"
            "store colours from 0 to 255 as bytes (uchar, uint8)",
        ),
        (
            {"xyz": np.full((4, 3), 1e300), "colors": COLORS},
            ValueInvalid,
            "array xyz[:, 0]: 4 of 4 rows are invalid: row 0 is inf\nexpected a finite number",
        ),
        (
            {"xyz": POINTS * np.nan, "colors": COLORS},
            ValueInvalid,
            "array xyz[:, 0]: 4 of 4 rows are invalid: row 0 is nan\nexpected a finite number",
        ),
        (
            {"xyz": POINTS.astype(object), "colors": COLORS},
            NotSupported,
            "array xyz: the array holds Python objects\nexpected numbers\n"
            "save it as an array of one numeric type",
        ),
    ],
)
def test_arrays_that_do_not_fit_are_refused(tmp_path, arrays, kind, text):
    assert refusal(saved(tmp_path / "bad.npz", **arrays), kind) == text


def test_a_file_that_is_no_archive_is_not_recognised(tmp_path):
    file = tmp_path / "bad.npz"
    file.write_bytes(b"\x93NUMPY\x01\x00")
    assert refusal(file, FormatNotRecognised) == (
        "this is a NumPy array\nexpected 50 4b 03 04, the start of an .npz\n"
        "Save named arrays with `np.savez`."
    )


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path):
    file = tmp_path / "bomb.npz"
    np.savez_compressed(file, gaussians=np.zeros((100_000, 10), "f4"), appearance=APPEARANCE)
    assert file.stat().st_size < 10_000
    with pytest.raises(SizeExceeded) as caught:
        read_npz(file, max_bytes=1_000_000)
    assert str(caught.value) == (
        f"{file}: the arrays take 4000000 bytes (gaussians) and 48 bytes (appearance)\n"
        "expected 1000000 bytes or fewer together\n"
        "if you trust the file, read it with a larger max_bytes"
    )


@pytest.mark.parametrize(("spare_bytes", "is_fitting"), [(-1, False), (0, True)])
def test_the_limit_is_on_both_arrays_together(tmp_path, spare_bytes, is_fitting):
    file = saved(tmp_path / "frame.npz", gaussians=GAUSSIANS, appearance=APPEARANCE)
    limit = GAUSSIANS.nbytes + APPEARANCE.nbytes + spare_bytes
    if is_fitting:
        read_npz(file, max_bytes=limit)
    else:
        with pytest.raises(SizeExceeded):
            read_npz(file, max_bytes=limit)


def test_an_array_that_declares_more_than_it_has_is_refused(tmp_path):
    content = npy(GAUSSIANS).replace(b"(4, 10)", b"(9, 10)")
    file = zipped(tmp_path / "lie.npz", gaussians=content, appearance=npy(APPEARANCE))
    assert refusal(file, ArchiveDamaged) == (
        f"array gaussians: the array has 288 bytes, but float32 [9, 10] takes 488, header included\n{RETRY_HINT}"
    )


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"not an array",
        npy(GAUSSIANS)[:20],
        npy(GAUSSIANS).replace(b"(4, 10)", b"(4, 1x)"),
        npy(GAUSSIANS).replace(b"(4, 10)", b"(-4, 1)"),
        npy(GAUSSIANS).replace(b"'<f4'", b"'<q9'"),
        npy(GAUSSIANS).replace(b"\x93NUMPY\x01", b"\x93NUMPY\x03"),
        b"\x93NUMPY\x02\x00\xff\xff\xff\xff" + b" " * 100_000,
        b"\x93NUMPY\x01\x00\x00\x20" + b"(" * 0x2000,
    ],
)
def test_an_array_that_cannot_be_parsed_is_refused(tmp_path, content):
    file = zipped(tmp_path / "bad.npz", gaussians=content, appearance=npy(APPEARANCE))
    text = refusal(file, ArchiveDamaged)
    assert text.startswith("array gaussians: ")
    assert text.endswith(f"\n{RETRY_HINT}")


def test_a_header_of_any_claimed_length_takes_little_memory(tmp_path):
    length = 1 << 25
    bomb = b"\x93NUMPY\x02\x00" + length.to_bytes(4, "little") + b" " * length
    file = zipped(tmp_path / "bomb.npz", gaussians=bomb, appearance=npy(APPEARANCE))
    tracemalloc.start()
    try:
        refusal(file, ArchiveDamaged)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < length / 8


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not limit this memory")
def test_too_little_memory_is_an_error(tmp_path):
    """In a process that may allocate 64 MB more, where the arrays take 400 MB."""
    rows = np.zeros((10_000_000, 10), np.float32)
    np.savez_compressed(tmp_path / "frame.npz", gaussians=rows, appearance=rows[:, :3])
    code = (
        "import resource, sys\n"
        "from gsgen.formats.npz import read_npz\n"
        "from gsgen.formats.shared.errors import SizeExceeded\n"
        "data = int(open('/proc/self/statm').read().split()[5]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_DATA, (data + (64 << 20),) * 2)\n"
        "try: read_npz(sys.argv[1], max_bytes=1 << 40)\n"
        "except SizeExceeded as error: print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "frame.npz"], capture_output=True, text=True
    )
    file, message = tmp_path / "frame.npz", "reading takes more memory than is available"
    assert done.stdout.strip() == f"{file}: array gaussians: {message}", done.stderr


def test_damage_inside_an_array_is_noticed(tmp_path):
    file = saved(tmp_path / "bad.npz", gaussians=GAUSSIANS, appearance=APPEARANCE)
    content = file.read_bytes()
    file.write_bytes(content.replace(GAUSSIANS.tobytes(), GAUSSIANS[::-1].tobytes()))
    assert refusal(file, ArchiveDamaged) == (
        "array gaussians: the archive cannot be unpacked "
        f"(BadZipFile: Bad CRC-32 for file 'gaussians.npy')\n{RETRY_HINT}"
    )


def whole_archives() -> list[bytes]:
    streams = [io.BytesIO(), io.BytesIO()]
    np.savez(streams[0], gaussians=GAUSSIANS, appearance=APPEARANCE)
    np.savez_compressed(streams[1], points=POINTS, colors=COLORS)
    return [stream.getvalue() for stream in streams]


VALID_ARCHIVES = whole_archives()


def read_or_refuse(file: Path, content: bytes) -> bool:
    """Whether ``content`` is read; anything raised but a FormatError fails the test."""
    file.write_bytes(content)
    try:
        read_npz(file)
    except FormatError:
        return False
    return True


@pytest.mark.parametrize("content", VALID_ARCHIVES, ids=["packed", "points"])
def test_every_truncated_archive_is_refused(tmp_path, content):
    assert read_or_refuse(tmp_path / "whole.npz", content)
    shorter = (content[:size] for size in range(0, len(content), 3))
    assert not any(read_or_refuse(tmp_path / "part.npz", part) for part in shorter)


@settings(max_examples=250, deadline=None)
@given(
    content=st.sampled_from(VALID_ARCHIVES),
    edits=st.lists(
        st.tuples(st.integers(4, 900), st.integers(0, 3), st.binary(max_size=3)),
        min_size=1,
        max_size=4,
    ),
)
def test_a_mutated_archive_is_read_or_refused_but_never_crashes(tmp_path_factory, content, edits):
    for offset, removed, inserted in edits:
        content = content[:offset] + inserted + content[offset + removed :]
    read_or_refuse(tmp_path_factory.getbasetemp() / "mutated.npz", content)


def test_a_header_that_numpy_distrusts_has_a_message_of_one_line(tmp_path):
    """NumPy refuses headers over 10,000 bytes in three lines, which advise to unpickle."""
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (4, 10), }".ljust(20_000) + b"\n"
    content = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    file = zipped(tmp_path / "long.npz", gaussians=content, appearance=content)
    with pytest.raises(ArchiveDamaged, match=r"length \(20001\) is large") as caught:
        read_npz(file)
    assert "pickle" not in str(caught.value)  # which is on the second line
