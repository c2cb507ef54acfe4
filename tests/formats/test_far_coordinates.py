"""Coordinates of maps keep a millimetre from file to file, in edits and in measured losses."""

import warnings
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsgen.contract.errors import ConfigInvalid
from gsgen.formats import FormatWarning, Splats, codec_named, convert, open_splats, write_ply
from gsgen.formats.editing.edits import parse_edit
from gsgen.formats.shared.origins import in_file_coordinates, parse_origin, relative_to
from support.far_scenes import FAR_FILES, far_splats

UTM = (448_262.53, 5_411_932.27, 512.75)
MILLIMETRE = 1e-3


def read(path: Path, **options: object) -> Splats:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FormatWarning)
        content = open_splats(path, **options)
    assert isinstance(content, Splats)
    return content


def position_error(splats: Splats, expected: Splats) -> float:
    difference = in_file_coordinates(splats) - in_file_coordinates(expected)
    return float(np.abs(difference).max())


far_origins = st.tuples(*[st.floats(1e5, 1e7), st.floats(-1e7, -1e5), st.floats(-5e3, 5e3)])


@pytest.mark.parametrize("kind", FAR_FILES)
@given(origin=far_origins, seed=st.integers(0, 1000))
def test_far_file_when_read_keeps_a_tenth_of_a_millimetre(kind, origin, seed):
    expected = far_splats(origin, count=20, seed=seed)
    with TemporaryDirectory() as folder:
        splats = read(FAR_FILES[kind](Path(folder), expected))
    assert position_error(splats, expected) < MILLIMETRE / 10
    assert any(splats.origin)


@pytest.mark.parametrize("kind", FAR_FILES)
@pytest.mark.parametrize("format", ["ply", "glb"])
def test_far_file_when_converted_keeps_its_coordinates(tmp_path, kind, format):
    expected = far_splats(UTM)
    target = tmp_path / f"target.{format}"
    with pytest.warns(FormatWarning, match="relative to"):
        result = convert(FAR_FILES[kind](tmp_path, expected), target, codec_named(format))
    assert position_error(read(target), expected) < MILLIMETRE / 10
    assert result.lost == ()
    position = {entry.name: entry for entry in result.differences}["position"]
    assert position.largest < MILLIMETRE / 10


@pytest.mark.parametrize("format", ["spz", "sog", "splat", "compressed-ply"])
def test_format_without_an_origin_when_written_tells_it(tmp_path, format):
    source = FAR_FILES["PLY of doubles"](tmp_path, far_splats(UTM))
    with pytest.warns(FormatWarning, match="relative to"):
        result = convert(source, tmp_path / "target", codec_named(format))
    assert any("the origin (448000, 5412000, 1000)" in entry for entry in result.lost)
    assert np.abs(read(tmp_path / "target").position).max() < 1000


def test_loss_when_float32_cannot_hold_the_scene_includes_reading(tmp_path):
    splats = far_splats(UTM, count=2)
    wide = np.array([[0.123456, 0, 0], [3_000_000.654321, 0, 0]]) + UTM
    path = tmp_path / "wide.ply"
    write_ply(path, replace(splats, position=np.zeros((2, 3), np.float32)))
    content = path.read_bytes()
    row_size = 3 * 8 + 11 * 4
    body = bytearray(content)
    start = len(content) - 2 * row_size
    for row, point in enumerate(wide):
        body[start + row * row_size : start + row * row_size + 24] = point.astype("<f8").tobytes()
    path.write_bytes(bytes(body))
    with pytest.warns(FormatWarning, match="relative to"):
        result = convert(path, tmp_path / "target.ply", codec_named("ply"))
    error = float(np.abs(in_file_coordinates(read(tmp_path / "target.ply")) - wide).max())
    position = {entry.name: entry for entry in result.differences}["position"]
    assert error > MILLIMETRE
    assert position.largest == pytest.approx(error, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "value", "count"),
    [
        ("box", "448262.53,5411932.27,512.75,448270,5411940,520", None),
        ("sphere", "448262.53,5411932.27,512.75,1.5", None),
        ("where", "x>448262.53", None),
    ],
)
def test_filters_when_positions_have_an_origin_take_coordinates_of_the_file(name, value, count):
    splats = far_splats(UTM)
    near = replace(splats, origin=(0.0, 0.0, 0.0))
    near_value = {"box": "0,0,0,7.47,7.73,7.25", "sphere": "0,0,0,1.5", "where": "x>0"}[name]
    edited = parse_edit(name, value)(relative_to(splats, (448_000.0, 5_412_000.0, 0.0)))
    expected = parse_edit(name, near_value)(near)
    assert 0 < len(edited) == len(expected) < len(splats)


@pytest.mark.parametrize(
    ("name", "value"), [("translate", "-448262.53,-5411932.27,-512.75"), ("rotate", "20,-30,70")]
)
def test_moves_when_positions_have_an_origin_act_on_coordinates_of_the_file(name, value):
    splats = far_splats(UTM)
    moved = parse_edit(name, value)(splats)
    position = in_file_coordinates(splats)
    if name == "translate":
        expected = position - UTM
        assert moved.origin == (0, 0, 0)
    else:
        x, y, z = np.radians([20, -30, 70])
        turn_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
        turn_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
        turn_z = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
        expected = position @ (turn_z @ turn_y @ turn_x).T
    np.testing.assert_allclose(in_file_coordinates(moved), expected, rtol=0, atol=MILLIMETRE / 10)


def test_scaling_when_positions_have_an_origin_scales_both():
    splats = far_splats(UTM)
    scaled = parse_edit("scale", "0.5")(splats)
    expected = in_file_coordinates(splats) / 2
    np.testing.assert_allclose(in_file_coordinates(scaled), expected, rtol=0, atol=MILLIMETRE / 10)


def test_given_origin_is_the_point_that_positions_are_relative_to(tmp_path):
    expected = far_splats(UTM)
    path = FAR_FILES["PLY of doubles"](tmp_path, expected)
    splats = read(path, origin=(448_260.5, 5_411_930.0, 500.0))
    assert splats.origin == (448_260.5, 5_411_930.0, 500.0)
    assert position_error(splats, expected) < MILLIMETRE / 10


@pytest.mark.parametrize("text", ["here", "1,2", "1,2,nan", ""])
def test_invalid_origin_is_explained(text):
    with pytest.raises(ConfigInvalid, match="expected auto or X,Y,Z"):
        parse_origin(text)
