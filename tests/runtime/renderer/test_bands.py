"""Images in bands of rows: whole again, with the counters of all bands, halved where too full."""

import numpy as np
import pytest

from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.renderer.bands import Band, CountsAndImages, PairsExceeded, draw_bands
from gsgen.runtime.scene.camera import Camera

CAMERA = Camera.look_at([0, 0, -3], [0, 0, 0], fov_y=40.0, width=3, height=100)


def drawn(band: Band) -> CountsAndImages:
    """An image whose words are their rows; each row is a splat and two pairs."""
    counts = np.zeros(len(Counts) + 40, np.uint32)
    counts[Counts.GAUSSIANS] = 1000
    counts[Counts.VISIBLE], counts[Counts.PAIRS] = band.rows, 2 * band.rows
    rows = np.arange(band.first, band.first + band.rows, dtype=np.uint32)
    return counts, {"color": np.broadcast_to(rows[:, None, None], (band.rows, 3, 4)).copy()}


@pytest.mark.parametrize("most_rows", [32, 64, 100])
@pytest.mark.parametrize("fitting", [32, 64, 1000])
def test_bands_give_the_whole_image(most_rows: int, fitting: int) -> None:
    bands: list[tuple[int, int]] = []

    def draw(band: Band) -> CountsAndImages:
        if band.rows > fitting:
            raise PairsExceeded("too many pairs")
        bands.append((band.first, band.rows))
        assert band.camera.height == band.rows
        assert band.camera.cy == CAMERA.cy - band.first
        return drawn(band)

    counts, images = draw_bands(CAMERA, most_rows, draw, lambda: None)
    assert images["color"].shape == (100, 3, 4)
    assert (images["color"] == np.arange(100)[:, None, None]).all()
    totals = [counts[index] for index in (Counts.GAUSSIANS, Counts.VISIBLE, Counts.PAIRS)]
    assert totals == [1000, 100, 200]
    assert max(rows for _, rows in bands) <= min(most_rows, fitting)


def test_a_row_of_tiles_that_is_too_full_is_an_error() -> None:
    def draw(band: Band) -> CountsAndImages:
        raise PairsExceeded(f"{band.rows} rows hold too many pairs")

    with pytest.raises(PairsExceeded, match="32 rows"):
        draw_bands(CAMERA, 100, draw, lambda: None)
