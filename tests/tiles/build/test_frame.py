"""Where scenes are put, beside values from elsewhere."""

import json

import numpy as np
import pytest

from gsgen.contract.errors import ConfigInvalid
from gsgen.tiles.build.frame import globe_transform, read_transform, upright_transform


def matrix(columns):
    return np.array(columns).reshape(4, 4).T


def test_down_in_the_scene_is_down_in_the_world():
    upright = matrix(upright_transform())
    np.testing.assert_array_equal(upright @ [0, 1, 0, 0], [0, 0, -1, 0])
    np.testing.assert_array_equal(upright @ [0, 0, 1, 0], [0, 1, 0, 0])
    assert np.linalg.det(upright) == 1


@pytest.mark.parametrize(
    ("geodetic", "expected"),
    [
        ((0, 0, 0), (6378137.0, 0, 0)),
        ((90, 0, 100), (0, 6378237.0, 0)),
        ((0, 90, 0), (0, 0, 6356752.314245)),
        # Greenwich observatory, by the formulas of EPSG guidance note 7-2, section 4.1.1.
        ((0.0, 51.4778, 45.0), (3980631.40, 0.0, 4966859.19)),
    ],
)
def test_the_origin_is_on_the_globe(geodetic, expected):
    longitude, latitude, height = geodetic
    origin = matrix(globe_transform(longitude, latitude, height))[:3, 3]
    np.testing.assert_allclose(origin, expected, atol=25)


@pytest.mark.parametrize("geodetic", [(12, 48, 500), (-179.9, -33, 0), (180, 89.9, -50)])
def test_axes_point_east_north_and_up(geodetic):
    transform = matrix(globe_transform(*geodetic))
    up = -transform[:3, 1]  # −y of the scene
    step = 1e-4
    east = matrix(globe_transform(geodetic[0] - step, *geodetic[1:]))[:3, 3] - transform[:3, 3]
    above = matrix(globe_transform(*geodetic[:2], geodetic[2] + 1))[:3, 3] - transform[:3, 3]
    np.testing.assert_allclose(above, up, atol=1e-6)
    np.testing.assert_allclose(-east / np.linalg.norm(east), transform[:3, 0], atol=1e-5)
    np.testing.assert_allclose(np.linalg.det(transform), 1, rtol=1e-12)


@pytest.mark.parametrize("geodetic", [(181, 0, 0), (0, 91, 0), (0, 0, 2e7), (float("nan"), 0, 0)])
def test_invalid_longitude_or_latitude_is_refused(geodetic):
    with pytest.raises(ConfigInvalid):
        globe_transform(*geodetic)


def test_a_transform_is_read_by_rows_or_by_columns(tmp_path):
    rows = 2.0 * matrix(upright_transform())
    rows[3, 3] = 1
    rows[:3, 3] = 4, 5, 6
    (tmp_path / "rows.json").write_text(json.dumps(rows.tolist()))
    (tmp_path / "columns.json").write_text(json.dumps(rows.T.ravel().tolist()))
    for name in ("rows.json", "columns.json"):
        np.testing.assert_array_equal(matrix(read_transform(tmp_path / name)), rows)


@pytest.mark.parametrize(
    "text",
    ["", "[1,2", "{}", "[1,2,3]", '["a"]', json.dumps(np.diag([1, 1, 2, 1]).tolist()),
     json.dumps(np.diag([1, 1, -1, 1]).tolist()), json.dumps(np.zeros((4, 4)).tolist()),
     json.dumps((np.eye(4) + np.eye(4)[::-1] * 0.1).tolist()), "[[1,2],[3]]"],
)  # fmt: skip
def test_transform_that_is_not_a_similarity_is_refused(tmp_path, text):
    (tmp_path / "transform.json").write_text(text)
    with pytest.raises(ConfigInvalid) as caught:
        read_transform(tmp_path / "transform.json")
    assert caught.value.where.endswith("transform.json")


def test_a_missing_transform_is_refused(tmp_path):
    with pytest.raises(ConfigInvalid, match="No such file"):
        read_transform(tmp_path / "none.json")
