from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import torch

from gsgen.formats import write_ply
from gsgen.reference_plugins.deformation import hexplane_4dgs_plugin
from gsgen.reference_plugins.deformation.deformable_3dgs import Deformable3DGS
from gsgen.reference_plugins.deformation.deformation_checkpoint import read_deformation
from gsgen.reference_plugins.deformation.hexplane_4dgs import HexPlane4DGS
from gsgen.reference_plugins.deformation.hexplane_checkpoint import read_hexplanes
from gsgen.reference_plugins.synthetic import (
    HexPlaneOptions,
    torus_knot,
    write_deformable,
    write_hexplane,
)
from support.checkpoints.plugin_checks import assert_like, eager
from support.checkpoints.plugin_oracles import deformation, hexplane

MOMENTS = (0.0, 0.123, 0.5, 0.999, 1.0)
FLAGS = ("no_dx", "no_ds", "no_dr", "no_do", "no_dshs", "apply_rotation")


def moment(time: float) -> np.ndarray:
    return np.array([time], np.float32)


def generator_of(folder: Path, options: HexPlaneOptions) -> HexPlane4DGS:
    read = read_hexplanes(write_hexplane(folder, options))
    return HexPlane4DGS(read.canonical, read.nets, read.flags)


@pytest.mark.parametrize("seed", range(16))
def test_hexplane_does_what_the_method_does(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    flags = {name: bool(rng.integers(0, 2)) for name in FLAGS}
    flags["no_dx"] = flags["no_dx"] and not flags["no_ds"]  # something has to move
    mask = str(rng.choice(["", "static_mlp", "empty_voxel"]))
    flags |= {mask: True} if mask else {}
    options = HexPlaneOptions(
        count=int(rng.integers(1, 60)),
        channels=int(rng.integers(1, 9)),
        resolution=tuple(int(x) for x in rng.integers(2, 12, 4)),  # type: ignore[arg-type]
        multires=tuple(range(1, int(rng.integers(2, 6)))),
        width=int(rng.integers(2, 33)),
        depth=int(rng.integers(0, 4)),
        flags=flags,
        seed=seed,
    )
    read = read_hexplanes(write_hexplane(tmp_path, options))
    generator = HexPlane4DGS(read.canonical, read.nets, read.flags)
    for time in MOMENTS:
        # float32 knows the moment only so well
        assert_like(*eager(generator, moment(time)), hexplane(read, float(np.float32(time))))


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_fewer_harmonics_stay_fewer(degree: int, tmp_path: Path) -> None:
    generator = generator_of(tmp_path, HexPlaneOptions(count=5, degree=degree))
    assert eager(generator, moment(0.5))[1].shape == (5, 3 * (degree + 1) ** 2)


def test_voxels_lie_where_the_checkpoint_says(tmp_path: Path) -> None:
    """Early versions saved the corners; later ones take those of the planes."""
    options = HexPlaneOptions(count=30, flags={"empty_voxel": True})
    folder = write_hexplane(tmp_path, options)
    path = folder / "point_cloud/iteration_30000/deformation.pth"
    state = torch.load(path, weights_only=True)
    upper, lower = state["deformation_net.grid.aabb"]
    outputs = {}
    for low, high in ((None, None), (lower, upper), (lower * 0.8, upper * 0.7)):
        if low is not None and high is not None:
            state["deformation_net.empty_voxel.xyz_min"] = low
            state["deformation_net.empty_voxel.xyz_max"] = high
            torch.save(state, path)
        read = read_hexplanes(folder)
        assert read.nets.voxels is not None
        low, high = (lower, upper) if low is None else (low, high)
        assert torch.equal(read.nets.voxels[1], low)
        assert torch.equal(read.nets.voxels[2], high)
        generator = HexPlane4DGS(read.canonical, read.nets, read.flags)
        outputs[float(high[0])] = eager(generator, moment(0.3))[0]
        assert_like(*eager(generator, moment(0.3)), hexplane(read, float(np.float32(0.3))))
    first, second = outputs.values()  # the first two are the same
    assert np.abs(first - second).max() > 0.01


def test_harmonics_that_no_renderer_draws_are_cut(tmp_path: Path) -> None:
    folder = write_hexplane(tmp_path, HexPlaneOptions(count=5))
    sh = np.random.default_rng(0).normal(size=(5, 25, 3)).astype(np.float32)
    knot = replace(torus_knot(5), sh=sh)
    write_ply(folder / "point_cloud/iteration_30000/point_cloud.ply", knot)
    read = read_hexplanes(folder)
    assert "5 Gaussians of SH degree 3 (cut from 4)" in read.describe()
    np.testing.assert_array_equal(read.canonical.sh.numpy(), knot.sh[:, :16])


def test_time_beyond_its_range_stands_still(tmp_path: Path) -> None:
    generator = generator_of(tmp_path, HexPlaneOptions(count=9))
    for outside, edge in ((-3.0, 0.0), (4.0, 1.0)):
        rows, _ = eager(generator, moment(outside))
        if outside > 0:
            np.testing.assert_array_equal(rows, eager(generator, moment(edge))[0])
        assert np.isfinite(rows).all()


@pytest.mark.parametrize(("blender", "six"), [*product([True, False], repeat=2)])
@pytest.mark.parametrize("seed", range(3))
def test_deformable_does_what_the_method_does(
    seed: int, blender: bool, six: bool, tmp_path: Path
) -> None:
    write_deformable(tmp_path, count=41, blender=blender, six_degrees=six, seed=seed)
    read = read_deformation(tmp_path)
    assert (read.net.time is not None, read.net.has_six_degrees) == (blender, six)
    generator = Deformable3DGS(read.canonical, read.net)
    for time in MOMENTS:
        assert_like(*eager(generator, moment(time)), deformation(read, float(np.float32(time))))


@pytest.mark.parametrize("rows", [1, 10, 41, 1000])
def test_parts_of_the_rows_go_through_the_network_one_after_another(
    rows: int, tmp_path: Path
) -> None:
    read = read_deformation(write_deformable(tmp_path, count=41))
    whole = eager(Deformable3DGS(read.canonical, read.net), moment(0.3))
    parts = eager(Deformable3DGS(read.canonical, read.net, rows=rows), moment(0.3))
    for a, b in zip(whole, parts, strict=True):
        np.testing.assert_allclose(a, b, atol=2e-6)


def test_a_screw_without_turn_gives_numbers(tmp_path: Path) -> None:
    write_deformable(tmp_path, count=3, six_degrees=True)
    path = tmp_path / "deform/iteration_40000/deform.pth"
    state = torch.load(path, weights_only=True)
    for name in ("branch_w.weight", "branch_w.bias"):
        state[name].zero_()
    torch.save(state, path)
    read = read_deformation(tmp_path)
    rows, _ = eager(Deformable3DGS(read.canonical, read.net), moment(0.3))
    assert np.isfinite(rows).all()


def test_no_gaussian_of_the_demo_is_thrown_away_from_its_neighbours(tmp_path: Path) -> None:
    """The product of six noisy planes has a heavy tail unless their values are bounded."""
    demo = hexplane_4dgs_plugin.PLUGIN.demo
    assert demo is not None
    demo.write(tmp_path)
    read = read_hexplanes(tmp_path)
    generator = HexPlane4DGS(read.canonical, read.nets, read.flags)
    for time in np.linspace(0, 1, 6):
        with torch.no_grad():
            moved = generator(torch.tensor([time], dtype=torch.float32)).position
        distance = (moved - read.canonical.position).norm(dim=1).numpy()
        assert np.median(distance) > 0.3  # the motion is visible
        assert distance.max() < 2.2 * np.median(distance)
