"""Body models, motions and checkpoints of people: what is read, and what is refused."""

import io
import json
import os
import pickle
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gsgen.reference_plugins.checkpoints.array_pickles import read_array_pickle
from gsgen.reference_plugins.checkpoints.bodies import read_body
from gsgen.reference_plugins.checkpoints.cfg_args import CfgArgs
from gsgen.reference_plugins.checkpoints.errors import CheckpointInvalid, NotInCheckpoint
from gsgen.reference_plugins.checkpoints.gauhuman import read_gauhuman
from gsgen.reference_plugins.checkpoints.lhm import read_face, read_lhm
from gsgen.reference_plugins.checkpoints.motions import read_motion
from gsgen.reference_plugins.checkpoints.r3_avatar import guessed_dataset, read_r3
from gsgen.reference_plugins.synthetic import (
    PersonOptions,
    write_body,
    write_gauhuman,
    write_lhm,
    write_motion,
    write_r3,
)


class Harmful:
    """Runs a command where a pickle reader obeys it."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (f"touch {self.path}",)


def unpickled(path: Path, value: object) -> Path:
    path.write_bytes(pickle.dumps(value, protocol=2))
    return path


@pytest.mark.parametrize("hidden", [False, True])
def test_a_body_model_runs_nothing(hidden: bool, tmp_path: Path) -> None:
    harm = Harmful(tmp_path / "harmed")
    value = {"v_template": np.array([harm], object) if hidden else harm}
    path = unpickled(tmp_path / "SMPL_NEUTRAL.pkl", value)
    with pytest.raises(CheckpointInvalid, match="system, which is no array"):
        read_body(path, 24)
    assert not (tmp_path / "harmed").exists()


def test_a_checkpoint_of_r3_runs_nothing(tmp_path: Path) -> None:
    folder = write_r3(tmp_path / "run")
    torch.save((Harmful(tmp_path / "harmed"), 60000), folder / "chkpnt60000.pth")
    with pytest.raises(CheckpointInvalid, match="system"):
        read_r3(folder)
    assert not (tmp_path / "harmed").exists()


def test_an_avatar_of_lhm_runs_nothing(tmp_path: Path) -> None:
    folder = write_lhm(tmp_path / "run")
    torch.save([Harmful(tmp_path / "harmed")] * 10, folder / "avatar.pth")
    with pytest.raises(CheckpointInvalid, match="system"):
        read_lhm(folder)
    assert not (tmp_path / "harmed").exists()


def test_a_body_lies_where_training_read_it_from(tmp_path: Path) -> None:
    run = write_gauhuman(tmp_path / "GauHuman/output/zju/my_377", PersonOptions(count=3))
    (run / "assets").rename(tmp_path / "GauHuman/assets")
    assert read_gauhuman(run).body.path == tmp_path / "GauHuman/assets/SMPL_NEUTRAL.pkl"
    (tmp_path / "GauHuman/assets").rename(tmp_path / "elsewhere")
    with pytest.raises(CheckpointInvalid, match="my_377/assets/SMPL_NEUTRAL"):
        read_gauhuman(run)


@pytest.mark.parametrize("kind", ["smpl", "smplx"])
def test_without_options_the_body_says_which_it_is(kind: str, tmp_path: Path) -> None:
    chosen = PersonOptions(count=3, kind=kind, shapes=20, nets=True)  # type: ignore[arg-type]
    run = write_gauhuman(tmp_path / "run", chosen)
    body = read_gauhuman(run).body
    (run / "cfg_args").unlink()
    read = read_gauhuman(run, body=body.path).body
    assert (read.joints, read.shape_dirs.shape) == (body.joints, body.shape_dirs.shape)


def test_an_avatar_may_be_of_one_gaussian(tmp_path: Path) -> None:
    run = write_lhm(tmp_path, PersonOptions(count=1))
    path = run / "avatar.pth"
    read = torch.load(path, weights_only=False)
    torch.save([one.squeeze() if torch.is_tensor(one) else one for one in read], path)
    assert read_lhm(run).position.shape == (1, 3)


@pytest.mark.parametrize("module", ["numpy.core", "numpy._core"])
def test_numbers_of_numpy_beside_the_tensors_do_no_harm(
    module: str, tmp_path: Path
) -> None:
    """Learning rates, the extent of a scene: old and new NumPy name them differently."""
    files = {
        write_r3(tmp_path / "r3") / "chkpnt60000.pth": lambda: read_r3(tmp_path / "r3"),
        write_lhm(tmp_path / "lhm") / "avatar.pth": lambda: read_lhm(tmp_path / "lhm"),
    }
    for path, read in files.items():
        rewritten = io.BytesIO()
        with zipfile.ZipFile(path) as old, zipfile.ZipFile(rewritten, "w") as new:
            for name in old.namelist():
                data = old.read(name)
                if name.endswith("data.pkl"):
                    assert b"numpy._core.multiarray" in data
                    data = data.replace(b"numpy._core", module.encode())
                new.writestr(name, data)
        path.write_bytes(rewritten.getvalue())
        assert len(read().body.parents) in (24, 55)


# As Python 2 wrote them: protocol 0 and the module names of that time.
OLD = (
    b"(dp0\nS'x'\np1\nccopy_reg\n_reconstructor\np2\n(cchumpy.ch\nCh\np3\nc__builtin__\nobject\n"
    b"p4\nNtp5\nRp6\n(dp7\nS'x'\np8\ncnumpy.core.multiarray\n_reconstruct\np9\n(cnumpy\nndarray\n"
    b"p10\n(I0\ntp11\nS'b'\np12\ntp13\nRp14\n(I1\n(I2\ntp15\ncnumpy\ndtype\np16\n(S'f8'\np17\nI0\n"
    b"I1\ntp18\nRp19\n(I3\nS'<'\np20\nNNNI-1\nI-1\nI0\ntp21\nbI00\n"
    b"S'\\x00\\x00\\x00\\x00\\x00\\x00\\xf0?\\x00\\x00\\x00\\x00\\x00\\x00\\x00@'\np22\ntp23\n"
    b"bsbs."
)


def test_arrays_that_chumpy_wraps_are_taken_out(tmp_path: Path) -> None:
    path = tmp_path / "old.pkl"
    path.write_bytes(OLD)
    np.testing.assert_array_equal(read_array_pickle(path)["x"], [1.0, 2.0])


@pytest.fixture
def chumpy(monkeypatch: pytest.MonkeyPatch) -> dict[str, type]:
    """Return classes that pickle as those of chumpy do, with the notes that they keep."""
    made: dict[str, type] = {}
    for module, name in (("chumpy.ch", "Ch"), ("chumpy.reordering", "Select")):
        made[name] = type(name, (), {"__module__": module})
        home = ModuleType(module)
        setattr(home, name, made[name])
        monkeypatch.setitem(sys.modules, module, home)
    monkeypatch.setitem(sys.modules, "chumpy", ModuleType("chumpy"))
    return made


def with_state(kind: type, **state: Any) -> object:
    one = kind()
    one.__dict__.update(state, _dirty_vars={"x"}, _itr=None, _depends_on_deps={})
    return one


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_selections_of_chumpy_are_taken_out(
    protocol: int, chumpy: dict[str, type], tmp_path: Path
) -> None:
    whole = np.random.default_rng(0).random((5, 3, 9))
    chosen = np.arange(whole.size).reshape(whole.shape)[:, :, :4].ravel()
    inner = with_state(chumpy["Ch"], x=whole)
    value = with_state(chumpy["Select"], a=inner, idxs=chosen, preferred_shape=(5, 3, 4))
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps({"shapedirs": value, "one": inner}, protocol=protocol))
    read = read_array_pickle(path)
    np.testing.assert_array_equal(read["shapedirs"], whole[:, :, :4])
    np.testing.assert_array_equal(read["one"], whole)


def test_an_array_that_is_made_of_itself_is_refused(
    chumpy: dict[str, type], tmp_path: Path
) -> None:
    one = with_state(chumpy["Ch"])
    one.x = one  # type: ignore[attr-defined]
    with pytest.raises(CheckpointInvalid, match="RecursionError"):
        read_array_pickle(unpickled(tmp_path / "a.pkl", {"x": one}))


@pytest.mark.parametrize("kind", ["csc", "csr"])
def test_sparse_matrices_become_arrays(kind: str, tmp_path: Path) -> None:
    from scipy import sparse

    dense = np.random.default_rng(0).random((4, 7)) * (
        np.random.default_rng(1).random((4, 7)) > 0.5
    )
    made = sparse.csc_matrix(dense) if kind == "csc" else sparse.csr_matrix(dense)
    path = unpickled(tmp_path / "a.pkl", {"m": made})
    np.testing.assert_array_equal(read_array_pickle(path)["m"], dense)


@pytest.mark.parametrize("cut", [0, 1, 50, 1000, -1])
def test_a_damaged_body_is_no_traceback(cut: int, tmp_path: Path) -> None:
    for name in ("SMPL.pkl", "SMPL.npz"):
        path = write_body(tmp_path / name)
        path.write_bytes(path.read_bytes()[:cut])
        with pytest.raises(CheckpointInvalid):
            read_body(path, 24)


def rewritten(path: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    with np.load(path) as read:
        arrays = dict(read)
    change(arrays)
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda a: a.pop("weights"), "lacks weights"),
        (
            lambda a: a.update(posedirs=a["posedirs"][:, :, 1:]),
            r"posedirs is \[150, 3, 206\]",
        ),
        (lambda a: a.update(weights=a["weights"] * np.nan), "weights holds NaN"),
        (lambda a: a["kintree_table"].__setitem__((0, 3), 9), "joint 3 the parent 9"),
        (lambda a: a.update(v_template=np.array(["x"])), "wanted numbers"),
        (lambda a: a.update(v_template=np.zeros(0)), "v_template is"),
    ],
)
def test_a_body_of_another_shape_is_refused(
    change: Callable[[dict[str, Any]], object], words: str, tmp_path: Path
) -> None:
    path = rewritten(write_body(tmp_path / "SMPL.npz"), change)
    with pytest.raises(CheckpointInvalid, match=words):
        read_body(path, 24)


def test_the_other_body_is_refused_by_its_joints(tmp_path: Path) -> None:
    path = write_body(tmp_path / "SMPLX.npz", PersonOptions(kind="smplx"))
    with pytest.raises(CheckpointInvalid, match="Give the SMPL model"):
        read_body(path, 24)


def edited(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_flags_have_to_agree_with_files(tmp_path: Path) -> None:
    folder = write_gauhuman(tmp_path / "a", PersonOptions(nets=True))
    edited(folder / "cfg_args", "motion_offset_flag=True", "motion_offset_flag=False")
    with pytest.raises(
        CheckpointInvalid, match="motion_offset_flag is False, but there is"
    ):
        read_gauhuman(folder)
    folder = write_gauhuman(tmp_path / "b")
    edited(folder / "cfg_args", "motion_offset_flag=False", "motion_offset_flag=True")
    with pytest.raises(CheckpointInvalid, match=r"ckpt\.pth: is missing"):
        read_gauhuman(folder)
    edited(folder / "cfg_args", "'smpl'", "'simple_smplx'")
    with pytest.raises(CheckpointInvalid, match="'simple_smplx', wanted 'smpl' or 'smplx'"):
        read_gauhuman(folder)


def test_networks_have_to_have_every_tensor_and_no_other(tmp_path: Path) -> None:
    folder = write_gauhuman(tmp_path, PersonOptions(nets=True))
    path = folder / "mlp_ckpt/iteration_1200/ckpt.pth"
    state = torch.load(path, weights_only=True)
    state["pose_decoder"]["block_mlps.6.weight"] = torch.zeros(1)
    del state["pose_decoder"]["block_mlps.4.bias"]
    torch.save(state, path)
    with pytest.raises(CheckpointInvalid) as caught:
        read_gauhuman(folder)
    assert "missing: block_mlps.4.bias" in str(caught.value)
    assert "unexpected: block_mlps.6.weight" in str(caught.value)


@pytest.mark.parametrize("name", ["bw_linears.0.weight", "bw_fc.bias"])
def test_a_network_without_one_of_its_tensors_is_refused(name: str, tmp_path: Path) -> None:
    folder = write_gauhuman(tmp_path, PersonOptions(nets=True))
    path = folder / "mlp_ckpt/iteration_1200/ckpt.pth"
    state = torch.load(path, weights_only=True)
    del state["lweight_offset_decoder"][name]
    torch.save(state, path)
    with pytest.raises(CheckpointInvalid, match=f"missing: {name}"):
        read_gauhuman(folder)


def test_the_data_set_is_asked_for_where_it_cannot_be_told(tmp_path: Path) -> None:
    folder = write_r3(tmp_path)
    assert read_r3(folder).origin == 150
    edited(folder / "cfg_args", "/data/zju_mocap/my_377", "/data/scene")
    with pytest.raises(CheckpointInvalid, match="--dataset, one of dna, zju"):
        read_r3(folder)
    assert read_r3(folder, dataset="dna").origin == 50


@pytest.mark.parametrize(
    ("options", "dataset"),
    [
        ({"source_path": "../dataset/DNA-Rendering/0012_03"}, "dna"),
        ({"source_path": "/home/edna/zju_mocap/my_377"}, "zju"),  # as training decides
        ({"source_path": "/HiFi4G/MVHumanNet/a"}, "hifi4g"),
        ({"source_path": "/data/MvHuman/100003"}, "mvhuman"),
        ({"source_path": "/data/scene", "exp_name": "hifi4g_mono/4K_Actor1"}, "hifi4g"),
        ({"exp_name": "dna_stage1/zju_377", "smpl_type": "smpl"}, "zju"),  # by its body
        ({"exp_name": "dna_stage1/zju_377", "smpl_type": "smplx"}, "dna"),
        ({"exp_name": "zju_hifi4g"}, None),
        ({}, None),
    ],
)
def test_whose_data_it_is_follows_from_paths_and_names(
    options: dict[str, str], dataset: str | None, tmp_path: Path
) -> None:
    cfg = CfgArgs(tmp_path, options)
    if dataset is not None:
        assert guessed_dataset(cfg) == dataset
        return
    with pytest.raises(CheckpointInvalid, match="--dataset, one of"):
        guessed_dataset(cfg)


def test_what_lies_in_a_run_of_people_stands_for_it(tmp_path: Path) -> None:
    run = write_r3(tmp_path / "r3")
    for given in (run / "chkpnt60000.pth", run / "cfg_args"):
        assert read_r3(given).path == run / "chkpnt60000.pth"
    with pytest.raises(NotInCheckpoint, match="has no iteration 5"):
        read_r3(run / "chkpnt60000.pth", 5)
    with pytest.raises(CheckpointInvalid, match="does not exist"):
        read_r3(run / "nowhere")
    run = write_gauhuman(tmp_path / "gauhuman", PersonOptions(nets=True))
    for place in ("point_cloud/iteration_1200/point_cloud.ply", "mlp_ckpt/iteration_1200"):
        read = read_gauhuman(run / place)
        assert (read.iteration, read.nets is not None) == (1200, True)


def test_sample_points_have_to_be_as_many_as_gaussians(tmp_path: Path) -> None:
    folder = write_lhm(tmp_path / "a", PersonOptions(count=9))
    other = write_lhm(tmp_path / "b", PersonOptions(count=8))
    points = "pretrained_models/dense_sample_points/1_40000.ply"
    (folder / points).write_bytes((other / points).read_bytes())
    with pytest.raises(CheckpointInvalid, match=r"no \.ply of 9 points"):
        read_lhm(folder)
    (folder / points).unlink()
    with pytest.raises(CheckpointInvalid, match="comes with LHM's weights"):
        read_lhm(folder)


def test_flame_goes_to_the_vertices_that_the_list_names(tmp_path: Path) -> None:
    read = read_lhm(write_lhm(tmp_path / "run"))
    rng = np.random.default_rng(0)
    dirs = rng.normal(size=(12, 3, 400)).astype(np.float32)
    flame = unpickled(tmp_path / "FLAME_NEUTRAL.pkl", {"shapedirs": dirs})
    ids = tmp_path / "ids.npy"
    np.save(ids, rng.permutation(150)[:12])
    face = read_face(flame, ids, read.body)
    np.testing.assert_array_equal(face.dirs, dirs[:, :, 300:])
    np.save(ids, np.arange(11))
    with pytest.raises(CheckpointInvalid, match="wanted 12 vertex numbers"):
        read_face(flame, ids, read.body)


@pytest.mark.parametrize("joints", [24, 55])
@pytest.mark.parametrize("width", [66, 72, 156, 165])
def test_poses_of_one_body_become_those_of_another(
    width: int, joints: int, tmp_path: Path
) -> None:
    path = write_motion(tmp_path / "a.npz", frames=3, width=width)
    with np.load(path) as read:
        poses = read["poses"]
    motion = read_motion(path, joints)
    assert motion.pose.shape == (3, joints, 3)
    assert motion.fps == 30
    flat = motion.pose.reshape(3, -1)
    np.testing.assert_allclose(flat[:, :66], poses[:, :66])
    hands = width >= 156 and joints == 55
    rest = flat[:, -90:] if joints == 55 else flat[:, 66:]
    if hands:
        np.testing.assert_allclose(rest, poses[:, -90:])
    elif width == 72 and joints == 24:
        np.testing.assert_allclose(rest, poses[:, 66:])
    else:
        assert not rest.any()


def test_frames_of_a_folder_are_put_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for number in (2, 10, 1):
        np.savez(
            tmp_path / f"{number}.npz",
            poses=np.full((1, 72), 0.01 * number),
            Rh=np.array([[0.0, 0.0, np.pi / 2]]),
            Th=np.array([[number, 0.0, 0.0]]),
            shapes=np.arange(10.0)[None],
        )
    motion = read_motion(tmp_path, 24)
    np.testing.assert_array_equal(motion.shift[:, 0], [1, 2, 10])
    np.testing.assert_allclose(motion.pose[2], 0.1)
    assert motion.turn is not None
    np.testing.assert_allclose(motion.turn[0] @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_array_equal(motion.shape, np.arange(10.0))


def frame(number: int) -> dict[str, Any]:
    sizes = {"root_pose": 1, "body_pose": 21, "jaw_pose": 1, "leye_pose": 1, "reye_pose": 1}
    sizes |= {"lhand_pose": 15, "rhand_pose": 15}
    made: dict[str, Any] = {
        name: np.full((size, 3), 0.1 * number + index).tolist()
        for index, (name, size) in enumerate(sizes.items())
    }
    return made | {"trans": [0, number, 0], "expr": [0.5] * 100, "betas": [9.0] * 10}


@pytest.mark.parametrize("single", [True, False])
def test_lhm_s_frames_are_read_one_by_one_or_all_together(
    single: bool, tmp_path: Path
) -> None:
    frames = [frame(number) for number in range(3)]
    path = tmp_path / "motion.json"
    if single:
        path.write_text(json.dumps(frames))
    else:
        path = tmp_path / "smplx_params"
        path.mkdir()
        for number, one in enumerate(frames):
            (path / f"{number:05d}.json").write_text(json.dumps(one))
    motion = read_motion(path, 55)
    np.testing.assert_allclose(
        motion.pose[1, [0, 1, 22, 23, 24, 25, 40], 0], 0.1 + np.arange(7)
    )
    np.testing.assert_array_equal(motion.shift[:, 1], [0, 1, 2])
    assert motion.expression is not None
    assert motion.expression.shape == (3, 100)
    assert motion.shape is None  # its betas are of who was filmed


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[]", "holds no frame"),
        ("{", "cannot be read"),
        ("[3]", "frame 0: is a int"),
        ("[{}]", "root_pose is missing"),
        ('[{"root_pose": [1, 2]}]', "root_pose has 2 numbers, wanted 3"),
        ('[{"root_pose": [1, 2, NaN]}]', "all finite"),
    ],
)
def test_a_motion_that_is_none_is_refused(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "motion.json"
    path.write_text(text)
    with pytest.raises(CheckpointInvalid, match=words):
        read_motion(path, 55)


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({}, "has no poses"),
        ({"poses": np.zeros((2, 70))}, "a pose has 70 numbers"),
        ({"poses": np.zeros((2, 72)), "Th": np.zeros((3, 3))}, "3 numbers for 2 frames"),
        ({"poses": np.full((2, 72), np.inf)}, "wanted finite numbers"),
        ({"poses": np.array([object()])}, "cannot be read"),
    ],
)
def test_arrays_that_are_no_motion_are_refused(
    arrays: dict[str, np.ndarray], words: str, tmp_path: Path
) -> None:
    path = tmp_path / "motion.npz"
    np.savez(path, **arrays)  # type: ignore[arg-type]
    with pytest.raises(CheckpointInvalid, match=words):
        read_motion(path, 24)


def test_frames_of_zju_mocap_are_read_out_of_their_pickles(tmp_path: Path) -> None:
    rng, frames = np.random.default_rng(0), []
    for number in (10, 9):  # in the order of numbers, not of text
        turn, place = rng.normal(size=(1, 3)), rng.normal(size=(1, 3))
        frame = {"Rh": turn, "Th": place, "poses": rng.normal(size=(1, 72))}
        frame["shapes"] = np.arange(10.0)[None]
        np.save(tmp_path / f"{number}.npy", frame)  # type: ignore[arg-type]
        frames.insert(0, frame)
    read = read_motion(tmp_path, 24)
    np.testing.assert_array_equal(read.pose.reshape(2, 72), [f["poses"][0] for f in frames])
    np.testing.assert_array_equal(read.shift, [f["Th"][0] for f in frames])
    assert read.turn is not None
    wanted = Rotation.from_rotvec([f["Rh"][0] for f in frames]).as_matrix()
    np.testing.assert_allclose(read.turn, wanted)
    assert read.shape is not None
    np.testing.assert_array_equal(read.shape, np.arange(10.0))
    one = read_motion(tmp_path / "10.npy", 24)
    np.testing.assert_array_equal(one.pose[0], read.pose[1])


def test_a_frame_of_zju_mocap_runs_nothing(tmp_path: Path) -> None:
    harm = {"poses": Harmful(tmp_path / "harmed")}
    np.save(tmp_path / "0.npy", harm)  # type: ignore[arg-type]
    with pytest.raises(CheckpointInvalid, match="which is no array"):
        read_motion(tmp_path, 24)
    assert not (tmp_path / "harmed").exists()
    np.save(tmp_path / "0.npy", np.zeros(72))
    with pytest.raises(CheckpointInvalid, match="holds an array, wanted a dict"):
        read_motion(tmp_path / "0.npy", 24)


def test_a_missing_motion_says_what_is_wanted(tmp_path: Path) -> None:
    with pytest.raises(CheckpointInvalid, match="AMASS"):
        read_motion(tmp_path / "nowhere.npz", 24)
    with pytest.raises(CheckpointInvalid, match=r"no \.npz, \.npy or \.json"):
        read_motion(tmp_path, 24)
