"""Checkpoints of gsplat, splatfacto and 3DGS: what torch saved is what is read, without torch."""

import os
import pickle
import subprocess
import sys
import warnings
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import torch

from gsgen.formats import (
    ArchiveDamaged,
    FormatError,
    FormatNotRecognised,
    FormatWarning,
    NotSupported,
    PropertyMissing,
    SizeExceeded,
    Splats,
    ValueInvalid,
    open_splats,
    read_checkpoint,
)
from support.splat_files import FIELDS, checkpoints, scene, torch_saved

KINDS = ("gsplat", "nerfstudio", "inria")


def stored(file: Path, content: object) -> Path:
    file.write_bytes(torch_saved(content))
    return file


def of_gsplat(count: int = 6, degree: int = 1, **changes: object) -> dict[str, object]:
    splats = scene(count, degree)
    tensors = {
        "means": splats.position,
        "quats": splats.rotation,
        "scales": splats.log_scale,
        "opacities": splats.logit_opacity,
        "sh0": splats.sh[:, :1],
        "shN": splats.sh[:, 1:],
    }
    stored = {name: torch.from_numpy(array.copy()) for name, array in tensors.items()} | changes
    return {"step": 1, "splats": {k: v for k, v in stored.items() if v is not None}}


def refusal(file: Path, kind: type[FormatError]) -> str:
    with pytest.raises(FormatError) as caught:
        open_splats(file)
    assert type(caught.value) is kind
    assert caught.value.path == str(file)
    return str(caught.value)


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_the_values_saved_are_the_values_read(tmp_path, kind, degree):
    splats = scene(50, degree, seed=degree)
    file = tmp_path / "no_suffix"
    file.write_bytes(checkpoints(splats)[kind])
    restored = open_splats(file)
    assert isinstance(restored, Splats)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(restored, name), getattr(splats, name))
    assert not restored.antialiased


@pytest.mark.parametrize("kind", ["gsplat", "inria"])
def test_degree_0_has_no_higher_harmonics(tmp_path, kind):
    splats = scene(5, 0)
    (tmp_path / "a.pt").write_bytes(checkpoints(splats)[kind])
    np.testing.assert_array_equal(read_checkpoint(tmp_path / "a.pt").sh, splats.sh)


def test_splatfacto_of_degree_0_trains_colours_through_a_sigmoid(tmp_path):
    splats = scene(5, 0)
    (tmp_path / "a.ckpt").write_bytes(checkpoints(splats)["nerfstudio"])
    constant = read_checkpoint(tmp_path / "a.ckpt").sh[:, 0].astype(np.float64)
    shown = 0.5 + 0.28209479177387814 * constant
    expected = torch.sigmoid(torch.from_numpy(splats.sh[:, 0]).double()).numpy()
    np.testing.assert_allclose(shown, expected, atol=2e-7)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
def test_other_floats_become_float32(tmp_path, dtype):
    scales = torch.randn(6, 3, generator=torch.Generator().manual_seed(3)).to(dtype)
    file = stored(tmp_path / "a.pt", of_gsplat(scales=scales))
    np.testing.assert_array_equal(read_checkpoint(file).log_scale, scales.float().numpy())


def test_a_transposed_tensor_is_read_by_its_strides(tmp_path):
    means = torch.arange(18, dtype=torch.float32).reshape(3, 6).T
    file = stored(tmp_path / "a.pt", of_gsplat(means=means))
    np.testing.assert_array_equal(read_checkpoint(file).position, means.numpy())


def test_older_names_of_gsplat_and_splatfacto_are_read(tmp_path):
    gsplat = of_gsplat()["splats"]
    gsplat["means3d"] = gsplat.pop("means")
    splatfacto = dict(gsplat) | {"means": gsplat["means3d"]}
    splatfacto["features_dc"] = splatfacto.pop("sh0")[:, 0]
    splatfacto["features_rest"] = splatfacto.pop("shN")
    del splatfacto["means3d"]
    pipeline = {f"_model.{name}": value for name, value in splatfacto.items()}
    entry = read_checkpoint(stored(tmp_path / "a.pt", {"splats": gsplat}))
    other = read_checkpoint(stored(tmp_path / "a.ckpt", {"pipeline": pipeline}))
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(entry, name), getattr(other, name))


@pytest.mark.parametrize(
    ("kind", "folder", "settings", "line"),
    [
        ("gsplat", "ckpts", "cfg.yml", "antialiased: true"),
        ("nerfstudio", "nerfstudio_models", "config.yml", "    rasterize_mode: antialiased"),
    ],
)
def test_the_settings_beside_the_file_say_antialiased(tmp_path, kind, folder, settings, line):
    (tmp_path / folder).mkdir()
    file = tmp_path / folder / "a.pt"
    file.write_bytes(checkpoints(scene(4, 1))[kind])
    (tmp_path / settings).write_text(f"a: 1\n{line}\nb: 2\n")
    assert read_checkpoint(file).antialiased
    classic_config = line.replace("true", "false").replace(
        "antialiased", "classic", line.count("mode")
    )
    (tmp_path / settings).write_text(f"{classic_config}\n")
    assert not read_checkpoint(file).antialiased


def test_notes_say_what_has_no_effect(tmp_path):
    file = stored(tmp_path / "ckpt_9_rank0.pt", of_gsplat() | {"post_processing": {}})
    (tmp_path / "ckpt_9_rank1.pt").write_bytes(file.read_bytes())
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", FormatWarning)
        read_checkpoint(file)
    text = " ".join(str(warning.message) for warning in caught)
    assert "post_processing" in text
    assert "one of 2 files" in text


def test_colours_of_an_appearance_network_are_refused(tmp_path):
    colors = {"sh0": None, "shN": None, "features": torch.ones(6, 32), "colors": torch.ones(6, 3)}
    file = stored(tmp_path / "a.pt", of_gsplat(**colors) | {"app_module": {}})
    assert "appearance network (app_opt of gsplat)" in refusal(file, NotSupported)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"deformation_net.grid.aabb": torch.ones(2, 3)}, ("4DGaussians", "hexplane-4dgs")),
        ({"opacity_mlp": {}, "cov_mlp": {}}, ("Scaffold-GS", "scaffold-gs")),
        ({"gaussian_warp.weight": torch.ones(2)}, ("Deformable-3DGS", "deformable-3dgs")),
        (((3, torch.ones(2, 3), {"a": 1}), 7), ("4DGaussians", "hexplane-4dgs")),
        (((torch.ones(2, 3), torch.ones(2, 5, 3)), 7), ("Scaffold-GS", "scaffold-gs")),
        (((torch.ones(2, 3), torch.ones(2, 5)), 7), ("tuple (capture) has 2 values", "the 12 of")),
        ({"state_dict": {}, "epoch": 3}, ("state_dict, epoch", "gsplat (splats)")),
        ([1, 2], ("a list", "splatfacto")),
        (((3, 4, 5), 7), ("tuple (capture) has 3 values", "the 12 of 3DGS")),
        ({"pipeline": {"_model.field.weight": torch.ones(2)}}, ("nerfstudio", "splatfacto")),
    ],
)
def test_other_files_are_named_by_their_type(tmp_path, content, words):
    text = refusal(stored(tmp_path / "a.pth", content), NotSupported)
    assert all(word in text for word in words), text


def test_a_network_in_torchscript_is_called_that(tmp_path):
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"`torch.jit.script` is deprecated")
        torch.jit.script(torch.nn.Linear(2, 2)).save(str(tmp_path / "opacity_mlp.pt"))
    text = refusal(tmp_path / "opacity_mlp.pt", NotSupported)
    assert "TorchScript" in text
    assert "scaffold-gs" in text


@pytest.mark.parametrize(
    ("changes", "kind", "words"),
    [
        ({"sh0": None}, PropertyMissing, "lacks the tensors sh0"),
        ({"quats": torch.ones(6, 3)}, ValueInvalid, "quats: the tensor has shape [6, 3]"),
        ({"scales": torch.ones(6, 2)}, NotSupported, "2DGS"),
        ({"shN": torch.ones(6, 4, 3)}, ValueInvalid, "shN: the tensor has shape [6, 4, 3]"),
        (
            {"means": torch.ones(6, 3, dtype=torch.int64)},
            ValueInvalid,
            "means: the tensor holds no floats",
        ),
        ({"means": 3}, ValueInvalid, "means: the value is a int"),
        ({"means": torch.full((6, 3), torch.nan)}, ValueInvalid, "position[:, 0]"),
    ],
)
def test_wrong_tensors_are_refused_by_name(tmp_path, changes, kind, words):
    assert words in refusal(stored(tmp_path / "a.pt", of_gsplat(**changes)), kind)


def test_a_file_that_torch_did_not_write_is_refused(tmp_path):
    (tmp_path / "a.pt").write_bytes(pickle.dumps({"splats": 1}))
    assert "torch 1.6" in refusal(tmp_path / "a.pt", FormatNotRecognised)


class Bomb:
    def __reduce__(self):
        return os.mkdir, ("exploded",)


@pytest.mark.parametrize("location", ["beside", "inside"])
def test_code_in_a_checkpoint_is_not_run(tmp_path, monkeypatch, location):
    monkeypatch.chdir(tmp_path)
    content = of_gsplat() | {"x": Bomb()} if location == "beside" else of_gsplat(means=Bomb())
    file = stored(tmp_path / "a.pt", content)
    if location == "beside":
        assert len(read_checkpoint(file)) == 6
    else:
        assert "a Opaque" in refusal(file, ValueInvalid)
    assert not Path("exploded").exists()


def rewritten_archive(
    file: Path, changes: dict[str, bytes], method: int = zipfile.ZIP_STORED
) -> Path:
    """Replace members of an archive."""
    with zipfile.ZipFile(BytesIO(file.read_bytes())) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(name, changes.get(name.split("/", 1)[1], content))
    return file


def test_short_storage_and_compression_are_refused(tmp_path):
    file = stored(tmp_path / "a.pt", of_gsplat())
    assert "means" in refusal(rewritten_archive(file, {"data/0": b"\0" * 8}), ArchiveDamaged)
    packed = stored(tmp_path / "b.pt", of_gsplat(count=5000))
    assert "the file in the archive is compressed" in refusal(
        rewritten_archive(packed, {}, zipfile.ZIP_DEFLATED), NotSupported
    )


def test_an_expanded_tensor_does_not_take_more_memory_than_its_storage(tmp_path):
    means = torch.ones(1, 3).expand(1 << 30, 3)
    file = stored(tmp_path / "a.pt", {"splats": {"means": means}})
    refusal(file, PropertyMissing)
    expanded_checkpoint = of_gsplat(means=torch.ones(1, 3).expand(6, 3))
    assert "6, 3" in refusal(stored(tmp_path / "b.pt", expanded_checkpoint), ArchiveDamaged)


def test_a_pickle_beyond_the_limit_is_refused(tmp_path):
    file = stored(tmp_path / "a.pt", of_gsplat())
    refusal(rewritten_archive(file, {"data.pkl": bytes((16 << 20) + 1)}), SizeExceeded)


def test_big_endian_numbers_are_read(tmp_path):
    file = stored(tmp_path / "a.pt", of_gsplat())
    expected = read_checkpoint(file)
    with zipfile.ZipFile(file) as archive:
        swapped = {
            name.split("/", 1)[1]: np.frombuffer(archive.read(name), "<f4").astype(">f4").tobytes()
            for name in archive.namelist()
            if "/data/" in name
        }
    restored = read_checkpoint(rewritten_archive(file, swapped | {"byteorder": b"big"}))
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(restored, name), getattr(expected, name))


def test_reading_a_checkpoint_needs_no_torch(tmp_path):
    file = stored(tmp_path / "a.pt", of_gsplat())
    code = (
        "import sys; sys.modules['torch'] = None\n"
        f"from gsgen.formats import open_splats; print(len(open_splats({str(file)!r})))"
    )
    completed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert completed.stdout == "6\n"


WRAPPERS = {
    "bare state_dict": lambda tensors: tensors,
    "DDP names": lambda tensors: {"splats": {f"module.{k}": v for k, v in tensors.items()}},
    "bare DDP names": lambda tensors: {f"module.{k}": v for k, v in tensors.items()},
    "names below splats": lambda tensors: {f"splats.{k}": v for k, v in tensors.items()},
    "state_dict of a trainer": lambda tensors: {"epoch": 3, "state_dict": tensors},
    "model of a trainer": lambda tensors: {"model": {f"module.{k}": v for k, v in tensors.items()}},
}
NERF_WRAPPERS = {
    "DDP pipeline": lambda tensors: {
        "pipeline": {f"_model.module.gauss_params.{k}": v for k, v in tensors.items()}
    },
    "bare model": lambda tensors: {f"gauss_params.{k}": v for k, v in tensors.items()},
    "bare pipeline": lambda tensors: {f"_model.gauss_params.{k}": v for k, v in tensors.items()},
}


@pytest.mark.parametrize("wrapper", [*WRAPPERS, *NERF_WRAPPERS])
def test_wrapped_and_bare_state_dicts_are_read(tmp_path: Path, wrapper: str) -> None:
    splats = scene(12, 1)
    arrays = {
        "means": splats.position,
        "quats": splats.rotation,
        "scales": splats.log_scale,
        "opacities": splats.logit_opacity,
    }
    names = ("features_dc", "features_rest") if wrapper in NERF_WRAPPERS else ("sh0", "shN")
    arrays |= {names[0]: splats.sh[:, :1], names[1]: splats.sh[:, 1:]}
    tensors = {name: torch.from_numpy(array.copy()) for name, array in arrays.items()}
    content = (WRAPPERS | NERF_WRAPPERS)[wrapper](tensors)
    (tmp_path / "a.pt").write_bytes(torch_saved(content))
    restored = read_checkpoint(tmp_path / "a.pt")
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(restored, name), getattr(splats, name))
