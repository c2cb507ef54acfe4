import pickle
import shutil
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from gsgen.formats import ply_properties, read_ply_columns
from gsgen.reference_plugins.anchors import octree_gs_plugin
from gsgen.reference_plugins.anchors.anchor_checkpoint import read_anchors
from gsgen.reference_plugins.deformation.deformation_checkpoint import read_deformation
from gsgen.reference_plugins.deformation.hexplane_checkpoint import read_hexplanes
from gsgen.reference_plugins.diffusion.model_config import read_model_config
from gsgen.reference_plugins.loading.errors import CheckpointInvalid, NotInCheckpoint
from gsgen.reference_plugins.loading.folder import find_iteration
from gsgen.reference_plugins.loading.states import read_script_state
from gsgen.reference_plugins.synthetic import (
    AnchorOptions,
    HexPlaneOptions,
    write_deformable,
    write_hexplane,
    write_octree,
    write_scaffold,
)
from gsgen.reference_plugins.writing.run_files import write_columns
from support.commands import shared


def cfg(folder: Path, text: str) -> Path:
    (folder / "cfg_args").write_text(text)
    return folder


def change(path: Path, edit: Callable[[dict], object]) -> None:
    state = torch.load(path, weights_only=True)
    edit(state)
    torch.save(state, path)


class Evil:
    def __reduce__(self) -> tuple:
        return (eval, ("__import__('pathlib').Path('ran').write_text('x')",))


def test_networks_that_no_method_has_are_named(tmp_path: Path) -> None:
    run = write_scaffold(tmp_path, AnchorOptions(anchors=4, is_single_file=True))
    (united_options,) = run.rglob("checkpoints.pth")
    change(united_options, lambda nets: nets.update(vi_mlp=nets["cov_mlp"]))
    read_anchors(run)
    change(united_options, lambda nets: nets.update(mystery=nets["cov_mlp"]))
    with pytest.raises(CheckpointInvalid, match=r"unexpected: mystery; expected only"):
        read_anchors(run)


# ===== folders


def test_the_last_iteration_is_taken_and_coarse_ones_are_not(tmp_path: Path) -> None:
    for name in ("iteration_7000", "iteration_30000", "coarse_iteration_90000", "x"):
        (tmp_path / "point_cloud" / name).mkdir(parents=True)
    assert find_iteration(tmp_path)[0] == 30000
    assert find_iteration(tmp_path, 7000)[1].name == "iteration_7000"
    with pytest.raises(NotInCheckpoint) as caught:
        find_iteration(tmp_path, 8)
    assert caught.value.hint == "There are: 7000, 30000."


def test_folders_a_little_off_name_the_right_one(tmp_path: Path) -> None:
    runs = [tmp_path / "scene" / name for name in ("a", "b", "c", "d")]
    for run in runs:
        (run / "point_cloud" / "iteration_5").mkdir(parents=True)
    (tmp_path / "scene" / "other").mkdir()
    candidates = f"{runs[0]} or {runs[1]} or {runs[2]}"
    wrong = {
        tmp_path: f"Did you mean {candidates}? (1 more look right.)",
        tmp_path
        / "scene"
        / "other": "Give the folder that training wrote: the one with cfg_args in it.",
    }
    for folder, hint in wrong.items():
        with pytest.raises(CheckpointInvalid) as caught:
            find_iteration(folder)
        assert (caught.value.hint, caught.value.exit_code) == (hint, 4)


@pytest.mark.parametrize("write", [write_octree, write_hexplane, write_deformable])
def test_file_inside_a_run_selects_the_run(
    write: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = write(tmp_path / "run")
    read = {
        write_octree: lambda *arguments: read_anchors(*arguments, octree=True),
        write_hexplane: read_hexplanes,
        write_deformable: read_deformation,
    }[write]
    (last,) = (run / "point_cloud").glob("iteration_*")
    number = int(last.name.partition("_")[2])
    shutil.copytree(last, run / "point_cloud/iteration_7")
    if write is write_deformable:
        shutil.copytree(run / f"deform/{last.name}", run / "deform/iteration_7")
    monkeypatch.chdir(run / "point_cloud")
    parts = {
        run / "cfg_args": number,
        Path(): number,
        run / "point_cloud/iteration_7": 7,
        run / "point_cloud/iteration_7/point_cloud.ply": 7,
        next(last.glob("*.p*")): number,
    }
    parts |= {run / "deform/iteration_7/deform.pth": 7} if (run / "deform").is_dir() else {}
    for path, expected_path in parts.items():
        checkpoint = read(path)
        assert (checkpoint.run.iteration, checkpoint.run.folder.resolve()) == (expected_path, run)
    assert read(Path(), 7).run.iteration == 7
    with pytest.raises(NotInCheckpoint, match=rf"is iteration 7, not {number}"):
        read(run / "point_cloud/iteration_7", number)
    with pytest.raises(CheckpointInvalid, match="does not exist"):
        read(run / "nowhere")
    (run / "notes.txt").write_text("")
    with pytest.raises(CheckpointInvalid, match="is not a folder"):
        read(run / "notes.txt")


def test_minus_one_is_the_last_iteration(tmp_path: Path) -> None:
    """As ``--iteration -1`` is for the published loaders."""
    run = write_deformable(tmp_path / "run")
    assert read_deformation(run, -1).run.iteration == 40000
    folder = run / "point_cloud/iteration_40000"
    assert read_deformation(folder, -1).run.iteration == 40000


def test_a_file_of_another_iteration_is_pointed_at(tmp_path: Path) -> None:
    run = write_deformable(tmp_path)
    (run / "deform/iteration_40000").rename(run / "deform/iteration_30000")
    with pytest.raises(CheckpointInvalid, match="is missing: the deformation") as caught:
        read_deformation(run)
    assert caught.value.hint == "There is one of iteration 30000."


def test_an_iteration_by_itself_will_do(tmp_path: Path) -> None:
    run = write_octree(tmp_path / "run", AnchorOptions(anchors=5, iteration=40000))
    expected = octree_gs_plugin.build(run)
    for name, number in (("iteration_40000", 40000), ("moved", 0)):
        shutil.copytree(run / "point_cloud/iteration_40000", tmp_path / name)
        with pytest.raises(CheckpointInvalid, match="cfg_args"):  # it says which levels are seen
            read_anchors(tmp_path / name, octree=True)
        shutil.copy(run / "cfg_args", tmp_path / name)
        assert read_anchors(tmp_path / name, octree=True).run.iteration == number
        generator = octree_gs_plugin.build(tmp_path / name)
        assert generator.producer == expected.producer
        with pytest.raises(NotInCheckpoint, match="alone, not 5"):
            read_anchors(tmp_path / name, 5, octree=True)


def test_a_folder_above_those_of_networks_names_the_outermost(tmp_path: Path) -> None:
    for name in ("run/unet", "run/vae"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "config.json").write_text("{}")
    with pytest.raises(CheckpointInvalid) as caught:
        read_model_config(tmp_path)
    assert caught.value.hint == f"Did you mean {tmp_path / 'run'}?"


# ===== tensors


def test_a_script_archive_is_read_as_torch_reads_it(tmp_path: Path) -> None:
    path = shared("data/checkpoints/scaffold_a/ckpt/point_cloud/iteration_30000/cov_mlp.pt")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        expected = torch.jit.load(path, map_location="cpu").state_dict()
    read = read_script_state(path)
    assert list(read) == list(expected)
    for name in expected:
        assert torch.equal(read[name], expected[name])


def test_networks_in_one_file_or_in_many_are_the_same(tmp_path: Path) -> None:
    options = AnchorOptions(anchors=4, has_feature_bank=True, cameras=3, appearance=2)
    many_files = read_anchors(write_scaffold(tmp_path / "many", options)).nets
    united_options = AnchorOptions(
        anchors=4, has_feature_bank=True, cameras=3, appearance=2, is_single_file=True
    )
    first = read_anchors(write_scaffold(tmp_path / "one", united_options)).nets
    assert many_files.feature_bank is not None
    assert first.feature_bank is not None
    assert torch.equal(many_files.feature_bank.hidden, first.feature_bank.hidden)
    assert torch.equal(many_files.color.out, first.color.out)
    assert torch.equal(many_files.embedding, first.embedding)  # type: ignore[arg-type]


def _as_first(nets: dict, folder: Path) -> None:
    nets["mlp_feature_bank"] = nets.pop("feature_bank_mlp")
    torch.save(nets, folder / "checkpoint.pth")


def _one_by_one(nets: dict, folder: Path) -> None:
    for name, state in nets.items():
        file = {"appearance": "embedding_appearance"}.get(name, name)
        torch.save(state, folder / f"{file}.pt", _use_new_zipfile_serialization="o" in name)


def _wrapped(nets: dict, folder: Path) -> None:
    for prefix in ("_orig_mod.", "module."):
        nets = {n: {prefix + k: v for k, v in s.items()} for n, s in nets.items()}
    torch.save(nets, folder / "checkpoints.pth")


def _of_other_kinds(nets: dict, folder: Path) -> None:
    """Doubles, parameters that want gradients, and tensors that are not contiguous."""
    for state in nets.values():
        for name, value in state.items():
            strided = torch.stack([value.double()] * 2, dim=-1)[..., 0]
            state[name] = torch.nn.Parameter(strided)
    torch.save(nets, folder / "checkpoints.pth")


@pytest.mark.parametrize("save", [_as_first, _one_by_one, _wrapped, _of_other_kinds])
def test_networks_are_read_however_they_were_saved(save: Callable, tmp_path: Path) -> None:
    first = save is _as_first  # which knew no appearances, and always the distance
    options = AnchorOptions(
        anchors=4, has_feature_bank=True, distance=(True, True, True), cameras=0 if first else 3,
        appearance=0 if first else 2, is_single_file=True,
    )  # fmt: skip
    expected = read_anchors(write_scaffold(tmp_path, options)).nets
    if first:
        cfg(tmp_path, "Namespace(feat_dim=16, n_offsets=5, use_feat_bank=True, lod=0)")
        expected = read_anchors(tmp_path).nets
    (united_options,) = tmp_path.rglob("checkpoints.pth")
    nets = torch.load(united_options, weights_only=True)
    united_options.unlink()
    save(nets, united_options.parent)
    actual = read_anchors(tmp_path).nets
    assert expected.color.distance
    for net in ("opacity", "covariance", "color", "feature_bank"):
        for layer in ("hidden", "hidden_bias", "out", "out_bias", "distance"):
            a, b = (getattr(getattr(networks, net), layer) for networks in (actual, expected))
            assert a == b if layer == "distance" else torch.equal(a, b)
    if not first:
        assert torch.equal(actual.embedding, expected.embedding)  # type: ignore[arg-type]


def _archive(path: Path, payload: bytes) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("net/data.pkl", payload)
    return path


def test_code_in_a_script_archive_is_not_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = _archive(tmp_path / "a.pt", pickle.dumps(Evil(), 2))
    with pytest.raises(CheckpointInvalid, match="which is not a tensor"):
        read_script_state(path)
    assert not (tmp_path / "ran").exists()


def test_modules_that_share_modules_are_refused(tmp_path: Path) -> None:
    """A chain of forty modules that holds each twice has a trillion names."""
    module = b"c__torch__.M\nM\n)\x81"
    inner = module + b"}b"
    for index in range(40):
        name = b"X\x01\0\0\0"
        put_opcode, get = b"q" + bytes([index]), b"h" + bytes([index])
        inner += put_opcode + module + b"}(" + name + b"a" + get + name + b"b" + get + b"ub"
    with pytest.raises(CheckpointInvalid, match="part of two others"):
        read_script_state(_archive(tmp_path / "a.pt", b"\x80\x02" + inner + b"."))


def test_a_damaged_script_archive_says_so(tmp_path: Path) -> None:
    (tmp_path / "a.pt").write_bytes(b"not a zip")
    with pytest.raises(CheckpointInvalid, match="cannot be read"):
        read_script_state(tmp_path / "a.pt")


def test_code_in_a_state_dict_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_hexplane(tmp_path)
    path = tmp_path / "point_cloud/iteration_30000/deformation.pth"
    torch.save({"x": Evil()}, path)
    with pytest.raises(CheckpointInvalid, match="cannot be read"):
        read_hexplanes(tmp_path)
    assert not (tmp_path / "ran").exists()


NET = "deformation_net."


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda s: s.pop(NET + "pos_deform.3.bias"), r"missing: deformation_net.pos_deform.3.bias"),
        (lambda s: s.update(surprise=torch.ones(1)), "unexpected: surprise"),
        (
            lambda s: s.update({NET + "pos_deform.1.weight": torch.ones(16, 15)}),
            r"pos_deform.1.weight is \[16, 15\], expected \[16, 16\]",
        ),
        (lambda s: s[NET + "grid.aabb"].fill_(float("nan")), "grid.aabb holds NaN or infinity"),
        (lambda s: s.update({NET + "pos_deform.1.bias": "no"}), "is a str, expected a tensor"),
        (
            lambda s: s.update({NET + "grid.grids.1.4": torch.ones(1, 4, 7, 16)}),
            r"grids.1.4 is \(7, 16\), expected \(6, 16\)",
        ),
        (lambda s: s.pop(NET + "feature_out.0.weight"), "0 layers behind them"),
        (lambda s: s[NET + "grid.aabb"].fill_(1.0), "expected a box with a volume"),
    ],
)
def test_tensors_that_do_not_fit_are_named(edit: Callable, words: str, tmp_path: Path) -> None:
    write_hexplane(tmp_path)
    change(tmp_path / "point_cloud/iteration_30000/deformation.pth", edit)
    with pytest.raises(CheckpointInvalid, match=words):
        read_hexplanes(tmp_path)


def test_a_head_that_is_off_may_be_missing(tmp_path: Path) -> None:
    write_hexplane(tmp_path)
    path = tmp_path / "point_cloud/iteration_30000/deformation.pth"
    change(path, lambda s: [s.pop(k) for k in list(s) if "shs_deform" in k])
    assert "shs" not in read_hexplanes(tmp_path).nets.heads


# ===== methods


def test_columns_go_by_their_number_not_by_their_place(tmp_path: Path) -> None:
    options = AnchorOptions(anchors=6, per_anchor=7, is_single_file=True)
    expected = read_anchors(write_scaffold(tmp_path, options)).cloud
    ply = tmp_path / "point_cloud/iteration_30000/point_cloud.ply"
    names = ply_properties(ply)
    table = read_ply_columns(ply, {"all": names})["all"]
    write_columns(ply, {n: table[:, i] for i, n in sorted(enumerate(names), key=lambda p: p[1])})
    assert ply_properties(ply) == tuple(sorted(names))
    actual = read_anchors(tmp_path).cloud
    assert torch.equal(actual.offset, expected.offset)
    assert torch.equal(actual.feature, expected.feature)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("n_offsets=9", "n_offsets is 9, but point_cloud.ply has 5"),
        ("feat_dim=99", "feat_dim is 99, but point_cloud.ply has 16"),
        ("appearance_dim=4", "appearance_dim is 4"),
        ("use_feat_bank=True", "use_feat_bank is True"),
        ("add_cov_dist=True", r"0.weight is \[16, 19\], expected \[16, 20\]"),
        ("appearance_dim='many'", "appearance_dim is 'many', expected a whole number"),
    ],
)
def test_options_of_another_run_are_noticed(text: str, words: str, tmp_path: Path) -> None:
    write_scaffold(tmp_path, AnchorOptions(anchors=3, is_single_file=True))
    with pytest.raises(CheckpointInvalid, match=words):
        read_anchors(cfg(tmp_path, f"Namespace({text})"))


def test_without_options_inputs_are_inferred_from_networks(tmp_path: Path) -> None:
    options = AnchorOptions(
        anchors=3,
        has_feature_bank=True,
        distance=(True, False, True),
        cameras=2,
        appearance=3,
        is_single_file=True,
    )
    write_scaffold(tmp_path, options)
    (tmp_path / "cfg_args").unlink()
    nets = read_anchors(tmp_path).nets
    heads = (nets.opacity, nets.covariance, nets.color)
    assert tuple(head.distance for head in heads) == options.distance
    assert nets.feature_bank is not None


@pytest.mark.parametrize("flag", ["no_grid", "all off"])
def test_unsupported_or_static_variant_is_refused(flag: str, tmp_path: Path) -> None:
    off = dict.fromkeys(("no_dx", "no_ds", "no_dr", "no_do", "no_dshs"), True)
    options = {"no_grid": True} if flag == "no_grid" else off
    write_hexplane(tmp_path, HexPlaneOptions(flags=options))
    with pytest.raises(CheckpointInvalid, match=r"no_grid is True|nothing moves"):
        read_hexplanes(tmp_path)


def test_a_deformation_has_to_agree_with_its_options(tmp_path: Path) -> None:
    write_deformable(tmp_path, blender=False)
    with pytest.raises(CheckpointInvalid, match="is_blender is True, but the network"):
        read_deformation(cfg(tmp_path, "Namespace(is_blender=True, is_6dof=False)"))
    (tmp_path / "cfg_args").unlink()
    assert read_deformation(tmp_path).net.time is None


@pytest.mark.parametrize("missing", ["point_cloud.ply", "opacity_mlp.pt"])
def test_a_missing_file_is_named(missing: str, tmp_path: Path) -> None:
    case = shared("data/checkpoints/scaffold_a/ckpt/point_cloud/iteration_30000")
    folder = tmp_path / "point_cloud" / "iteration_1"
    folder.mkdir(parents=True)
    for file in case.iterdir():
        if file.name != missing:
            (folder / file.name).write_bytes(file.read_bytes())
    with pytest.raises(CheckpointInvalid, match="is missing") as caught:
        read_anchors(tmp_path)
    assert caught.value.where.endswith(missing)


def test_a_value_that_is_no_number_is_found(tmp_path: Path) -> None:
    write_scaffold(tmp_path, AnchorOptions(anchors=3, is_single_file=True))
    ply = tmp_path / "point_cloud/iteration_30000/point_cloud.ply"
    data = bytearray(ply.read_bytes())
    data[-4:] = np.float32(np.nan).tobytes()
    ply.write_bytes(data)
    with pytest.raises(CheckpointInvalid, match=r"property rot_3.*row 2 is nan"):
        read_anchors(tmp_path)


def test_offsets_are_stored_axis_by_axis(tmp_path: Path) -> None:
    options = AnchorOptions(anchors=4, per_anchor=3, is_single_file=True)
    cloud = read_anchors(write_scaffold(tmp_path, options)).cloud
    ply = tmp_path / "point_cloud/iteration_30000/point_cloud.ply"
    for k in range(3):
        for axis in range(3):
            column = read_ply_columns(ply, {"one": (f"f_offset_{axis * 3 + k}",)})["one"]
            np.testing.assert_array_equal(cloud.offset[:, k, axis], column[:, 0])
