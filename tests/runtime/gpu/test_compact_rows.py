"""Rows of 32 bytes: what they keep of a covariance, and what is drawn of them."""

import numpy as np
import pytest

from gsgen.contract.spec.geometry import covariance_upper, symmetric
from gsgen.runtime.gpu.compact_rows import PACKED_BYTES, pack_rows
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.splat_residency import Residency
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from references.projection import unpack_rows
from support.rendering.splat_scenes import camera, cloud, turned

ALL = ("color", "depth", "normal")
MIN_STEP = 1 / 65_534  # half a step of 16 bits in [-1, 1]


def rows_of(scale: np.ndarray, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(len(scale), 10)).astype(np.float32)
    rows[:, 4:] = covariance_upper(scale, rng.normal(size=(len(scale), 4)))
    return rows


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e8])
def test_a_covariance_keeps_its_shape(unit: float) -> None:
    """Σ = L Lᵀ is off by no more than the steps of L, and stays a covariance."""
    rng = np.random.default_rng(1)
    rows = rows_of(unit * np.exp(rng.uniform(-7, 0, (500, 3))))
    packed = pack_rows(rows)
    assert packed.nbytes == PACKED_BYTES * len(rows)
    actual = unpack_rows(packed)
    np.testing.assert_array_equal(actual[:, :4], rows[:, :4])
    before, after = symmetric(rows[:, 4:].astype(np.float64)), symmetric(actual[:, 4:])
    largest = np.abs(before).max(axis=(1, 2))
    assert (np.abs(after - before).max(axis=(1, 2)) <= 6.1 * MIN_STEP * largest).all()
    assert (np.linalg.eigvalsh(after)[:, 0] >= -1e-6 * largest).all()
    thickness, expected_thickness = (
        np.sqrt(np.maximum(np.linalg.eigvalsh(c)[:, 0], 0)) for c in (before, after)
    )
    # A rounded covariance would be off by up to the root of a step, 4e-3.
    assert (np.abs(thickness - expected_thickness) <= 1e-3 * np.sqrt(largest)).all()


def test_flat_and_empty_covariances_are_kept() -> None:
    rows = np.zeros((4, 10), np.float32)
    rows[1, 4:] = 0, 0, 0, 4, 2, 1  # a line in y and z
    rows[2, 4:] = 0, 0, 0, 0, 0, 9
    rows[3, 4:] = 1, 1, 1, 1, 1, 1 - 1e-7
    np.testing.assert_allclose(unpack_rows(pack_rows(rows)), rows, atol=2e-3)


@pytest.mark.parametrize(
    "wrong",
    [(np.nan, 0, 0, 1, 0, 1), (1, 0, 0, np.inf, 0, 1), (1, 2, 0, 1, 0, 1), (-1, 0, 0, 1, 0, 1)],
)
def test_invalid_covariance_is_not_drawn(device: Device, wrong: tuple[float, ...]) -> None:
    data = cloud(2)
    data.rows[0, 4:] = wrong
    assert np.isnan(unpack_rows(pack_rows(data.rows))[0, 4:]).any()
    assert (
        Renderer(device, rasteriser="tiles", compact=True).render(Scene([data]), camera()).visible
        == 1
    )


def test_packed_rows_are_read_as_they_were_packed(device: Device, renderer: Renderer) -> None:
    """The picture of packed rows is that of what they unpack to, in several pages."""
    small = Renderer(device, rasteriser="tiles", compact=True, page_rows=64)
    transform = turned(0.6, (0.3, 1, 0), (1.2, 0.8, 1.0))
    for degree in (None, 0, 1, 3):
        data = cloud(150, 5, degree=degree)
        half = data.appearance.astype(np.float16)
        splat_data = SplatData(unpack_rows(pack_rows(data.rows)), half, data.space)
        first, two = (
            entry.render(Scene([SplatSet(stored, transform)]), camera(), outputs=ALL)
            for entry, stored in ((small, data), (renderer, splat_data))
        )
        assert first.visible == two.visible > 50
        for name in ("rgba", "depth", "normal"):
            here, reference = getattr(first, name), getattr(two, name)
            is_close = np.isclose(here, reference, atol=2e-5, rtol=1e-5)
            assert is_close.mean() > 0.995  # the rest is at thresholds
        assert (first.ids == two.ids).mean() > 0.995


def test_a_packed_row_has_forty_bytes_and_harmonics_two_each(device: Device) -> None:
    for degree, size in ((None, 40), (0, 40), (1, 64), (2, 96), (3, 128)):
        residency = Residency(device, compact=True)
        pages = residency.pages(cloud(1000, degree=degree))
        assert sum(page.rows.size + page.appearance.size for page in pages) == 1000 * size


def test_rows_that_change_are_no_longer_packed(device: Device, renderer: Renderer) -> None:
    """Packing takes longer than a frame. Harmonics stay in float16."""
    data, other = cloud(150, 6, degree=1), cloud(150, 7, degree=1)
    own_renderer, scene = Renderer(device, rasteriser="tiles", compact=True), Scene([data])
    assert own_renderer.render(scene, camera()).visible
    assert all(page.packed for _, page in own_renderer.placed(scene))
    data.update(rows=other.rows)
    splat_data = SplatData(other.rows, data.appearance.astype(np.float16), "sh")
    shown, expected = (
        own_renderer.render(scene, camera()),
        renderer.render(Scene([splat_data]), camera()),
    )
    np.testing.assert_array_equal(shown.rgba, expected.rgba)
    assert not any(page.packed for _, page in own_renderer.placed(scene))
    assert all(page.is_half for _, page in own_renderer.placed(scene))
