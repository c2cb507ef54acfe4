"""Body models and checkpoints of people: what is read, and what is refused."""

import io
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
from scipy import sparse

from gsgen.reference_plugins.bodies.body_models import read_body
from gsgen.reference_plugins.loading.array_pickles import read_array_pickle
from gsgen.reference_plugins.loading.cfg_args import CfgArgs
from gsgen.reference_plugins.loading.errors import CheckpointInvalid, NotInCheckpoint
from gsgen.reference_plugins.people.gauhuman_checkpoint import read_gauhuman
from gsgen.reference_plugins.people.lhm_checkpoint import read_face, read_lhm
from gsgen.reference_plugins.people.r3_avatar_checkpoint import guess_dataset, read_r3
from gsgen.reference_plugins.synthetic import (
    PersonOptions,
    write_body,
    write_gauhuman,
    write_lhm,
    write_r3,
)
from plugins.people.harmful_pickles import Harmful


def unpickled(path: Path, value: object) -> Path:
    path.write_bytes(pickle.dumps(value, protocol=2))
    return path


@pytest.mark.parametrize("hidden", [False, True])
def test_a_body_model_runs_nothing(hidden: bool, tmp_path: Path) -> None:
    harmful_body = Harmful(tmp_path / "harmed")
    value = {"v_template": np.array([harmful_body], object) if hidden else harmful_body}
    path = unpickled(tmp_path / "SMPL_NEUTRAL.pkl", value)
    with pytest.raises(CheckpointInvalid, match="system, which is not an array"):
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
    options = PersonOptions(count=3, kind=kind, shapes=20, nets=True)  # type: ignore[arg-type]
    run = write_gauhuman(tmp_path / "run", options)
    body = read_gauhuman(run).body
    (run / "cfg_args").unlink()
    read = read_gauhuman(run, body=body.path).body
    assert (read.joints, read.shape_dirs.shape) == (body.joints, body.shape_dirs.shape)


def test_an_avatar_may_be_of_one_gaussian(tmp_path: Path) -> None:
    run = write_lhm(tmp_path, PersonOptions(count=1))
    path = run / "avatar.pth"
    read = torch.load(path, weights_only=False)
    torch.save([value.squeeze() if torch.is_tensor(value) else value for value in read], path)
    assert read_lhm(run).position.shape == (1, 3)


@pytest.mark.parametrize("module", ["numpy.core", "numpy._core"])
def test_numbers_of_numpy_beside_the_tensors_do_no_harm(module: str, tmp_path: Path) -> None:
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
PYTHON2_PICKLE = (
    b"(dp0\nS'x'\np1\nccopy_reg\n_reconstructor\np2\n(cchumpy.ch\nCh\np3\nc__builtin__\nobject\n"
    b"p4\nNtp5\nRp6\n(dp7\nS'x'\np8\ncnumpy.core.multiarray\n_reconstruct\np9\n(cnumpy\nndarray\n"
    b"p10\n(I0\ntp11\nS'b'\np12\ntp13\nRp14\n(I1\n(I2\ntp15\ncnumpy\ndtype\np16\n(S'f8'\np17\nI0\n"
    b"I1\ntp18\nRp19\n(I3\nS'<'\np20\nNNNI-1\nI-1\nI0\ntp21\nbI00\n"
    b"S'\\x00\\x00\\x00\\x00\\x00\\x00\\xf0?\\x00\\x00\\x00\\x00\\x00\\x00\\x00@'\np22\ntp23\n"
    b"bsbs."
)


def test_arrays_that_chumpy_wraps_are_taken_out(tmp_path: Path) -> None:
    path = tmp_path / "old.pkl"
    path.write_bytes(PYTHON2_PICKLE)
    np.testing.assert_array_equal(read_array_pickle(path, ["x"])["x"], [1.0, 2.0])


@pytest.fixture
def chumpy(monkeypatch: pytest.MonkeyPatch) -> dict[str, type]:
    """Return classes that pickle as those of chumpy do, with the notes that they keep."""
    classes: dict[str, type] = {}
    for module, name in (("chumpy.ch", "Ch"), ("chumpy.reordering", "Select")):
        classes[name] = type(name, (), {"__module__": module})
        chumpy_module = ModuleType(module)
        setattr(chumpy_module, name, classes[name])
        monkeypatch.setitem(sys.modules, module, chumpy_module)
    monkeypatch.setitem(sys.modules, "chumpy", ModuleType("chumpy"))
    return classes


def with_state(kind: type, **state: Any) -> object:
    instance = kind()
    instance.__dict__.update(state, _dirty_vars={"x"}, _itr=None, _depends_on_deps={})
    return instance


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_selections_of_chumpy_are_taken_out(
    protocol: int, chumpy: dict[str, type], tmp_path: Path
) -> None:
    whole = np.random.default_rng(0).random((5, 3, 9))
    indices = np.arange(whole.size).reshape(whole.shape)[:, :, :4].ravel()
    inner = with_state(chumpy["Ch"], x=whole)
    value = with_state(chumpy["Select"], a=inner, idxs=indices, preferred_shape=(5, 3, 4))
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps({"shapedirs": value, "one": inner}, protocol=protocol))
    read = read_array_pickle(path, ["shapedirs", "one"])
    np.testing.assert_array_equal(read["shapedirs"], whole[:, :, :4])
    np.testing.assert_array_equal(read["one"], whole)


def test_an_array_that_is_made_of_itself_is_refused(
    chumpy: dict[str, type], tmp_path: Path
) -> None:
    array = with_state(chumpy["Ch"])
    array.x = array  # type: ignore[attr-defined]
    with pytest.raises(CheckpointInvalid, match="RecursionError"):
        read_array_pickle(unpickled(tmp_path / "a.pkl", {"x": array}), ["x"])


@pytest.mark.parametrize("kind", ["csc", "csr"])
def test_sparse_matrices_become_arrays(kind: str, tmp_path: Path) -> None:
    dense = np.random.default_rng(0).random((4, 7)) * (
        np.random.default_rng(1).random((4, 7)) > 0.5
    )
    matrix = sparse.csc_matrix(dense) if kind == "csc" else sparse.csr_matrix(dense)
    path = unpickled(tmp_path / "a.pkl", {"m": matrix})
    np.testing.assert_array_equal(read_array_pickle(path, ["m"])["m"], dense)


def _dtype_with_state(code: str, flags: int) -> object:
    """Return what pickles as a NumPy dtype that sets its own state."""

    class Dtype:
        def __reduce__(self) -> tuple[Any, ...]:
            return np.dtype, (code, False, True), (3, "|", None, None, None, -1, -1, flags)

    return Dtype()


class _Stored:
    """What pickles as a NumPy array of given bytes."""

    def __init__(self, data: object, dtype: object, shape: tuple[int, ...]) -> None:
        self.state = (1, shape, dtype, False, data)

    def __reduce__(self) -> tuple[Any, ...]:
        return np.zeros(0).__reduce__()[0], (np.ndarray, (0,), b"b"), self.state


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (_Stored(b"A" * 16, _dtype_with_state("O8", 0), (2,)), "holds objects, expected numbers"),
        (_Stored(b"A" * 16, _dtype_with_state("V8", 63), (2,)), "dtype 'V8', expected numbers"),
        (_Stored(b"A" * 16, _dtype_with_state("M8", 0), (2,)), "dtype 'M8', expected numbers"),
        (_Stored(b"A" * 16, np.dtype("f8"), (3,)), r"\[3\] of f8, but has 16 bytes"),
        (_Stored(b"A" * 16, np.dtype("f8"), (-2,)), "not a whole number"),
        (_Stored([1.0, 2.0], np.dtype("f8"), (2,)), "a list for its bytes"),
        (np.array([None]), "holds objects"),
        ([[1, 2]], "list of lists"),
    ],
)
def test_an_array_that_its_bytes_do_not_fit_is_refused_in_one_line(
    array: object, words: str, tmp_path: Path
) -> None:
    """The first of them, read by NumPy's own unpickling, takes numbers for addresses."""
    with pytest.raises(CheckpointInvalid, match=words) as caught:
        read_array_pickle(unpickled(tmp_path / "a.pkl", {"x": array}), ["x"])
    assert "\n" not in caught.value.message


def test_small_pickles_do_not_take_large_memory(tmp_path: Path) -> None:
    path = tmp_path / "a.pkl"
    path.write_bytes(b"\x80\x02}r" + (0x7FFFFFFF).to_bytes(4, "little") + b".")
    assert read_array_pickle(path, ["x"]) == {}  # 32 GiB where the memo is a list
    unpickled(path, {"x": sparse.csc_matrix((1 << 40, 1))})
    with pytest.raises(CheckpointInvalid, match="arrays of 1,099,511,627,776 numbers"):
        read_array_pickle(path, ["x"])
    path.write_bytes(b"\x80\x02})" + b"\x85" * 3_000_000 + b"Ns.")  # a key three million deep
    with pytest.raises(CheckpointInvalid, match="a tuple of tuples"):
        read_array_pickle(path, ["x"])


@pytest.mark.parametrize("cut", [0, 1, 50, 1000, -1])
def test_damaged_body_model_is_reported_without_a_traceback(cut: int, tmp_path: Path) -> None:
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
        (lambda a: a.update(posedirs=a["posedirs"][:, :, 1:]), r"posedirs is \[150, 3, 206\]"),
        (lambda a: a.update(weights=a["weights"] * np.nan), "weights holds NaN"),
        (lambda a: a["kintree_table"].__setitem__((0, 3), 9), "joint 3 the parent 9"),
        (lambda a: a.update(v_template=np.array(["x"])), "expected numbers"),
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
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def test_flags_have_to_agree_with_files(tmp_path: Path) -> None:
    folder = write_gauhuman(tmp_path / "a", PersonOptions(nets=True))
    edited(folder / "cfg_args", "motion_offset_flag=True", "motion_offset_flag=False")
    with pytest.raises(CheckpointInvalid, match=r"motion_offset_flag is False, but .* exists"):
        read_gauhuman(folder)
    folder = write_gauhuman(tmp_path / "b")
    edited(folder / "cfg_args", "motion_offset_flag=False", "motion_offset_flag=True")
    with pytest.raises(CheckpointInvalid, match=r"ckpt\.pth: is missing"):
        read_gauhuman(folder)
    edited(folder / "cfg_args", "'smpl'", "'simple_smplx'")
    with pytest.raises(CheckpointInvalid, match="'simple_smplx', expected 'smpl' or 'smplx'"):
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
def test_data_set_is_inferred_from_paths_and_names(
    options: dict[str, str], dataset: str | None, tmp_path: Path
) -> None:
    cfg = CfgArgs(tmp_path, options)
    if dataset is not None:
        assert guess_dataset(cfg) == dataset
        return
    with pytest.raises(CheckpointInvalid, match="--dataset, one of"):
        guess_dataset(cfg)


def test_file_inside_a_run_of_people_selects_the_run(tmp_path: Path) -> None:
    run = write_r3(tmp_path / "r3")
    for path in (run / "chkpnt60000.pth", run / "cfg_args"):
        assert read_r3(path).path == run / "chkpnt60000.pth"
    with pytest.raises(NotInCheckpoint, match="has no iteration 5"):
        read_r3(run / "chkpnt60000.pth", 5)
    with pytest.raises(CheckpointInvalid, match="does not exist"):
        read_r3(run / "nowhere")
    run = write_gauhuman(tmp_path / "gauhuman", PersonOptions(nets=True))
    for path_in_run in ("point_cloud/iteration_1200/point_cloud.ply", "mlp_ckpt/iteration_1200"):
        read = read_gauhuman(run / path_in_run)
        assert (read.run.iteration, read.nets is not None) == (1200, True)


def test_sample_points_have_to_be_as_many_as_gaussians(tmp_path: Path) -> None:
    folder = write_lhm(tmp_path / "a", PersonOptions(count=9))
    other_avatar = write_lhm(tmp_path / "b", PersonOptions(count=8))
    points = "pretrained_models/dense_sample_points/1_40000.ply"
    (folder / points).write_bytes((other_avatar / points).read_bytes())
    with pytest.raises(CheckpointInvalid, match=r"no \.ply file of 9 points"):
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
    with pytest.raises(CheckpointInvalid, match="expected 12 vertex indices"):
        read_face(flame, ids, read.body)
