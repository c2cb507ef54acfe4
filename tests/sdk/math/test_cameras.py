import numpy as np
import pytest
import torch

from gsgen.contract.probing.probes import as_tensor
from gsgen.contract.spec.geometry import look_at, perspective
from gsgen.sdk import math

ORDERS = pytest.mark.parametrize("order", ["column", "row"])
RNG = np.random.default_rng(11)
EYES = RNG.normal(0, 3, (20, 3))


def camera(eye: np.ndarray, order: str, scale: float = 1.0) -> torch.Tensor:
    view = look_at(eye, np.zeros(3), np.array([0.0, -1.0, 0.0]))
    view[:3] *= scale
    return torch.from_numpy(as_tensor(view, order))


@ORDERS
@pytest.mark.parametrize("scale", [1.0, 0.25])
def test_the_camera_stands_where_it_was_put(order: str, scale: float) -> None:
    for eye in EYES:
        actual = math.camera_centre(camera(eye, order, scale), order).numpy()
        np.testing.assert_allclose(actual, eye, atol=5e-6)


@ORDERS
def test_a_camera_of_zeros_stands_at_the_origin(order: str) -> None:
    assert math.camera_centre(torch.zeros(4, 4), order).tolist() == [0, 0, 0]


def seen_on_image(points: np.ndarray, view: np.ndarray, lens: np.ndarray) -> np.ndarray:
    """Say which points project into the image, in float64."""
    clip = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ (lens @ view).T
    x, y, z, w = clip.T
    return (w > 0) & (np.abs(x) <= w) & (np.abs(y) <= w) & (z >= 0) & (z <= w)


@ORDERS
@pytest.mark.parametrize("flip", [1, -1])
def test_nothing_that_is_seen_is_culled_and_most_of_the_rest_is(order: str, flip: int) -> None:
    lens = perspective(1.0, 1.6, 0.1, 20.0)
    lens[1] *= flip
    points = RNG.normal(0, 6, (4000, 3)).astype(np.float32)
    radius = (0.3 * RNG.random(len(points))).astype(np.float32)
    culled, unseen = 0, 0
    for eye in EYES[:6]:
        view = look_at(eye, np.zeros(3), np.array([0.0, -1.0, 0.0]))
        retained = math.frustum_mask(
            torch.from_numpy(points),
            torch.from_numpy(as_tensor(view, order)),
            torch.from_numpy(as_tensor(lens, order)),
            torch.from_numpy(radius),
            order=order,
        ).numpy()
        assert set(retained) <= {0, 1}
        # Any point of a sphere that is seen is enough.
        surface = RNG.normal(size=(8, *points.shape))
        surface *= radius[:, None] / np.linalg.norm(surface, axis=2, keepdims=True)
        visible_mask = seen_on_image(points, view, lens)
        for offset in surface:
            visible_mask |= seen_on_image(points + offset, view, lens)
        assert not (visible_mask & (retained == 0)).any()
        culled, unseen = culled + int((retained == 0).sum()), unseen + int((~visible_mask).sum())
    assert culled > 0.9 * unseen


def test_spheres_on_the_border_are_kept_by_their_radius_and_the_margin() -> None:
    view, lens = np.eye(4), perspective(np.pi / 2, 1.0, 0.1, 10.0)
    points = torch.tensor([[1.05, 0, 1.0], [0, 1.05, 1.0], [0, 0, 0.0], [0, 0, 10.5]])

    def kept(radius: float, margin: float) -> list[float]:
        tensors = (torch.from_numpy(as_tensor(array, "row")) for array in (view, lens))
        mask = math.frustum_mask(points, *tensors, radius, margin=margin, order="row")
        return mask.tolist()

    assert kept(0.0, 0.0) == [0, 0, 0, 0]
    assert kept(0.0, 0.1) == [1, 1, 0, 0]
    assert kept(0.04, 0.0) == [1, 1, 0, 0]
    assert kept(0.11, 0.0) == [1, 1, 1, 0]
    assert kept(0.6, 0.0) == [1, 1, 1, 1]


def test_matrices_of_zeros_keep_all_and_nan_goes() -> None:
    points = torch.tensor([[0.0, 0, 0], [np.nan, 0, 0]])
    assert math.frustum_mask(points, torch.zeros(4, 4), torch.zeros(4, 4)).tolist() == [1, 0]
