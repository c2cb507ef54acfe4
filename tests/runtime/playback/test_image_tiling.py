"""Tiles cover the image, their weights sum to 1, and what all tiles agree on stays as it is."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.playback.image_tiling import lay_tiles, post_process, run_tiled, tile_weights

SIZES = [((40, 60), (16, 24), 4), ((16, 16), (16, 16), 7), ((17, 100), (16, 16), 0),
         ((33, 31), (9, 13), 4), ((100, 7), (5, 7), 1), ((12, 12), (1, 1), 0)]  # fmt: skip


@pytest.mark.parametrize(("image", "tile", "overlap"), SIZES)
def test_weights_sum_to_one_at_every_pixel(
    image: tuple[int, int], tile: tuple[int, int], overlap: int
) -> None:
    total, covered = np.zeros(image), np.zeros(image, int)
    for tile_weight, weight in tile_weights(image, tile, overlap):
        assert (tile_weight.top >= 0) & (tile_weight.left >= 0)
        assert weight.shape == tile
        assert (weight > 0).all()
        part = np.s_[
            tile_weight.top : tile_weight.top + tile[0],
            tile_weight.left : tile_weight.left + tile[1],
        ]
        assert total[part].shape == tile, "a tile reaches beyond the image"
        total[part] += weight
        covered[part] += 1
    assert covered.min() >= 1
    np.testing.assert_allclose(total, 1, atol=1e-12)


@pytest.mark.parametrize(("image", "tile", "overlap"), SIZES)
def test_neighbours_share_at_least_the_overlap(
    image: tuple[int, int], tile: tuple[int, int], overlap: int
) -> None:
    tiles = list(lay_tiles(image, tile, overlap))
    for axis, name in enumerate(("top", "left")):
        starts = sorted({getattr(tile, name) for tile in tiles})
        assert starts[0] == 0
        assert starts[-1] == image[axis] - tile[axis]
        assert all(b - a <= tile[axis] - overlap for a, b in pairwise(starts))


@pytest.mark.parametrize("seed", range(10))
def test_a_network_that_changes_nothing_gives_the_identical_image(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tile = (int(rng.integers(1, 20)), int(rng.integers(1, 20)))
    overlap = int(rng.integers(0, (min(tile) - 1) // 2 + 1))
    shape = (1, 3, int(rng.integers(1, 50)), int(rng.integers(1, 50)))
    image = rng.normal(size=shape).astype(rng.choice(["float32", "float16"]))
    sizes = set()

    def same(part: np.ndarray) -> np.ndarray:
        sizes.add(part.shape)
        return part

    result = run_tiled(image, same, tile, overlap)
    assert result.dtype == image.dtype
    assert sizes == {(1, 3, *tile)}
    np.testing.assert_array_equal(result, image)


def test_constant_output_stays_constant_for_any_image() -> None:
    image = np.random.default_rng(0).random((1, 3, 37, 53)).astype(np.float32)
    result = run_tiled(image, lambda part: np.full_like(part[:, :1], 0.3), (16, 16), 5)
    assert result.shape == (1, 1, 37, 53)
    np.testing.assert_array_equal(result, np.float32(0.3))


@pytest.mark.parametrize("seed", range(8))
def test_a_network_that_repeats_pixels_gives_the_image_with_repeated_pixels(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tile, scale = (int(rng.integers(1, 20)), int(rng.integers(1, 20))), int(rng.integers(2, 5))
    overlap = int(rng.integers(0, (min(tile) - 1) // 2 + 1))
    image = rng.normal(size=(1, 3, *rng.integers(1, 50, 2))).astype(np.float32)
    result = run_tiled(image, lambda part: np.kron(part, np.ones((scale, scale))), tile, overlap)
    np.testing.assert_allclose(result, np.kron(image, np.ones((scale, scale))), rtol=1e-12)


def test_a_step_between_tiles_becomes_a_ramp() -> None:
    values = iter((0.0, 1.0))
    result = run_tiled(
        np.zeros((1, 1, 8, 24), np.float32),
        lambda part: np.full_like(part, next(values)),
        (8, 16),
        3,
    )
    row = result[0, 0, 4]
    assert (np.diff(row) >= 0).all()
    assert np.diff(row).max() < 0.3, "a seam shows"
    assert row[0] == 0
    assert row[-1] == 1


def test_nan_in_one_tile_is_not_hidden() -> None:
    result = run_tiled(np.full((1, 1, 4, 4), np.nan, np.float32), lambda part: part, (4, 4), 0)
    assert np.isnan(result).all()


@pytest.mark.parametrize("overlap", [-1, 8, 100])
def test_overlaps_that_do_not_fit_are_refused(overlap: int) -> None:
    with pytest.raises(ConfigInvalid, match=rf"overlap: is {overlap}, expected 0 to 7 .*16 × 16"):
        run_tiled(np.zeros((1, 3, 20, 20)), lambda part: part, (16, 16), overlap)


def test_a_network_of_another_size_is_refused() -> None:
    image = np.zeros((1, 3, 20, 20))
    with pytest.raises(ConfigInvalid, match=r"returned \[1, 3, 8, 16\]"):
        run_tiled(image, lambda part: part[:, :, ::2], (16, 16), 2)
    with pytest.raises(ConfigInvalid, match=r"returned \[1, 3, 32, 16\]"):
        run_tiled(image, lambda part: part.repeat(2, axis=2), (16, 16), 2)
    with pytest.raises(ConfigInvalid, match=r"returned \[3\]"):
        run_tiled(image, lambda part: part[0, :, 0, 0], (16, 16), 2)


class Session:
    """Enough of an inference session: it doubles the image, in the dtype that it takes."""

    def __init__(self, shape: list, kind: str = "tensor(float)") -> None:
        self.shape, self.kind, self.calls = shape, kind, 0

    def get_inputs(self) -> list:
        return [SimpleNamespace(name="image", shape=self.shape, type=self.kind)]

    def run(self, _: None, feeds: dict) -> list:
        self.calls += 1
        assert feeds["image"].dtype == ("float16" if "16" in self.kind else "float32")
        return [2 * feeds["image"]]


def test_models_of_fixed_size_run_in_tiles_and_others_at_once() -> None:
    image = np.random.default_rng(0).random((1, 3, 40, 40)).astype(np.float32)
    fixed_session, half = Session([1, 3, 16, 16]), Session([1, 3, 16, 16], "tensor(float16)")
    opened = Session([1, 3, "h", "w"])
    np.testing.assert_array_equal(post_process(fixed_session, image), 2 * image)
    np.testing.assert_array_equal(post_process(opened, image), 2 * image)
    result = post_process(half, image)
    assert result.dtype == np.float16
    np.testing.assert_allclose(result, 2 * image, rtol=1e-3)
    assert fixed_session.calls > 4
    assert opened.calls == 1
    with pytest.raises(ConfigInvalid, match="has 4 channels"):
        post_process(fixed_session, np.zeros((1, 4, 40, 40), np.float32))
    with pytest.raises(ConfigInvalid, match="no input 'frame'"):
        post_process(fixed_session, image, name="frame")
