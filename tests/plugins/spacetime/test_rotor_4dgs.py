import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gsgen.contract.errors import GsgenError
from gsgen.formats import NotSupported, open_splats
from gsgen.reference_plugins.loading.errors import CheckpointInvalid, NotInCheckpoint
from gsgen.reference_plugins.spacetime import rotor_4dgs_plugin as plugin
from gsgen.reference_plugins.spacetime.rotor_4dgs import Rotor4DGS
from gsgen.reference_plugins.spacetime.rotor_checkpoint import read_rotor, read_time_duration
from gsgen.reference_plugins.synthetic import write_rotor
from support.checkpoints.plugin_checks import assert_like, camera, eager
from support.checkpoints.spacetime_oracles import rotor

MOMENTS = (0.0, 0.123, 0.5, 1.0)
UNIT = (0.0, 1.0)


def moment(time: float) -> np.ndarray:
    return np.array([time], np.float32)


@pytest.mark.parametrize("rot_4d", [True, False])
@pytest.mark.parametrize("duration", [UNIT, (-2.0, 10.0)])
@pytest.mark.parametrize("seed", range(2))
def test_slices_are_those_of_the_4d_gaussians(
    seed: int, duration: tuple[float, float], rot_4d: bool, tmp_path: Path
) -> None:
    write_rotor(tmp_path, count=37, rot_4d=rot_4d, duration=duration, seed=seed)
    generator = Rotor4DGS(read_rotor(tmp_path).splats, duration)
    for time in MOMENTS:
        expected = rotor(tmp_path, float(np.float32(time)), duration)
        assert expected.retained.any()
        assert not expected.retained.all()
        assert_like(*eager(generator, moment(time)), expected)


@pytest.mark.parametrize(("coefficients", "degree"), [(16, 3), (16, 1), (48, 3), (48, 2), (33, 3)])
def test_harmonics_of_time_change_colours_once_all_degrees_are_active(
    coefficients: int, degree: int, tmp_path: Path
) -> None:
    write_rotor(tmp_path, count=11, coefficients=coefficients, degree=degree)
    splats = read_rotor(tmp_path).splats
    assert splats.changing_sh.shape[1] == (2 if (coefficients, degree) == (48, 3) else 0)
    view = camera(np.random.default_rng(1))
    rows = eager(Rotor4DGS(splats, UNIT), moment(0.4))
    assert_like(*rows, rotor(tmp_path, float(np.float32(0.4)), UNIT))
    rgb = Rotor4DGS(splats, UNIT, color="rgb")
    expected = rotor(tmp_path, float(np.float32(0.4)), UNIT, view)
    assert_like(*eager(rgb, moment(0.4), view), expected)
    assert rgb.color_range is not None
    assert expected.color.max() <= rgb.color_range[1]


def test_the_bound_of_colours_holds_in_the_worst_direction(tmp_path: Path) -> None:
    write_rotor(tmp_path, count=1, coefficients=16, degree=1)
    splats = read_rotor(tmp_path).splats
    splats.sh[:] = 0
    splats.sh[0, 2] = 3.0  # Y₂ = √(3/4π) z
    generator = Rotor4DGS(splats, UNIT, color="rgb")
    assert generator.color_range == (0.0, 2.0)  # 0.5 + 3 · 0.4886, to a tenth


def test_a_prefilter_lets_gaussians_last_longer(tmp_path: Path) -> None:
    write_rotor(tmp_path, count=37)
    splats = read_rotor(tmp_path).splats
    for prefilter in (-1.0, 0.05):
        generator = Rotor4DGS(splats, UNIT, prefilter=prefilter)
        expected = rotor(tmp_path, 0.25, UNIT, prefilter=prefilter)
        assert_like(*eager(generator, moment(0.25)), expected)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a: 1\ntime_duration: [0.0, 10]  # s\n", (0, 10)),
        ("time_duration:\n- -1.5\n- 1e1\nb: [3, 4]\n", (-1.5, 10)),
        ("time_duration:\n  - .5\n  - 2.\n", (0.5, 2)),
    ],
)
def test_the_duration_is_read_from_the_configuration(
    text: str, expected: tuple[float, float], tmp_path: Path
) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    assert read_time_duration(path) == expected
    assert read_time_duration(path, 2) == (expected[0] / 2, expected[1] / 2)


@pytest.mark.parametrize("text", ["", "time_duration: 3", "x:\n  time_duration: [0, 1]\n"])
def test_a_configuration_without_duration_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    with pytest.raises(CheckpointInvalid, match="no time_duration"):
        read_time_duration(path)


def test_the_duration_is_asked_for_once(tmp_path: Path) -> None:
    run = write_rotor(tmp_path, count=3, duration=(0, 4))
    config = run / "config.yaml"
    with pytest.raises(NotInCheckpoint, match="no file of the run has the times") as caught:
        plugin.build(run)
    assert "--config FILE" in caught.value.hint
    with pytest.raises(GsgenError, match="cannot be combined with --config"):
        plugin.build(run, config, (0, 1))
    with pytest.raises(GsgenError, match="the time goes from 1 to 1"):
        plugin.build(run, time_duration=(1, 1))
    first, two = plugin.build(run, config), plugin.build(run, time_duration=(0, 4))
    assert torch.equal(first.velocity, two.velocity)
    assert torch.equal(first.half_angular_rate, two.half_angular_rate)


def change(run: Path, index: int, value: Any) -> None:
    (path,) = run.glob("chkpnt*.pth")
    values, number = torch.load(path, weights_only=True)
    torch.save(((*values[:index], value, *values[index + 1 :]), number), path)


@pytest.mark.parametrize(
    ("index", "value", "message"),
    [
        (1, torch.zeros(3, 2), "position is [3, 2], expected [3, 3]"),
        (14, torch.full((3, 1), float("nan")), "log_temporal_scale holds NaN"),
        (3, torch.zeros(3, 20, 3), "21 SH coefficients"),
        (0, 4, "and the active degree 4"),
        (16, 1.0, "value 16 of capture() is a float, expected bool"),
        (18, 3, "time degree 3 does not fit 48"),
        (15, torch.empty(0), "right_rotation is [0], expected [3, 4]"),
    ],
)
def test_invalid_checkpoint_is_named(index: int, value: Any, message: str, tmp_path: Path) -> None:
    change(write_rotor(tmp_path, count=3), index, value)
    with pytest.raises(CheckpointInvalid, match=re.escape(message)):
        read_rotor(tmp_path)


def test_checkpoint_without_rot_4d_has_no_second_quaternion(tmp_path: Path) -> None:
    run = write_rotor(tmp_path, count=3, rot_4d=False)
    (path,) = run.glob("chkpnt*.pth")
    values, _ = torch.load(path, weights_only=True)
    assert values[15].shape == (0,)
    read = read_rotor(run)
    assert read.splats.right_rotation is None
    assert "rotations of space alone" in read.describe()
    change(run, 15, torch.zeros(3, 4))  # not used
    assert torch.equal(read_rotor(run).splats.rotation, read.splats.rotation)


def test_other_checkpoints_are_distinguished(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = write_rotor(tmp_path / "run", count=3)
    (path,) = run.glob("chkpnt*.pth")
    with pytest.raises(NotSupported, match="rotor 4DGS") as caught:
        open_splats(path)
    assert "gsgen export rotor-4dgs" in str(caught.value)
    change(run, 17, torch.zeros(3, 8, 8))
    plugin.build(path, time_duration=UNIT)
    assert "env_map" in capsys.readouterr().err
    values, number = torch.load(path, weights_only=True)
    torch.save((values[:12], number), path)
    with pytest.raises(CheckpointInvalid, match="without time") as refused:
        read_rotor(run)
    assert f"gsgen export static {path}" in refused.value.hint
    torch.save((values[:17], number), path)
    with pytest.raises(CheckpointInvalid, match="holds a tuple of 2, expected \\(19 values"):
        read_rotor(run)
    with pytest.raises(NotInCheckpoint, match=r"no chkpnt7\.pth"):
        read_rotor(run, 7)
    path.rename(run / "chkpnt_best.pth")
    torch.save((values, number), run / "chkpnt_best.pth")
    assert read_rotor(run).run.iteration == number
    with pytest.raises(CheckpointInvalid, match=r"holds no chkpntN\.pth") as caught_folder:
        read_rotor(tmp_path)
    assert str(run) in caught_folder.value.hint
