"""GIFs: what can be seen through, and what colours are left."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from gsgen.runtime.media.pictures import save_gif


def read_frames(path: Path) -> list[np.ndarray]:
    with Image.open(path) as film:
        return [np.array(entry.convert("RGBA")) for entry in ImageSequence.Iterator(film)]


def pictures(count: int, colors: int = 200) -> list[np.ndarray]:
    """Noise of so many colours, half of it covered by less than all."""
    rng = np.random.default_rng(0)
    palette = rng.integers(0, 256, (colors, 3), dtype=np.uint8)
    decoded = []
    for _ in range(count):
        alpha = rng.choice(np.array([0, 1, 127, 128, 254, 255], np.uint8), (24, 32, 1))
        chosen = palette[rng.integers(0, colors, (24, 32))]
        decoded.append(np.concatenate([chosen, alpha], axis=-1))
    return decoded


@pytest.mark.parametrize("count", [1, 4])
def test_alpha_of_half_is_opaque_and_less_is_transparent(tmp_path: Path, count: int) -> None:
    expected = pictures(count)
    save_gif(tmp_path / "a.gif", expected, 10)
    decoded_frames = read_frames(tmp_path / "a.gif")
    assert len(decoded_frames) == count
    for decoded, picture in zip(decoded_frames, expected, strict=True):
        opaque = picture[..., 3] >= 128
        np.testing.assert_array_equal(decoded[..., 3], np.where(opaque, 255, 0))
        np.testing.assert_array_equal(decoded[opaque][:, :3], picture[opaque][:, :3])


def test_a_frame_does_not_show_through_the_next(tmp_path: Path) -> None:
    left, right = np.zeros((2, 8, 8, 4), np.uint8)
    left[:, :4], right[:, 4:] = (255, 0, 0, 255), (0, 0, 255, 255)
    save_gif(tmp_path / "a.gif", [left, right, left], 10)
    for decoded, picture in zip(read_frames(tmp_path / "a.gif"), (left, right, left), strict=True):
        np.testing.assert_array_equal(decoded[..., 3], picture[..., 3])


def test_colours_beyond_the_palette_are_approximated(tmp_path: Path) -> None:
    ramp = np.mgrid[0:64, 0:64].transpose(1, 2, 0).astype(np.uint8) * 4
    picture = np.concatenate([ramp, np.full((64, 64, 1), 99), np.full((64, 64, 1), 255)], -1)
    picture = picture.astype(np.uint8)
    picture[:8, :8, 3] = 0
    save_gif(tmp_path / "a.gif", [picture], 10)
    (decoded,) = read_frames(tmp_path / "a.gif")
    opaque = picture[..., 3] > 0
    np.testing.assert_array_equal(decoded[..., 3] > 0, opaque)
    off = decoded[opaque][:, :3].astype(int) - picture[opaque][:, :3]
    assert np.abs(off).max() <= 16


@pytest.mark.parametrize("shape", [(9, 7), (9, 7, 3), (9, 7, 4)])
def test_opaque_pictures_stay_opaque(tmp_path: Path, shape: tuple[int, ...]) -> None:
    picture = np.full(shape, 255, np.uint8)
    picture[2:5, 2:5] = 40
    if len(shape) == 3:
        picture[..., 3:] = 255
    save_gif(tmp_path / "a.gif", [picture], 10)
    (decoded,) = read_frames(tmp_path / "a.gif")
    assert (decoded[..., 3] == 255).all()
    np.testing.assert_array_equal(
        decoded[..., 0], picture if picture.ndim == 2 else picture[..., 0]
    )
