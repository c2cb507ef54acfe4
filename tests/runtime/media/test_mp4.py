"""MP4 films, read back by another parser of such boxes: libavif, behind Pillow."""

import io
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.media.mp4 import Sound, encode


def _moving(count: int, size: tuple[int, int] = (64, 48)) -> list[Image.Image]:
    """Return a bright bar that goes from left to right."""
    width, height = size
    frames = np.zeros((count, height, width, 3), np.uint8)
    for number, frame in enumerate(frames):
        left = number * (width - 8) // max(count - 1, 1)
        frame[:, left : left + 8] = (250, 200, 40)
    return [Image.fromarray(frame) for frame in frames]


def _as_sequence(film: bytes) -> Image.Image:
    """Say that the film is a sequence of images, which has the same tables."""
    assert film[4:8] == b"ftyp"
    assert film.count(b"vide") == 1
    brands = b"avis" + film[12:16] + b"avismsf1iso8mif1"
    return Image.open(io.BytesIO(film[:8] + brands + film[32:].replace(b"vide", b"pict")))


@pytest.mark.parametrize("count", [2, 3, 48, 49, 50, 97])
def test_every_frame_comes_back_in_its_order(count: int) -> None:
    frames = _moving(count, (37, 22))
    read = _as_sequence(encode(iter(frames), 30))
    assert (read.size, getattr(read, "n_frames", None)) == ((37, 22), count)
    for number in {0, count // 2, count - 1}:
        read.seek(number)
        actual = np.asarray(read.convert("RGB"), np.float64)
        error = np.abs(actual - np.asarray(frames[number])).mean()
        assert error < 6, number  # a bar elsewhere: 25 and more


def test_film_of_one_frame_is_written() -> None:
    film = encode(_moving(1), 25)
    offset = film.index(b"stsz")
    assert int.from_bytes(film[offset + 12 : offset + 16], "big") == 1
    size = int.from_bytes(film[offset + 16 : offset + 20], "big")
    assert film[-size - 8 :].startswith((size + 8).to_bytes(4, "big") + b"mdat")


@pytest.mark.parametrize("fps", [1, 23.976, 25, 60])
def test_frame_rate_is_the_requested_one(fps: float) -> None:
    film = encode(_moving(3, (16, 16)), fps)
    header, times = film.index(b"mdhd") + 4, film.index(b"stts") + 4
    per_second = int.from_bytes(film[header + 12 : header + 16], "big")
    frame_duration = int.from_bytes(film[times + 12 : times + 16], "big")
    assert per_second / frame_duration == pytest.approx(fps, abs=1e-9)


def test_key_frames_allow_seeking() -> None:
    film = encode(_moving(100, (16, 16)), 25)
    offset = film.index(b"stss") + 8
    count = int.from_bytes(film[offset : offset + 4], "big")
    key_frame_numbers = np.frombuffer(film[offset + 4 : offset + 4 + 4 * count], ">u4").tolist()
    assert key_frame_numbers[0] == 1
    assert all(1 < after - before <= 50 for before, after in pairwise(key_frame_numbers))


def test_frames_of_several_sizes_are_refused() -> None:
    with pytest.raises(SceneInvalid, match=r"16×16, 32×16"):
        encode([*_moving(2, (16, 16)), *_moving(1, (32, 16))], 25)
    with pytest.raises(SceneInvalid, match="frames have several sizes"):
        encode([*_moving(48, (16, 16)), *_moving(3, (32, 16))], 25)


def test_sound_is_stored_beside_the_frames() -> None:
    """The samples are where the second track's table says, and the frames where the first one's does."""
    samples = np.random.default_rng(0).uniform(-1.1, 1, 3000).astype(np.float32)
    film = encode(_moving(5, (16, 16)), 10, Sound(samples=samples, rate=6000))
    track = film[film.index(b"soun") :]
    assert int.from_bytes(track[(entry := track.index(b"ipcm")) + 28 :][:2], "big") == 6000, entry
    assert track[track.index(b"pcmC") + 8 :][:2] == bytes([1, 16])
    count, offset = (
        int.from_bytes(track[track.index(kind) + place :][:4], "big")
        for kind, place in ((b"stsz", 12), (b"stco", 12))
    )
    assert count == len(samples)
    stored = np.frombuffer(film[offset : offset + 2 * count], "<i2")
    np.testing.assert_allclose(stored / 2**15, np.clip(samples, -1, 1), atol=1.01 / 2**15)
    assert offset + 2 * count == len(film)
    read = _as_sequence(film.replace(b"soun", b"none"))
    assert getattr(read, "n_frames", None) == 5
