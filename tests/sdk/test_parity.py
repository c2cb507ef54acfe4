from dataclasses import replace

import numpy as np
import pytest

from gsgen.contract import layout
from gsgen.contract.manifest import Tolerances
from gsgen.contract.probes import Probe
from gsgen.sdk.eager import Reference
from gsgen.sdk.parity import Parity, compare, fibonacci_directions, same


@pytest.fixture
def reference() -> Reference:
    rng = np.random.default_rng(9)
    n = 300
    root = rng.normal(size=(n, 3, 3)) * 0.1
    full = root @ root.transpose(0, 2, 1)
    upper = full[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    made = layout.Gaussians(
        position=rng.normal(size=(n, 3)) * 5,
        opacity=rng.uniform(0, 1, n),
        covariance=upper,
        sh=rng.normal(size=(n, 16, 3)) * 0.3,
    )
    return Reference(Probe("here", {}), made, n)


def against(
    reference: Reference, other: layout.Gaussians, dtype: type = np.float32
) -> Parity:
    rows, color = layout.encode(other, dtype)
    return compare([reference], [(rows, color, reference.count)], Tolerances())


@pytest.mark.parametrize("dtype", [np.float32, np.float16])
def test_rounding_to_the_storage_dtype_is_allowed(
    reference: Reference, dtype: type
) -> None:
    assert against(reference, reference.gaussians, dtype).holds


@pytest.mark.parametrize("field", ["position", "opacity", "covariance", "sh"])
def test_an_error_in_one_row_is_found_and_placed(reference: Reference, field: str) -> None:
    value = getattr(reference.gaussians, field).copy()
    value[123] += {"position": 0.01, "opacity": 0.01, "covariance": 0.01, "sh": 0.05}[field]
    parity = against(reference, replace(reference.gaussians, **{field: value}))
    worst = max(parity.fields, key=lambda one: one.excess)
    assert not parity.holds
    assert worst.field == {"sh": "appearance"}.get(field, field)
    assert worst.row == 123
    assert worst.probe == "here"


@pytest.mark.parametrize("field", ["position", "opacity", "covariance", "sh"])
def test_nan_never_agrees(reference: Reference, field: str) -> None:
    value = getattr(reference.gaussians, field).copy()
    value[5] = np.nan
    assert not against(reference, replace(reference.gaussians, **{field: value})).holds


def test_a_wrong_order_of_sh_shows_as_a_wrong_colour(reference: Reference) -> None:
    sh = reference.gaussians.sh
    assert sh is not None
    swapped = sh.reshape(300, 3, 16).transpose(0, 2, 1)
    parity = against(reference, replace(reference.gaussians, sh=swapped))
    appearance = next(one for one in parity.fields if one.field == "appearance")
    assert appearance.error > 0.1


def test_position_is_measured_in_standard_deviations(reference: Reference) -> None:
    gaussians = reference.gaussians
    trace = gaussians.covariance[:, [0, 3, 5]].sum(axis=1)
    moved = gaussians.position + 0.5 * np.sqrt(trace / 3)[:, None]
    parity = against(reference, replace(gaussians, position=moved))
    position = next(one for one in parity.fields if one.field == "position")
    assert position.error == pytest.approx(0.5, rel=1e-3)


def test_another_count_is_a_failure(reference: Reference) -> None:
    rows, color = layout.encode(reference.gaussians)
    assert not compare([reference], [(rows, color, 299)], Tolerances()).holds


def test_directions_are_unit_and_spread() -> None:
    made = fibonacci_directions(64)
    np.testing.assert_allclose(np.linalg.norm(made, axis=1), 1)
    np.testing.assert_allclose(made.mean(axis=0), 0, atol=0.02)
    closest = (made @ made.T - 2 * np.eye(64)).max(axis=1)
    assert np.rad2deg(np.arccos(closest)).min() > 15


def test_two_runs_are_the_same_to_the_bit_or_within_a_tolerance() -> None:
    def reference(position: np.ndarray, count: int = 3) -> Reference:
        made = layout.Gaussians(
            position,
            np.ones(len(position)),
            np.ones((len(position), 6)),
            rgb=np.full((len(position), 3), 0.5),
        )
        return Reference(Probe("p", {}), made, count)

    points = np.arange(9.0).reshape(3, 3)
    points[0, 0] = np.nan
    known = reference(points)
    assert same(known, reference(points.copy()))
    assert not same(known, reference(points * (1 + 1e-6)))
    assert same(known, reference(points * (1 + 1e-6)), 1e-5)
    assert not same(known, reference(points * (1 + 1e-4)), 1e-5)
    assert not same(known, reference(points, count=2))
    assert not same(known, reference(np.concatenate([points, points])), 1e-5)
