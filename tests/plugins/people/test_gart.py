"""GART's avatars: what its own code and plain formulas compute, exports, and files at fault."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch

from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins.bodies.motions import read_motion
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.people import gart_plugin as plugin
from gsgen.reference_plugins.people.gart_checkpoint import read_gart
from gsgen.reference_plugins.synthetic import PersonOptions, write_gart, write_motion
from gsgen.sdk import GaussianGenerator, export
from plugins.people.avatar_oracles import PoseInputs, gart
from support.checkpoints.plugin_checks import (
    ALLOWED,
    ALLOWED_FLOAT16,
    assert_golden,
    assert_like,
    eager,
)
from support.models.captured import assert_captured

GOLDENS = Path(__file__).parent / "goldens"
POSES = 4


@dataclass(frozen=True, slots=True)
class Case:
    """A checkpoint, and the poses for which the method's own code was run."""

    degree: int
    seed: int
    options: dict[str, Any] = field(default_factory=dict)

    def write(self, folder: Path, count: int = 25) -> Path:
        person = PersonOptions(count=count, degree=self.degree, seed=self.seed)
        return write_gart(folder, person, **self.options)

    def frame(self, index: int) -> dict[str, np.ndarray]:
        """Return a pose, where the body is, a camera that looks along +z, and a training frame."""
        rng = np.random.default_rng([self.seed, index])
        camera = np.eye(4)
        camera[3, :3] = rng.normal(0, 0.5, 3) + np.array(
            [0, 0, 3]
        )  # the view's translation, transposed
        values = {
            "pose": rng.normal(0, 0.4, (24, 3)) * (index > 0),
            "root_translation": rng.normal(size=3),
            "camera": camera,
        }
        frame = {"frame_index": np.array([index % max(1, self.options.get("frames", 0))], np.int32)}
        return {name: value.astype(np.float32) for name, value in values.items()} | frame


CASES = {
    "gart_people": Case(1, 0),  # as profiles/people and zju
    "gart_ubc": Case(4, 1, {"bones": 9, "pose": "t_pose", "scales": (0.001, 0.3)}),
    "gart_list": Case(2, 2, {"frames": 5, "memory": "point", "pose": "a_pose"}),
    "gart_joints": Case(0, 3, {"bones": 0, "corrects": False}),
    "gart_points": Case(3, 4, {"memory": "point", "scales": (0.0, 0.1)}),
}
each_case = pytest.mark.parametrize("name", CASES)


def feeds(generator: GaussianGenerator, frame: dict[str, np.ndarray]) -> list[np.ndarray]:
    return [frame[declared.name] for declared in generator.inputs]


def golden(name: str, index: int) -> dict[str, np.ndarray]:
    """Return what the method's own code computed for a frame."""
    saved = np.load(GOLDENS / f"{name}.npz")
    return {field: saved[f"{field}_{index}"] for field in ALLOWED}


@each_case
def test_the_method_s_own_code_gives_the_same_gaussians(name: str, tmp_path: Path) -> None:
    case = CASES[name]
    generator = plugin.build(case.write(tmp_path))
    for index in range(POSES):
        rows, color = eager(generator, *feeds(generator, case.frame(index)))
        assert_golden(rows, color, golden(name, index), ALLOWED)


@each_case
@pytest.mark.parametrize("seed", range(2))
def test_plain_formulas_in_float64_give_the_same_gaussians(
    name: str, seed: int, tmp_path: Path
) -> None:
    case = Case(CASES[name].degree, 10 + seed, CASES[name].options)
    generator = plugin.build(case.write(tmp_path, count=41))
    for index in range(3):
        frame = case.frame(index)
        posed = PoseInputs(
            frame["pose"].astype(np.float64), np.eye(3), frame["root_translation"], np.zeros(0),
            pose_id=int(frame["frame_index"][0]),
        )  # fmt: skip
        expected = gart(tmp_path, posed, -frame["camera"][3, :3].astype(np.float64))
        assert_like(*eager(generator, *feeds(generator, frame)), expected)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", ["float32", "float16"])
@pytest.mark.parametrize("name", ["gart_people", "gart_ubc", "gart_list"])
def test_an_exported_model_agrees_with_the_method_and_runs_captured(
    name: str, dtype: str, tmp_path: Path
) -> None:
    case, path = CASES[name], tmp_path / "model.onnx"
    generator = plugin.build(case.write(tmp_path / "run"))
    # In half precision once is enough: arithmetic is the same.
    is_live = dtype == "float32" or name == "gart_list"
    settings = Settings(level=Level.LIVE if is_live else Level.STATIC)
    exported = export(generator, path, dtype=dtype, target="webgpu", settings=settings)
    if is_live:
        assert_captured(exported.report)
    session = onnxruntime.InferenceSession(path)
    allowed = ALLOWED if dtype == "float32" else ALLOWED_FLOAT16
    for index in range(POSES):
        frame = case.frame(index)
        used = {declared.name: frame[declared.name] for declared in generator.inputs}
        rows, color, *_ = session.run(None, used)
        assert_golden(rows, color, golden(name, index), allowed)


def test_two_persons_are_two_avatars(tmp_path: Path) -> None:
    case = CASES["gart_list"]
    folder = case.write(tmp_path)
    alone, both = plugin.build(folder), plugin.build(folder, instances=2)
    first, second = case.frame(1), case.frame(3) | {"camera": case.frame(1)["camera"]}
    rows = [eager(alone, *feeds(alone, frame)) for frame in (first, second)]
    numbered = {f"{name}_1": value for name, value in second.items()}
    together = eager(both, *feeds(both, first | numbered))
    for part, expected in zip(together, zip(*rows, strict=True), strict=True):
        np.testing.assert_allclose(part, np.concatenate(expected), rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["gart_people", "gart_list"])
def test_a_motion_moves_the_body_and_leaves_the_camera_free(name: str, tmp_path: Path) -> None:
    case = CASES[name]
    folder = case.write(tmp_path / "run")
    path = write_motion(tmp_path / "walk.npz", frames=4)
    played, alone = plugin.build(folder, motion=path), plugin.build(folder)
    assert [declared.role for declared in played.inputs] == ["time", "view"]
    motion, camera = read_motion(path, 24), case.frame(2)["camera"]
    for frame in range(4):
        posed = {
            "pose": motion.pose[frame], "root_translation": motion.shift[frame], "camera": camera,
            "frame_index": np.array([frame], np.int32),
        }  # fmt: skip
        values = {
            n: v.astype(np.int32 if n == "frame_index" else np.float32) for n, v in posed.items()
        }
        expected = eager(alone, *feeds(alone, values))
        actual = eager(played, np.array([frame / 4], np.float32), camera)
        for part, target in zip(actual, expected, strict=True):
            np.testing.assert_allclose(part, target, rtol=0, atol=2e-6)


def test_poses_of_training_are_a_motion(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    base, rest = rng.normal(size=(5, 1, 3)), rng.normal(size=(5, 23, 3))
    state = {
        "pose_base_list": base,
        "pose_rest_list": rest,
        "global_trans_list": rng.normal(size=(5, 3)),
    }
    state |= {
        "pose_list_original": np.zeros((5, 24, 3)),
        "global_trans_list_original": np.zeros((5, 3)),
    }
    path = tmp_path / "training_poses.pth"
    torch.save({name: torch.from_numpy(value).float() for name, value in state.items()}, path)
    motion = read_motion(path, 24)
    np.testing.assert_allclose(motion.pose, np.concatenate([base, rest], 1), rtol=1e-6)
    np.testing.assert_allclose(motion.shift, state["global_trans_list"], rtol=1e-6)
    torch.save({"pose_base_list": torch.zeros(5, 1, 3)}, path)
    with pytest.raises(CheckpointInvalid, match="missing: pose_rest_list, global_trans_list"):
        read_motion(path, 24)


def changed(folder: Path, change: Callable[[dict[str, torch.Tensor]], object]) -> Path:
    path = folder / "model.pth"
    state = torch.load(path, weights_only=True)
    change(state)
    torch.save(state, path)
    return folder


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s.pop("_xyz"), "missing: _xyz"),
        (lambda s: s.update({"_xyz": s["_xyz"][1:]}), "_rotation is [25, 4], expected [24, 4]"),
        (
            lambda s: s.update({"_features_rest": torch.zeros(25, 7)}),
            "_features_rest has 7 columns",
        ),
        (lambda s: s.update({"template.A0_inv": torch.zeros(35, 4, 4)}), "dogs are not supported"),
        (lambda s: s.pop("add_bones.mlp_output_head.weight"), "missing: add_bones.mlp_output_head"),
        (lambda s: s.update({"add_bones.late": torch.zeros(1)}), "unexpected: add_bones.late"),
        (lambda s: s.update({"_opacity": s["_opacity"] * np.nan}), "_opacity holds NaN"),
        (
            lambda s: s.update({"template.voxel_deformer.scale": torch.zeros(3)}),
            "template.voxel_deformer.scale is [3], expected []",
        ),
        (
            lambda s: s.update({"template._template_layer.parents": torch.arange(24)}),
            "joint 0 the parent 0",
        ),
    ],
)
def test_a_file_of_other_tensors_is_refused(
    change: Callable[[dict[str, torch.Tensor]], object], message: str, tmp_path: Path
) -> None:
    folder = changed(CASES["gart_people"].write(tmp_path), change)
    with pytest.raises(CheckpointInvalid, match=re.escape(message)):
        read_gart(folder)


def test_a_profile_is_required_as_scales_depend_on_it(tmp_path: Path) -> None:
    folder = CASES["gart_people"].write(tmp_path)
    assert read_gart(folder / "model.pth").path == folder / "model.pth"
    (folder / "people.yaml").unlink()
    with pytest.raises(CheckpointInvalid, match=r"profile\.yaml: does not exist"):
        read_gart(folder)
    (folder / "people.yaml").write_text("MAX_SCALE: small")
    with pytest.raises(CheckpointInvalid, match="MAX_SCALE is 'small', expected a number"):
        read_gart(folder)
