"""Pictures fitted to a model's input: the crop, the triangle filter, the background."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from gsgen.runtime.media.fitted_pictures import PictureFit, fit_picture

sizes = st.tuples(st.integers(1, 40), st.integers(1, 40))


def picture_of(height: int, width: int, seed: int = 0) -> np.ndarray:
    """Random opaque pixels."""
    pixels = np.random.default_rng(seed).integers(0, 256, (height, width, 4), np.uint8)
    pixels[..., 3] = 255
    return pixels


@given(sizes, sizes)
def test_the_part_is_centred_fills_one_axis_and_has_the_shape_of_the_input(picture, expected):
    fit = PictureFit.of_sizes(picture, expected)
    height, width = fit.scale * expected[0], fit.scale * expected[1]
    margins = picture[0] - height, picture[1] - width
    assert min(margins) == pytest.approx(0, abs=1e-9)
    assert max(margins) >= -1e-9
    assert (2 * fit.top, 2 * fit.left) == pytest.approx(margins, abs=1e-9)


@given(sizes, sizes)
def test_a_constant_picture_stays_constant(picture, expected):
    pixels = np.full((*picture, 4), (51, 102, 204, 255), np.uint8)
    fitted = fit_picture(pixels, expected)
    assert fitted.shape == (3, *expected)
    assert fitted.dtype == np.float32
    assert np.abs(fitted - np.array([0.2, 0.4, 0.8])[:, None, None]).max() < 1e-6


def test_a_picture_of_the_right_size_is_fed_as_it_is():
    pixels = picture_of(9, 7)
    expected = (pixels[..., :3].transpose(2, 0, 1) / 255).astype(np.float32)
    np.testing.assert_array_equal(fit_picture(pixels, (9, 7)), expected)


@pytest.mark.parametrize(("picture", "size"), [((60, 90), (8, 12)), ((17, 31), (8, 8)), ((8, 8), (20, 30))])  # fmt: skip
def test_the_filter_is_the_triangle_that_pillow_uses(picture, size):
    pixels = picture_of(*picture)
    fit = PictureFit.of_sizes(picture, size)
    box = (fit.left, fit.top, fit.left + fit.scale * size[1], fit.top + fit.scale * size[0])
    channels = [
        np.asarray(
            Image.fromarray(pixels[..., channel].astype(np.float32)).resize(
                (size[1], size[0]), Image.Resampling.BILINEAR, box
            )
        )
        for channel in range(3)
    ]
    # Pillow leaves out pixels beyond the box, which count at its edge here.
    inner = (slice(None), slice(1, -1), slice(1, -1))
    assert np.abs(fit_picture(pixels, size) - np.stack(channels) / 255)[inner].max() < 2e-5


def test_transparent_pixels_show_the_background():
    pixels = picture_of(4, 4)
    pixels[:2, :, 3], pixels[2:, :, 3] = 0, 128
    fitted = fit_picture(pixels, (4, 4), (1.0, 0.5, 0.0))
    np.testing.assert_allclose(
        fitted[:, :2], np.broadcast_to(np.array([1, 0.5, 0])[:, None, None], (3, 2, 4))
    )
    colors = pixels[2:, :, :3].transpose(2, 0, 1) / 255
    expected = 128 / 255 * colors + 127 / 255 * np.array([1, 0.5, 0])[:, None, None]
    np.testing.assert_allclose(fitted[:, 2:], expected, atol=1e-6)


@given(sizes, sizes)
def test_intrinsics_follow_the_crop_and_the_scale(picture, expected):
    fit = PictureFit.of_sizes(picture, expected)
    matrix = fit.intrinsics(fx=50.0, fy=60.0, cx=picture[1] / 2, cy=picture[0] / 2)
    assert matrix[:2, 2] == pytest.approx([expected[1] / 2, expected[0] / 2])
    ray = np.array([0.1, -0.2, 1.0])
    column, row = 50 * ray[0] + picture[1] / 2, 60 * ray[1] + picture[0] / 2
    seen = (matrix @ ray)[:2]
    assert seen == pytest.approx(
        [(column - fit.left) / fit.scale, (row - fit.top) / fit.scale], abs=1e-9
    )
