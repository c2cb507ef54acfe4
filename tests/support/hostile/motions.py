"""Motion files that are damaged, or whose few bytes declare more than memory holds."""

import io
import os
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

POSES = np.zeros((5, 24, 3))


def npy_bytes(shape: str, descr: str = "'<f8'", data: bytes = b"", order: str = "False") -> bytes:
    """Return an .npy file whose header has these texts, whatever its data are."""
    return npy_of(f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}", data)


def npy_of(header: str, data: bytes = b"", version: bytes = b"\x01\x00") -> bytes:
    """Return an .npy file with a header of any text."""
    text = header.encode("latin-1") + b"\n"
    size = struct.pack("<H" if version[0] == 1 else "<I", len(text))
    return b"\x93NUMPY" + version + size + text + data


def array_bytes(array: np.ndarray = POSES) -> bytes:
    """Return an array as ``np.save`` writes it."""
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def archive_bytes(compression: int = zipfile.ZIP_STORED, **arrays: bytes) -> bytes:
    """Return an .npz file of .npy files."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as archive:
        for name, content in arrays.items():
            archive.writestr(f"{name}.npy", content)
    return stream.getvalue()


def zeros_bytes(numbers: int, descr: str = "'<f8'") -> bytes:
    """Return a compressed .npz file of many zeros, a thousandth of their size."""
    stream, head = io.BytesIO(), npy_bytes(f"({numbers},)", descr)
    size = np.dtype(descr.strip("'")).itemsize
    with (
        zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("poses.npy", "w", force_zip64=True) as entry,
    ):
        entry.write(head)
        block = bytes(1 << 20)
        left = numbers * size
        while left:
            entry.write(block[: min(left, len(block))])
            left -= min(left, len(block))
    return stream.getvalue()


def _changed(content: bytes, old: bytes, new: bytes) -> bytes:
    assert old in content
    return content.replace(old, new)


def _wrong_crc() -> bytes:
    content = bytearray(archive_bytes(poses=array_bytes(np.full((5, 24, 3), 0.25))))
    content[400] ^= 1  # a byte of the numbers
    return bytes(content)


def _cut_stream() -> bytes:
    content = bytearray(archive_bytes(zipfile.ZIP_DEFLATED, poses=array_bytes(_noise())))
    content[300:400] = bytes(100)  # in the middle of the compressed bytes
    return bytes(content)


def _noise() -> np.ndarray:
    return np.random.default_rng(0).uniform(-1, 1, (5, 24, 3))


def _encrypted() -> bytes:
    content = bytearray(archive_bytes(poses=array_bytes()))
    for magic, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        content[content.index(magic) + offset] |= 1
    return bytes(content)


def _other_compression() -> bytes:
    content = bytearray(archive_bytes(poses=array_bytes()))
    for magic, offset in ((b"PK\x03\x04", 8), (b"PK\x01\x02", 10)):
        content[content.index(magic) + offset] = 99
    return bytes(content)


def _short_entry() -> bytes:
    """An entry whose declared size is larger than its bytes."""
    content = array_bytes()
    return archive_bytes(poses=_changed(content, b"(5, 24, 3)", b"(9, 24, 3)"))


def _objects() -> bytes:
    stream = io.BytesIO()
    np.savez(stream, poses=np.asarray([{"a": 1}], object))
    return stream.getvalue()


HUGE = "(1099511627776, 24, 3)"
MOTIONS: dict[str, Callable[[], bytes]] = {
    "nothing.npz": lambda: b"",
    "text.npz": lambda: b"frame 1\n0 0 0\n",
    "text.npy": lambda: b"frame 1\n0 0 0\n",
    "zeros_of_128_mb.npz": lambda: zeros_bytes(1 << 24),
    "bytes_of_32_mb.npz": lambda: zeros_bytes(1 << 25, "'|u1'"),
    "cut.npz": lambda: archive_bytes(poses=array_bytes())[:-40],
    "cut_at_the_start.npz": lambda: archive_bytes(poses=array_bytes())[:100],
    "wrong_crc.npz": _wrong_crc,
    "broken_stream.npz": _cut_stream,
    "encrypted.npz": _encrypted,
    "unknown_compression.npz": _other_compression,
    "lzma.npz": lambda: archive_bytes(zipfile.ZIP_LZMA, poses=array_bytes()),
    "no_header.npz": lambda: archive_bytes(poses=b"\x93NUMPY"),
    "not_an_array.npz": lambda: archive_bytes(poses=b"hello"),
    "longer_than_its_entry.npz": _short_entry,
    "objects.npz": _objects,
    "huge_shape.npz": lambda: archive_bytes(poses=npy_bytes(HUGE)),
    "other_names.npz": lambda: archive_bytes(a=array_bytes(), b=array_bytes()),
    "nested_names.npz": lambda: archive_bytes(**{"a/poses": array_bytes(), "../b": array_bytes()}),
    "no_arrays.npz": lambda: archive_bytes(),
    "rate_is_empty.npz": lambda: archive_bytes(
        poses=array_bytes(), mocap_framerate=array_bytes(np.zeros(0))
    ),
    "rate_is_a_text.npz": lambda: archive_bytes(
        poses=array_bytes(), mocap_framerate=array_bytes(np.asarray("fast"))
    ),
    "huge_shape.npy": lambda: npy_bytes(HUGE),
    "negative_shape.npy": lambda: npy_bytes("(-5, -24, 3)", data=bytes(5 * 24 * 3 * 8)),
    "shape_of_texts.npy": lambda: npy_bytes("('5',)", data=bytes(40)),
    "shape_beyond_64_bits.npy": lambda: npy_bytes(f"({1 << 70},)"),
    "many_axes.npy": lambda: npy_bytes(f"({'1, ' * 200})", data=bytes(8)),
    "fortran_order_cut.npy": lambda: npy_bytes("(5, 24, 3)", data=bytes(100), order="True"),
    "order_is_a_number.npy": lambda: npy_bytes("(5,)", data=bytes(40), order="7"),
    "records.npy": lambda: npy_bytes("(5,)", "[('a', '<f8'), ('b', '<i4')]", bytes(60)),
    "nothing_a_million_times.npy": lambda: npy_bytes(f"({1 << 39},)", "'|V0'"),
    "dtype_of_a_gigabyte.npy": lambda: npy_bytes("(5,)", "'|S1073741824'"),
    "unknown_dtype.npy": lambda: npy_bytes("(5,)", "'<q99'"),
    "objects.npy": lambda: npy_bytes("()", "'|O'", b"\x80\x04N."),
    "dates.npy": lambda: npy_bytes("(5, 24, 3)", "'<M8[s]'", bytes(5 * 24 * 3 * 8)),
    "texts.npy": lambda: array_bytes(np.full((5, 24, 3), "a")),
    "complex.npy": lambda: array_bytes(POSES.astype(complex)),
    "not_numbers.npy": lambda: array_bytes(np.full((5, 24, 3), np.nan)),
    "no_axes.npy": lambda: array_bytes(np.asarray(1.0)),
    "empty.npy": lambda: array_bytes(np.zeros((0, 24, 3))),
    "five_axes.npy": lambda: array_bytes(np.zeros((1, 1, 1, 24, 3))),
    "code_in_the_header.npy": lambda: npy_of("__import__('os').system('true')"),
    "nested_header.npy": lambda: npy_of("(" * 5000 + ")" * 5000),
    "long_header.npy": lambda: npy_of("{" + " " * 60000 + "}"),
    "unknown_version.npy": lambda: npy_of("{}", version=b"\x09\x00"),
    "header_longer_than_the_file.npy": lambda: array_bytes()[:20],
    "trailing_bytes.npy": lambda: array_bytes() + b"more",
    "deep.json": lambda: b"[" * 200_000,
    "ragged.json": lambda: b"[[[0,0,0]],[[0,0]]]",
    "digits.json": lambda: b"[[[" + b"9" * 5000 + b"]]]",
    "half.json": lambda: b'{"poses": [[0, 0',
    "dict_of_dicts.json": lambda: b'{"body_pose": {"a": 1}}',
    "latin1.json": lambda: b"[\xff]",
}
"""File name → its content."""


def write_motion(folder: Path, name: str) -> Path:
    """Write one of the motion files, or the pipe ``pipe.npz`` or ``pipe.json``."""
    path = folder / name
    if path.stem == "pipe":
        os.mkfifo(path)
    else:
        path.write_bytes(MOTIONS[name]())
    return path
