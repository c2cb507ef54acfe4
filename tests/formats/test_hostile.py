"""Damaged and hostile files of every format: read or refused, in little memory.

``make fuzz-formats`` does the same thousands of times, in processes of their own.
"""

import gzip
import struct
import tempfile
import tracemalloc
import zlib
from pathlib import Path

import pytest
import zstandard

from fuzz.formats import ANY, read, whole_files
from fuzz.splat_files import draw
from gsgen.formats import FormatError, codec_named, open_splats, write_spz
from support.splat_files import ksplat, scene

with tempfile.TemporaryDirectory() as _folder:
    WHOLE = whole_files(Path(_folder))

MAX_MEMORY = 4 << 20


def peak_while_refusing(file: Path, name: str) -> int:
    """The most memory that the reader held before it refused ``file``."""
    tracemalloc.start()
    try:
        with pytest.raises(FormatError):
            codec_named(name).read(file)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("name", [*WHOLE])
def test_mutants_are_read_or_refused(tmp_path, name):
    file = tmp_path / "mutant"
    kinds = set()
    for index in range(60):
        file.write_bytes(draw(name, 1, index, WHOLE[name]))
        trial = read(name, file)
        assert not trial.failure, f"{name}, mutant {index} of seed 1: {trial.failure}"
        kinds.add(trial.kind)
    assert len(kinds) > 2, "the mutants are not of many kinds"


@pytest.mark.parametrize("name", [name for name in WHOLE if name not in (ANY, "ply", "npz")])
def test_every_truncated_file_is_refused(tmp_path, name):
    file = tmp_path / "short"
    for content in WHOLE[name]:
        for size in {1, 2, 5, 16, 31, 33, 63, *range(64, len(content), len(content) // 20)}:
            if name == "splat" and size % 32 == 0:
                continue  # fewer records are a file, too
            file.write_bytes(content[:size])
            with pytest.raises(FormatError) as caught:
                codec_named(name).read(file)
            assert caught.value.path == str(file)


def test_a_mutant_is_decided_by_its_numbers_alone():
    for name, files in WHOLE.items():
        assert [draw(name, 0, k, files) for k in range(5)] == [
            draw(name, 0, k, files) for k in range(5)
        ]


def huge_counts() -> dict[str, tuple[str, bytes]]:
    """Small files that promise much, by what they do."""
    spz = struct.pack("<4sIIBBBB", b"NGSP", 3, 2**31 - 1, 4, 12, 0, 0) + bytes(64)
    zstd = struct.pack("<4sIIBBBBI12x", b"NGSP", 4, 2**31 - 1, 4, 12, 0, 6, 32) + bytes(96)
    header = b"element vertex 99999999999\nproperty float x\n"
    words = b"".join(b"property uint packed_%s\n" % word for word in (b"position", b"rotation"))
    sections = bytearray(ksplat(scene(3, 0), 1))
    sections[4:8] = b"\xff" * 4
    splats = bytearray(ksplat(scene(3, 0), 0))
    splats[4096:4104] = b"\xff\xff\xff\x7f" * 2
    glb = bytearray(WHOLE["glb"][0])
    glb[12:16] = b"\xff\xff\xff\x0f"
    return {
        "spz in gzip": ("spz", gzip.compress(spz)),
        "spz in zstd": ("spz", zstd),
        "ply": ("ply", b"ply\nformat binary_little_endian 1.0\n" + header + b"end_header\n"),
        "compressed ply": (
            "ply",
            b"ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\n"
            + words
            + b"end_header\n",
        ),
        "ksplat sections": ("ksplat", bytes(sections)),
        "ksplat splats": ("ksplat", bytes(splats)),
        "glb": ("glb", bytes(glb)),
    }


@pytest.mark.parametrize("label", [*huge_counts()])
def test_a_huge_count_takes_no_memory(tmp_path, label):
    name, content = huge_counts()[label]
    file = tmp_path / "huge"
    file.write_bytes(content)
    assert peak_while_refusing(file, name) < MAX_MEMORY


def test_a_gzip_bomb_is_unpacked_no_further_than_its_header_says(tmp_path):
    head = struct.pack("<4sIIBBBB", b"NGSP", 3, 10, 0, 12, 0, 0)
    packer = zlib.compressobj(9, wbits=31)
    bomb = packer.compress(head) + packer.compress(bytes(30 << 20)) + packer.flush()
    assert len(bomb) < 40_000
    file = tmp_path / "bomb.spz"
    file.write_bytes(bomb)
    assert peak_while_refusing(file, "spz") < MAX_MEMORY


def test_a_zstd_bomb_is_unpacked_no_further_than_its_header_says(tmp_path):
    file = tmp_path / "bomb.spz"
    write_spz(file, scene(10, 0), version=4)
    content = bytearray(file.read_bytes())
    bomb = zstandard.ZstdCompressor().compress(bytes(30 << 20))
    size = struct.unpack_from("<Q", content, 32)[0]
    first = 32 + 5 * 16
    content[32:40] = struct.pack("<Q", len(bomb))
    file.write_bytes(bytes(content[:first]) + bomb + bytes(content[first + size :]))
    assert len(bomb) < 40_000
    assert peak_while_refusing(file, "spz") < MAX_MEMORY


def test_a_frame_that_asks_for_a_huge_window_is_refused(tmp_path):
    file = tmp_path / "window.spz"
    write_spz(file, scene(10, 0), version=4)
    content = bytearray(file.read_bytes())
    first = 32 + 5 * 16
    # No single segment, no declared size, and a window of 2^41 bytes.
    frame = b"\x28\xb5\x2f\xfd\x00\xf8" + b"\x01\x00\x00"
    size = struct.unpack_from("<Q", content, 32)[0]
    content[32:40] = struct.pack("<Q", len(frame))
    file.write_bytes(bytes(content[:first]) + frame + bytes(content[first + size :]))
    assert peak_while_refusing(file, "spz") < MAX_MEMORY


def test_reader_memory_is_proportional_to_the_splats(tmp_path):
    """SPZ unpacks to 64 bytes a splat, and becomes 236."""
    file = tmp_path / "a.spz"
    write_spz(file, scene(20_000, 3))
    tracemalloc.start()
    try:
        open_splats(file)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 20_000 * 1000
