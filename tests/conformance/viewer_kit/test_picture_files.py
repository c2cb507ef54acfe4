"""Pictures of a viewer that cannot be read: each has one message, with the value and a hint."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.viewer_kit.picture_files import (
    PictureMissing,
    PictureUnreadable,
    encode_png,
    read_picture,
)

GREY = np.full((4, 6, 3), 0.5, np.float32)
PNG = encode_png(np.random.default_rng(7).uniform(size=(12, 12, 3)))


def _message(folder: Path, name: str = "a-0") -> str:
    with pytest.raises(PictureUnreadable) as raised:
        read_picture(folder, name)
    text = str(raised.value)
    assert "Error(" not in text
    assert "[Errno" not in text
    return text


def test_two_pictures_of_one_frame_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a-0.npy", GREY)
    (tmp_path / "a-0.png").write_bytes(PNG)
    text = _message(tmp_path)
    assert text == (
        "a-0: there are two pictures, a-0.npy and a-0.png, expected one: "
        "delete the one that is out of date"
    )


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (np.full((4, 6, 3), np.nan, np.float32), "72 of 72 values are not finite"),
        (np.full((4, 6, 3), -np.inf, np.float32), "72 of 72 values are not finite"),
        (255 * GREY, "values up to 127.5, expected 0 to 1"),
        (GREY.astype(np.uint8), "the array is uint8[4, 6, 3], expected floats"),
    ],
)
def test_values_in_another_unit_are_named(array: np.ndarray, words: str, tmp_path: Path) -> None:
    np.save(tmp_path / "a-0.npy", array)
    assert words in _message(tmp_path)


def test_an_unclipped_picture_is_read_clipped(tmp_path: Path) -> None:
    np.save(tmp_path / "a-0.npy", 4 * GREY)
    assert read_picture(tmp_path, "a-0").max() == 1


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a-0.npy", b"", "the picture cannot be read: the file starts with b'', expected b"),
        ("a-0.npy", b"text", "the file starts with b'text', expected b"),
        ("a-0.npy", b"\x93NUMPY\x01\x00", "its 8 bytes are not a whole array of numbers"),
        ("a-0.png", b"", "is not a PNG, but starts with b''"),
        ("a-0.png", PNG[:20], "the PNG is cut or damaged: it has no whole IHDR chunk"),
        ("a-0.png", PNG[:33], "it holds 0 bytes of pixels, expected 444"),
        ("a-0.png", PNG[:200], "the PNG is cut or damaged: it holds"),
        ("a-0.png", PNG[:41] + b"????" + PNG[45:], "its pixels cannot be decompressed"),
    ],
)
def test_a_cut_file_is_described(name: str, content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    assert words in _message(tmp_path)


def test_an_archive_of_arrays_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", picture=GREY)
    shutil.move(tmp_path / "a.npz", tmp_path / "a-0.npy")
    assert "the file starts with b'PK" in _message(tmp_path)


def test_the_message_of_another_png_names_alpha(tmp_path: Path) -> None:
    (tmp_path / "a-0.png").write_bytes(PNG[:24] + b"\x10" + PNG[25:])  # 16 bits
    assert "expected 8 bits of grey or RGB, with or without alpha" in _message(tmp_path)


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("sh-float16-1.jpg", "found sh-float16-1.jpg, whose name or format is another"),
        ("sh-float16-01.png", "found sh-float16-01.png, whose name or format is another"),
        ("SH_float16_1.npy", "found SH_float16_1.npy, whose name or format is another"),
        ("sh-float16-2.png", "found sh-float16-2.png, and frames are counted from 0"),
        ("sh-float16-0.png", ""),
        ("notes.txt", ""),
    ],
)
def test_a_near_name_is_the_hint_of_a_missing_picture(
    file: str, words: str, tmp_path: Path
) -> None:
    (tmp_path / file).touch()
    with pytest.raises(PictureMissing) as raised:
        read_picture(tmp_path, "sh-float16-1")
    text = str(raised.value)
    hint = f"; {words}" if words else ""
    assert re.search("expected sh-float16-1.npy or sh-float16-1.png(.*)$", text)[1] == hint  # type: ignore[index]
