import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.contract.spec.geometry import covariance_upper, rotation_matrix
from gsgen.formats import (
    NotSupported,
    PackedRows,
    PointCloud,
    Splats,
    ValueInvalid,
    codec_named,
    open_splats,
    write_ply,
)
from gsgen.formats.codecs import CODECS
from gsgen.formats.conversion import convert
from gsgen.formats.loss import differences
from gsgen.formats.packed import splats_of_rows
from gsgen.formats.shared.quantities import rotations
from support.splat_files import GOLDENS, assert_near, opacity, scene, turn_between

WRITABLE_FORMATS = [codec.name for codec in CODECS if codec.write]


def by_name(actual: tuple) -> dict[str, float]:
    return {entry.name: entry.largest for entry in actual}


def test_reported_differences_match_the_introduced_ones():
    before = scene(300, 2)
    degrees = np.radians(0.5) / 2
    spin = np.array([math.cos(degrees), math.sin(degrees), 0, 0])
    w, x, y, z = before.rotation.T
    turned = np.stack(
        [
            w * spin[0] - x * spin[1],
            x * spin[0] + w * spin[1],
            y * spin[0] + z * spin[1],
            z * spin[0] - y * spin[1],
        ],
        axis=1,
    )
    harmonics = before.sh.copy()
    harmonics[7, 0] += 0.1 / 0.28209479
    harmonics[9, 3] -= 0.25
    position = before.position.copy()
    position[0, 0] += 0.5
    after = replace(
        before,
        position=position,
        rotation=(-3 * turned).astype(np.float32),
        log_scale=(before.log_scale + np.float32(math.log(1.1))).astype(np.float32),
        sh=harmonics,
    )
    actual = differences(before, after)
    off = by_name(actual)
    assert off["position"] == pytest.approx(0.5, abs=1e-6)
    assert off["rotation"] == pytest.approx(0.5, abs=1e-4)
    assert off["scale"] == pytest.approx(10, abs=1e-3)
    assert off["opacity"] == 0
    assert off["color"] == pytest.approx(0.1, abs=1e-6)
    assert off["harmonics"] == pytest.approx(0.25, abs=1e-6)
    typical = {entry.name: entry.typical for entry in actual}
    assert typical["position"] == pytest.approx(0.5 / math.sqrt(900), rel=1e-4)
    assert typical["rotation"] == pytest.approx(0.5, abs=1e-4)


def test_infinities_differ_by_nothing():
    original = scene(2, 0)
    odd = replace(
        original,
        log_scale=np.float32([[-np.inf, 0, 0]] * 2),
        logit_opacity=np.float32([np.inf, -np.inf]),
    )
    assert set(by_name(differences(odd, odd)).values()) == {0.0}


def test_other_numbers_of_splats_are_no_difference():
    with pytest.raises(ValueInvalid, match="the written file has 2 splats"):
        differences(scene(3, 0), scene(2, 0))


@pytest.mark.parametrize("degree", [None, 0, 1])
@pytest.mark.parametrize("name", WRITABLE_FORMATS)
def test_every_format_is_written_and_compared(tmp_path, name, degree):
    splats = scene(400, 2, antialiased=True, color_space="linear")
    file, target = tmp_path / "a.spz", tmp_path / "b"
    write_ply(file, splats)
    done = convert(file, target, codec_named(name), sh_degree=degree)
    retained = min(2 if degree is None else degree, codec_named(name).most_degree)
    assert (done.count, done.degree, done.format) == (400, (2, retained), name)
    assert done.sizes == (file.stat().st_size, target.stat().st_size)
    assert ("harmonics above degree" in " ".join(done.lost)) is (retained < 2)
    restored = open_splats(target)
    assert isinstance(restored, Splats)
    assert restored.degree == retained
    off = by_name(done.differences)
    exact = {"ply": 0, "glb": 1e-5}
    assert max(off.values()) <= exact.get(name, 10)
    assert off["position"] <= 0.02  # far more, were the rows compared in another order
    assert off["rotation"] <= 1


def test_lost_flags_are_reported(tmp_path):
    write_glb, write_spz = codec_named("glb").write, codec_named("spz").write
    assert write_glb is not None
    assert write_spz is not None
    write_glb(tmp_path / "linear.glb", scene(2, 0, color_space="linear"))
    write_spz(tmp_path / "mip.spz", scene(2, 0, antialiased=True))
    linear, mip = (
        "the flag that the colours are linear",
        "the flag that the splats are antialiased (Mip-Splatting)",
    )
    for source, target, lost_flags in (
        ("linear.glb", "spz", (linear,)),
        ("linear.glb", "glb", ()),
        ("mip.spz", "spz", ()),
        ("mip.spz", "glb", (mip,)),
        ("mip.spz", "ply", ()),
        ("mip.spz", "sog", ("the order of the splats",)),
        ("mip.spz", "compressed-ply", ("the order of the splats",)),
    ):
        done = convert(tmp_path / source, tmp_path / "out", codec_named(target))
        assert done.lost == lost_flags


@pytest.mark.parametrize("name", ["ksplat", "npz"])
def test_formats_that_are_only_read_are_refused(tmp_path, name):
    with pytest.raises(NotSupported, match=r"gsgen reads .*, but cannot write this format"):
        convert(GOLDENS / "scene.ply", tmp_path / "a", codec_named(name))
    assert not list(tmp_path.iterdir())


def test_points_become_ply_and_nothing_else(tmp_path):
    cloud = PointCloud(np.zeros((3, 3), np.float32), np.zeros((3, 3), np.float32))
    write_ply(tmp_path / "a.ply", cloud)
    done = convert(tmp_path / "a.ply", tmp_path / "b.ply", codec_named("ply"))
    assert (done.count, done.degree, done.differences) == (3, None, ())
    with pytest.raises(NotSupported, match="holds coloured points"):
        convert(tmp_path / "a.ply", tmp_path / "c.spz", codec_named("spz"))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), degree=st.integers(0, 3))
def test_packed_rows_become_the_splats_that_they_were(seed, degree):
    splats = scene(6, degree, seed)
    rows = np.column_stack(
        [
            splats.position,
            opacity(splats),
            covariance_upper(np.exp(splats.log_scale), splats.rotation),
        ]
    )
    packed = PackedRows(rows.astype(np.float32), splats.sh.reshape(6, -1))
    if degree == 0:  # three channels are raw colour
        color = 0.5 + 0.28209479177387814 * splats.sh[:, 0]
        packed = PackedRows(packed.gaussians, color.astype(np.float32))
    back = splats_of_rows(packed)
    again = covariance_upper(np.exp(back.log_scale.astype(float)), back.rotation)
    scale = np.abs(rows[:, 4:]).max(axis=1, keepdims=True)
    assert (np.abs(again - rows[:, 4:]) <= 2e-6 * scale).all()
    assert_near(
        replace(back, rotation=splats.rotation, log_scale=splats.log_scale), splats, sh=1e-6
    )


def test_flat_rows_and_ends_of_opacity():
    rows = np.zeros((2, 10), np.float32)
    rows[:, 3] = 1, 0
    rows[0, [4, 7]] = 4
    back = splats_of_rows(PackedRows(rows, np.zeros((2, 4), np.float32)))
    np.testing.assert_array_equal(back.logit_opacity, [np.inf, -np.inf])
    assert sorted(back.log_scale[0]) == [-np.inf, np.float32(np.log(2)), np.float32(np.log(2))]


@pytest.mark.parametrize(
    ("change", "channels", "text"),
    [
        (np.nan, 3, "gaussians: row 1 of the packed Gaussians is not finite"),
        (0, 5, "appearance: the appearance has 5 channels"),
    ],
)
def test_invalid_rows_are_refused(change, channels, text):
    rows = np.zeros((2, 10), np.float32)
    rows[1, 6] = change
    with pytest.raises(ValueInvalid, match=text):
        splats_of_rows(PackedRows(rows, np.zeros((2, channels), np.float32)))


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), axis=st.integers(0, 3))
def test_rotations_come_back_from_their_matrices(seed, axis):
    quaternion = np.random.default_rng(seed).standard_normal((5, 4))
    quaternion[0] = np.eye(4)[axis]  # half turns, where a trace alone would not do
    quaternion[1, axis] = 1e-9
    back = rotations(rotation_matrix(quaternion))
    assert turn_between(back, quaternion) <= 1e-6
