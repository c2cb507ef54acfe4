import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
from typer.testing import CliRunner

from gsgen.cli.command_group import build
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.formats import NotSupported, open_splats
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.spacetime import ex4dgs_plugin as plugin
from gsgen.reference_plugins.spacetime.ex4dgs import Ex4DGS
from gsgen.reference_plugins.spacetime.ex4dgs_checkpoint import read_ex4dgs
from gsgen.reference_plugins.synthetic import write_ex4dgs
from gsgen.sdk import export
from support.checkpoints.plugin_checks import (
    ALLOWED,
    ALLOWED_FLOAT16,
    assert_golden,
    assert_like,
    eager,
)
from support.checkpoints.spacetime_oracles import ex4dgs, rotation_matrix, upper
from support.models.captured import assert_captured

GOLDENS = Path(__file__).parent / "goldens"


@dataclass(frozen=True, slots=True)
class Case:
    """A checkpoint, and the frames for which the method's own code was run."""

    options: dict[str, Any] = field(default_factory=dict)
    frames: tuple[float, ...] = (0, 7, 23.5, 49)

    def write(self, folder: Path) -> Path:
        return write_ex4dgs(folder, count=25, **self.options)

    def times(self) -> list[np.ndarray]:
        last = self.options.get("frames", 50) - 1
        return [np.array([frame / last], np.float32) for frame in self.frames]


CASES = {
    "ex4dgs_cube": Case(),
    "ex4dgs_pchip": Case({"interpolation": "pchip", "seed": 1}),
    "ex4dgs_linear": Case(
        {"interpolation": "linear", "degree": 1, "frames": 12, "interval": 5, "seed": 2},
        (0, 4.25, 11),
    ),
    "ex4dgs_captured": Case({"captured_duration": 63, "seed": 3}),
}
each_case = pytest.mark.parametrize("name", CASES)


def golden(name: str, index: int) -> dict[str, np.ndarray]:
    """Return what the method's own code computed for a frame."""
    saved = np.load(GOLDENS / f"{name}.npz")
    covariance = []
    for q, scale in zip(saved[f"rotation_{index}"], saved["scale"], strict=True):
        # As the rasteriser does it: the quaternion is not normalised.
        q64, axes = q.astype(np.float64), np.diag(scale.astype(np.float64))
        root = (np.eye(3) + q64 @ q64 * (rotation_matrix(q64) - np.eye(3))) @ axes
        covariance.append(upper(root @ root.T))
    position, opacity = saved[f"position_{index}"], saved[f"opacity_{index}"]
    parts = {"position": position, "opacity": opacity, "covariance": np.array(covariance)}
    return parts | {"color": saved["sh"]}


@each_case
def test_the_method_s_own_code_gives_the_same_gaussians(name: str, tmp_path: Path) -> None:
    case = CASES[name]
    generator = plugin.build(case.write(tmp_path))
    for index, time in enumerate(case.times()):
        assert_golden(*eager(generator, time), golden(name, index), ALLOWED)


@each_case
@pytest.mark.parametrize("seed", range(2))
def test_plain_formulas_in_float64_give_the_same_gaussians(
    name: str, seed: int, tmp_path: Path
) -> None:
    options = CASES[name].options | {"seed": seed}
    generator = plugin.build(write_ex4dgs(tmp_path, count=41, **options))
    for time in (0.0, 0.123, 0.5, 0.87, 1.0):
        moment = np.array([time], np.float32)
        expected = ex4dgs(tmp_path, float(moment[0]), options.get("captured_duration"))
        assert_like(*eager(generator, moment), expected)


def test_opacity_is_highest_between_two_moments_in_either_order(tmp_path: Path) -> None:
    read = read_ex4dgs(write_ex4dgs(tmp_path, count=40))
    visible = read.moving.visible
    assert (visible[:, 0] > visible[:, 1]).any()
    key = (0.5 * read.times.last_frame + read.times.shift) / read.times.interval
    is_highest = (visible.amin(dim=1) < key) & (key < visible.amax(dim=1))
    assert is_highest.any()
    assert not is_highest.all()
    rows, _ = eager(plugin.build(tmp_path), np.array([0.5], np.float32))
    highest = torch.sigmoid(read.moving.logit_opacity[:, 0])
    opacity = torch.from_numpy(rows[len(read.drifting) :, 3])
    assert torch.equal((opacity - highest).abs() < 1e-6, is_highest)


def test_halfway_between_opposite_quaternions_the_first_is_taken(tmp_path: Path) -> None:
    read = read_ex4dgs(write_ex4dgs(tmp_path, count=8))
    keys = read.moving.rotation
    keys[:, 1:] = keys[:, :1]
    still = Ex4DGS(read)
    keys[:, 1::2] = -keys[:, :1]
    # Halfway between the second key frame and the third.
    time = (2.5 * read.times.interval - read.times.shift) / read.times.last_frame
    moment = np.array([time], np.float32)
    assert 0 < time < 1
    rows, expected = eager(Ex4DGS(read), moment)[0], eager(still, moment)[0]
    assert np.allclose(rows[:, 4:], expected[:, 4:], rtol=0, atol=1e-6 * np.abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize("dtype", ["float32", "float16"])
@pytest.mark.parametrize("name", ["ex4dgs_cube", "ex4dgs_pchip", "ex4dgs_linear"])
def test_an_exported_model_agrees_with_the_method_and_runs_captured(
    name: str, dtype: str, tmp_path: Path
) -> None:
    case, path = CASES[name], tmp_path / "model.onnx"
    generator = plugin.build(case.write(tmp_path / "run"))
    # In half precision once is enough: arithmetic is the same.
    is_live = dtype == "float32" or name == "ex4dgs_cube"
    settings = Settings(level=Level.LIVE if is_live else Level.STATIC)
    exported = export(generator, path, dtype=dtype, target="webgpu", settings=settings)
    if is_live:
        assert_captured(exported.report)
    session = onnxruntime.InferenceSession(path)
    for index, time in enumerate(case.times()):
        rows, color, *_ = session.run(None, {"time": time})
        allowed = ALLOWED if dtype == "float32" else ALLOWED_FLOAT16
        assert_golden(rows, color, golden(name, index), allowed)


@pytest.mark.slow
@pytest.mark.parametrize("interpolation", ["cube", "pchip"])
def test_half_precision_keeps_when_gaussians_appear_in_a_long_video(
    interpolation: str, tmp_path: Path
) -> None:
    run = write_ex4dgs(tmp_path / "run", count=3000, frames=300, interpolation=interpolation)
    path = tmp_path / "model.onnx"
    settings = Settings(level=Level.STATIC)
    exported = export(plugin.build(run), path, dtype="float16", target="webgpu", settings=settings)
    assert exported.float16_result is not None
    assert exported.float16_result.bytes_after < 0.6 * exported.float16_result.bytes_before
    session = onnxruntime.InferenceSession(path)
    for time in np.linspace(0, 1, 7, dtype=np.float32):
        rows, color, *_ = session.run(None, {"time": time[None]})
        expected = ex4dgs(run, float(time))
        assert_like(
            *(part.astype(np.float64) for part in (rows, color)), expected, allowed=ALLOWED_FLOAT16
        )


def test_a_command_exports_and_reports_what_was_read(tmp_path: Path) -> None:
    write_ex4dgs(tmp_path / "run", count=25)
    words = ["export", "ex4dgs", "--checkpoint", str(tmp_path / "run")]
    completed = CliRunner().invoke(
        build(), [*words, "-o", str(tmp_path / "m.onnx"), "--level", "static"]
    )
    assert completed.exit_code == 0, completed.output
    assert "13 drifting Gaussians and 12 with 11 key frames (cube)" in completed.stderr


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("interp_type", "cubic_diff", "interp_type is 'cubic_diff', expected 'cube' or 'pchip'"),
        ("rot_interp_type", "lerp", "rot_interp_type is 'lerp', expected 'slerp'"),
        ("duration", -1, "duration is -1, expected at least 1"),
        ("duration", 500, "has 11 key frames, but 500 frames need"),
        ("time_interval", 0, "time_interval is 0, expected at least 1"),
        ("time_interval", 2.5, "time_interval is 2.5, expected a whole number"),
        ("time_pad", -3, "time_pad is -3, expected at least 0"),
        ("var_pad", float("nan"), "var_pad is nan, expected 0 or more"),
    ],
)
def test_options_that_are_not_supported_are_named(
    name: str, value: object, message: str, tmp_path: Path
) -> None:
    write_ex4dgs(tmp_path, count=5)
    path = tmp_path / "cfg_args"
    path.write_text(re.sub(rf"\b{name}=[^,)]+", f"{name}={value!r}", path.read_text()))
    with pytest.raises(CheckpointInvalid, match=re.escape(message)):
        read_ex4dgs(tmp_path)


@pytest.mark.parametrize("content", [3, (1, 2), ((None,) * 12, 5), ((None,) * 40, 5)])
def test_a_file_of_another_capture_is_refused(content: Any, tmp_path: Path) -> None:
    write_ex4dgs(tmp_path, count=5)
    torch.save(content, tmp_path / "chkpnt40000.pth")
    with pytest.raises(CheckpointInvalid, match=r"capture\(\)"):
        read_ex4dgs(tmp_path)


def test_a_missing_file_or_column_is_named(tmp_path: Path) -> None:
    run = write_ex4dgs(tmp_path / "run", count=5)
    (cloud,) = run.rglob("iteration_*/point_cloud.ply")
    moving = cloud.with_name("dynamic_point_cloud.ply")
    whole = moving.read_bytes()
    moving.write_bytes(whole.replace(b"motion_rot_3_2", b"motion_rat_3_2"))
    with pytest.raises(CheckpointInvalid, match="motion_rot_3_2 are missing"):
        read_ex4dgs(run)
    moving.write_bytes(whole.replace(b"motion_f_rest_7\n", b"motion_f_rust_7\n"))
    with pytest.raises(CheckpointInvalid, match="has 44 columns motion_f_rest"):
        read_ex4dgs(run)
    other = write_ex4dgs(tmp_path / "other", count=5, degree=1)
    (flat,) = other.rglob("dynamic_point_cloud.ply")
    moving.write_bytes(flat.read_bytes())
    with pytest.raises(CheckpointInvalid, match=r"has 4 SH coefficients, point_cloud\.ply 16"):
        read_ex4dgs(run)
    moving.write_bytes(whole)
    (run / "cfg_args").rename(tmp_path / "cfg_args")
    with pytest.raises(CheckpointInvalid, match="is missing"):
        read_ex4dgs(run)


@pytest.mark.parametrize("name", ["point_cloud.ply", "dynamic_point_cloud.ply"])
def test_a_part_of_the_run_is_not_taken_for_splats_at_rest(name: str, tmp_path: Path) -> None:
    write_ex4dgs(tmp_path, count=5)
    (path,) = tmp_path.rglob(f"iteration_*/{name}")
    with pytest.raises(NotSupported, match="gsgen export ex4dgs --checkpoint"):
        open_splats(path)
