import shutil
from pathlib import Path

import numpy as np
import pytest

from gsgen.reference_plugins.heads import gaussian_avatars_plugin as plugin
from gsgen.reference_plugins.heads.gaussian_avatars import GaussianAvatars
from gsgen.reference_plugins.heads.gaussian_avatars_checkpoint import read_gaussian_avatars
from gsgen.reference_plugins.heads.teeth import TEETH_VERTEX_COUNT
from gsgen.reference_plugins.loading.array_archives import read_npz
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.synthetic import write_gaussian_avatar
from gsgen.reference_plugins.writing.run_files import write_columns
from plugins.heads.head_oracle import bound_gaussians, face_vertices
from support.checkpoints.plugin_checks import assert_like, eager
from support.checkpoints.spacetime_oracles import raw_columns
from support.commands import shared


@pytest.mark.parametrize("teeth", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_gaussians_follow_their_triangles(seed: int, teeth: bool, tmp_path: Path) -> None:
    read = read_gaussian_avatars(write_gaussian_avatar(tmp_path, teeth=teeth, seed=seed))
    generator, rng = GaussianAvatars(read), np.random.default_rng(seed)
    for size in (0.0, 0.5, 2.0):  # at rest, the angle of each rotation is zero
        pose, expression, shift = (
            (size * rng.normal(size=shape)).astype(np.float32) for shape in ((5, 3), 10, 3)
        )
        vertices = face_vertices(read, pose, expression.astype(float), shift.astype(float))
        expected = bound_gaussians(read, vertices)
        assert_like(*eager(generator, pose, expression, shift), expected)


def test_thin_triangles_keep_their_shape_far_from_the_origin(tmp_path: Path) -> None:
    read = read_gaussian_avatars(write_gaussian_avatar(tmp_path, rings=40))
    generator, rng = GaussianAvatars(read), np.random.default_rng(4)
    pose, expression, shift = (
        rng.normal(size=shape).astype(np.float32) for shape in ((5, 3), 10, 3)
    )
    near, far = (eager(generator, pose, expression, move)[0] for move in (0 * shift, 50 * shift))
    np.testing.assert_array_equal(near[:, 4:], far[:, 4:])
    rounding = np.spacing(np.abs(far[:, :3]))
    assert (np.abs(near[:, :3] + 50 * shift - far[:, :3]) <= 2 * rounding).all()


def test_teeth_are_those_of_the_method() -> None:
    case = shared("data/checkpoints/gavatars_teeth")
    read = read_gaussian_avatars(case / "ckpt")
    golden = np.load(case / "golden.npz")
    np.testing.assert_array_equal(read.body.faces, golden["aux_faces"])
    np.testing.assert_array_equal(read.binding, golden["aux_binding"])
    for frame in range(4):
        names = ("rotation", "neck_pose", "jaw_pose", "eyes_pose")
        pose = np.concatenate([golden[f"in_{name}"][frame] for name in names]).reshape(5, 3)
        expression, shift = (golden[f"in_{name}"][frame] for name in ("expr", "translation"))
        vertices = face_vertices(read, pose, expression.astype(float), shift.astype(float))
        np.testing.assert_allclose(
            vertices[-TEETH_VERTEX_COUNT:],
            golden[f"aux{frame}_verts"][-TEETH_VERTEX_COUNT:],
            atol=2e-6,
        )


def test_only_triangles_with_gaussians_are_computed(tmp_path: Path) -> None:
    read = read_gaussian_avatars(write_gaussian_avatar(tmp_path, count=5, rings=20))
    generator = GaussianAvatars(read)
    assert len(generator.rest) <= 15
    assert len(generator.corner_0) <= 5


def test_the_face_model_is_found_or_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = write_gaussian_avatar(tmp_path / "run")
    detected = plugin.build(run)
    assert "licence forbids redistribution" in capsys.readouterr().err
    shutil.move(run / "assets", tmp_path / "assets")
    with pytest.raises(CheckpointInvalid, match="the body model FLAME is missing") as caught:
        plugin.build(run)
    assert "--body FLAME" in caught.value.hint
    inputs = plugin.build(run, tmp_path / "assets/flame2023.pkl")
    np.testing.assert_array_equal(inputs.rest, detected.rest)


def test_mismatched_files_are_named(tmp_path: Path) -> None:
    run = write_gaussian_avatar(tmp_path, count=6)
    (cloud,), (params,) = run.rglob("*.ply"), run.rglob("flame_param.npz")
    columns, arrays = raw_columns(cloud), dict(read_npz(params))
    cases = (
        ({"binding_0": np.full(6, 1e6)}, {}, "binding_0 names triangle 1000000"),
        ({"binding_0": np.full(6, 0.5)}, {}, "binding_0 holds fractions"),
        ({}, {"static_offset": np.zeros((1, 9, 3))}, "static_offset is"),
        ({}, {"expr": np.zeros((3, 99))}, "300 shapes and 99 expressions"),
        ({}, {"shape": np.full(300, np.nan)}, "shape is missing, or holds other values"),
    )
    for changed_columns, changed_arrays, message in cases:
        write_columns(cloud, columns | changed_columns)
        np.savez(params, **(arrays | changed_arrays))
        with pytest.raises(CheckpointInvalid, match=message):
            read_gaussian_avatars(run)
