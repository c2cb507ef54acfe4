"""Edits of splats beside independent evaluations of what they mean."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation

from gsgen.contract.spec.geometry import covariance_upper, symmetric
from gsgen.formats import Splats, ValueInvalid
from gsgen.formats.editing.edits import EDIT_OPTIONS, parse_edit
from gsgen.formats.editing.filters import morton_ordered, without_floaters
from gsgen.formats.editing.statistics import histogram, statistics_text, summarise, write_histograms
from gsgen.formats.shared.harmonics import sh_basis
from support.splat_files import assert_near, opacity, scene


def covariance(splats: Splats) -> np.ndarray:
    return symmetric(covariance_upper(np.exp(splats.log_scale.astype(float)), splats.rotation))


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    degree=st.integers(0, 4),
    angles=st.tuples(*[st.floats(-360, 360)] * 3),
)
def test_a_turned_scene_looks_the_same_from_the_turned_direction(seed, degree, angles):
    splats = scene(5, degree, seed)
    turned = parse_edit("rotate", ",".join(map(repr, angles)))(splats)
    matrix = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()  # fixed axes
    np.testing.assert_allclose(turned.position, splats.position @ matrix.T, atol=2e-5)
    expected = matrix @ covariance(splats) @ matrix.T
    np.testing.assert_allclose(covariance(turned), expected, atol=1e-5 * np.abs(expected).max())
    directions = np.random.default_rng(seed).standard_normal((7, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    before = np.einsum("dk,nkc->dnc", sh_basis(directions, degree), splats.sh)
    after = np.einsum("dk,nkc->dnc", sh_basis(directions @ matrix.T, degree), turned.sh)
    np.testing.assert_allclose(after, before, atol=2e-5)


def test_scenes_are_moved_and_scaled():
    splats = scene(20, 1)
    moved = parse_edit("translate", "1,-2,0.5")(splats)
    np.testing.assert_allclose(moved.position, splats.position + np.float32([1, -2, 0.5]))
    scaled_scene = parse_edit("scale", "3")(splats)
    np.testing.assert_allclose(scaled_scene.position, 3 * splats.position, rtol=1e-6)
    np.testing.assert_allclose(covariance(scaled_scene), 9 * covariance(splats), rtol=1e-5)
    for edited in (moved, scaled_scene):
        np.testing.assert_array_equal(edited.sh, splats.sh)
        np.testing.assert_array_equal(edited.logit_opacity, splats.logit_opacity)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_filters_keep_matching_splats(seed):
    splats = scene(60, 0, seed)
    low, high = np.sort(np.random.default_rng(seed).uniform(-5, 5, (2, 3)), axis=0)
    x, y, z = splats.position.astype(float).T
    conditions = {
        ("sphere", "0.5,0,-1,4"): [
            (a - 0.5) ** 2 + b**2 + (c + 1) ** 2 <= 16 for a, b, c in zip(x, y, z, strict=True)
        ],
        ("where", "opacity>=0.4"): opacity(splats) >= 0.4,
        ("where", " largest_scale < 0.02"): np.exp(splats.log_scale).max(axis=1) < 0.02,
        ("where", "red>0.5"): splats.sh[:, 0, 0] > 0,
        ("where", "z!=0"): z != 0,
        ("box", ",".join(map(repr, map(float, [*low, *high])))): [
            all(low <= point) and all(point <= high) for point in splats.position.astype(float)
        ],
    }
    for (name, text), expected in conditions.items():
        rows = np.flatnonzero(expected)
        if len(rows):
            assert_near(parse_edit(name, text)(splats), splats[rows])
        else:
            with pytest.raises(ValueInvalid, match="leaves none of 60 splats"):
                parse_edit(name, text)(splats)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), size=st.floats(0.3, 5), min_neighbours=st.integers(0, 6))
def test_floaters_have_too_few_neighbours(seed, size, min_neighbours):
    splats = scene(40, 0, seed)
    cells = np.floor((splats.position.astype(float) - splats.position.min(axis=0)) / size)
    near = [sum(np.abs(a - b).max() <= 1 for b in cells) - 1 >= min_neighbours for a in cells]
    left = without_floaters(splats, size, min_neighbours).position
    np.testing.assert_array_equal(left, splats.position[np.flatnonzero(near)])


def test_cells_that_cannot_be_numbered_are_refused():
    with pytest.raises(ValueInvalid, match="cells of more than a millionth of the scene"):
        without_floaters(scene(10, 0), 1e-9, 1)


def test_morton_order_keeps_neighbours_together():
    corners = np.array(list(itertools.product((0, 1), repeat=3)), np.float32)
    splats = replace(scene(8, 0), position=corners[::-1].copy())
    np.testing.assert_array_equal(morton_ordered(splats).position, corners)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("translate", "1,2"),
        ("rotate", "a,b,c"),
        ("scale", ""),
        ("box", "1,2,3,4,5"),
        ("sphere", "1,2,3,nan"),
        ("drop_floaters", "1"),
        ("decimate", "0"),
        ("decimate", "120%"),
        ("decimate", "half"),
    ],
)
def test_values_of_another_type_are_refused_at_once(name, text):
    with pytest.raises(ValueInvalid):
        parse_edit(name, text)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("scale", "0"),
        ("scale", "-1"),
        ("box", "1,0,0,0,1,1"),
        ("where", "size>1"),
        ("where", "x=1"),
    ],
)
def test_invalid_edit_values_are_refused(name, text):
    with pytest.raises(ValueInvalid):
        parse_edit(name, text)(scene(3, 0))


def test_every_edit_keeps_the_flags():
    values = {
        "translate": "0,0,1",
        "rotate": "10,20,30",
        "scale": "2",
        "box": "-99,-99,-99,99,99,99",
        "sphere": "0,0,0,99",
        "where": "opacity>0",
        "drop_floaters": "99,1",
        "decimate": "50%",
        "morton": "",
    }
    assert set(values) == set(EDIT_OPTIONS)
    splats = scene(64, 1, antialiased=True, color_space="linear")
    for name, text in values.items():
        edited = parse_edit(name, text)(splats)
        assert (edited.antialiased, edited.color_space) == (True, "linear"), name


def test_statistics_are_those_of_numpy(tmp_path):
    splats = scene(200, 0)
    summary = {entry.name: entry for entry in summarise(splats)}
    assert summary["y"].median == np.median(splats.position[:, 1].astype(float))
    assert summary["x"].low == splats.position[:, 0].min()
    assert summary["opacity"].mean == pytest.approx(opacity(splats).mean(), rel=1e-6)
    assert summary["scale_1"].deviation == pytest.approx(
        np.exp(splats.log_scale[:, 1]).std(), rel=1e-4
    )
    assert len(statistics_text(tuple(summary.values())).splitlines()) == 1 + len(summary)
    values = splats.position[:, 0].astype(float)
    counts, low, high = histogram("x", values)
    np.testing.assert_array_equal(counts, np.histogram(values, 80)[0])
    assert (low, high) == (values.min(), values.max())
    write_histograms(tmp_path / "a.png", splats)
    picture = np.asarray(Image.open(tmp_path / "a.png"))
    # The highest bar of x, of 90 pixels, stands above its base.
    bar = 18 + 3 * int(counts.argmax())
    assert (picture[20:108, bar] == (0x34, 0x65, 0xA4)).all()
    assert (picture[108, 18 : 18 + 3 * 80] == 0).all()  # the axis
    assert (picture[20:, :17] == 255).all()  # the margin
    assert (picture[20:108, 20 : 18 + 3 * 80 : 3] == 255).all()  # a column between two bars


def test_infinite_values_do_not_count():
    splats = replace(scene(4, 0), log_scale=np.full((4, 3), -np.inf, np.float32))
    summary = {entry.name: entry for entry in summarise(splats)}
    assert summary["scale_0"].high == 0
