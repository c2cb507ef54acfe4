"""`duplex-gs` against the formulas of Duplex-GS in float64, and what its own code gave."""

from pathlib import Path

import numpy as np
import pytest
import torch

from gsgen.contract.config import Settings
from gsgen.contract.finding import Level
from gsgen.contract.geometry import covariance_upper
from gsgen.contract.spherical_harmonics import basis, degree_of
from gsgen.reference_plugins.checkpoints.anchors import Mlp, read_anchors
from gsgen.reference_plugins.checkpoints.cells import CellCheckpoint, read_cells
from gsgen.reference_plugins.checkpoints.errors import CheckpointInvalid
from gsgen.reference_plugins.commands import duplex_gs
from gsgen.reference_plugins.duplex_gs import DuplexGS
from gsgen.reference_plugins.octree_gs import MODES, Levels
from gsgen.reference_plugins.selection import Selection
from gsgen.reference_plugins.synthetic import AnchorOptions, write_duplex, write_octree
from gsgen.sdk import export
from gsgen.sdk.exporter import Exported
from gsgen.sdk.packing import Packed, PackedGenerator
from support.captured import assert_captured
from support.commands import shared
from support.plugin_checks import MARGIN, acceptance, assert_like, camera, eager, judge
from support.plugin_oracles import Wanted

EXPECTED = {"xyz": 2e-5, "op": 2e-5, "cov": 5e-5, "col": 2e-5, "leak": 1 / 512}


def sigmoid(x: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-x))


def ask(net: Mlp, inputs: np.ndarray) -> np.ndarray:
    weights = (net.hidden, net.hidden_bias, net.out, net.out_bias)
    a, b, c, d = (one.double().numpy() for one in weights)
    return np.maximum(inputs @ a.T + b, 0) @ c.T + d


def oracle(read: CellCheckpoint, view: np.ndarray, *, weighted: bool) -> Wanted:
    """Duplex-GS in float64: scales bounded by the cell, levels without the half cell."""
    cloud, nets, cfg = read.anchors.cloud, read.anchors.nets, read.anchors.cfg
    n, k = len(cloud), cloud.per_anchor
    matrix = view.astype(np.float64)
    centre = np.linalg.inv(matrix.T)[:3, 3]
    anchor, offset = cloud.position.double().numpy(), cloud.offset.double().numpy()
    v = anchor - centre
    d = np.linalg.norm(v, axis=1, keepdims=True)
    v = v / d
    level = cloud.level.double().numpy()
    asked = np.log(cloud.info[1].item() / d[:, 0]) / np.log(cfg.values["fork"])
    asked = asked + cloud.extra_level.double().numpy()
    top, fade = level.max() - level.min(), np.ones(n)
    if cfg.values["dist2level"] == "progressive":
        shifted = asked + 1
        clamped = shifted.clip(0.9999, top + 0.9999)
        whole = np.floor(clamped)
        fade = np.where(level == whole, clamped - whole, 1.0)
    else:
        shifted = asked + (0.5 if cfg.values["dist2level"] == "round" else 0)
        whole = {"round": np.round, "floor": np.floor, "ceil": np.ceil}[
            cfg.values["dist2level"]
        ](asked).clip(0, top)
    doubtful = np.abs(shifted - shifted.round()) < 1e-4

    def head(net: Mlp) -> np.ndarray:
        parts = [cloud.feature.double().numpy(), v]
        parts += [d] if net.distance else []
        parts += [level[:, None]] if nets.level else []
        return ask(net, np.concatenate(parts, axis=1))

    size = np.exp(cloud.log_scale[:, :3].double().numpy())[:, None]
    position = anchor[:, None] + offset * size
    opacity = np.tanh(head(nets.opacity)) * fade[:, None]
    shape = head(nets.covariance).reshape(n, k, 7)
    bound = (2 - np.linalg.norm(offset, axis=2, keepdims=True)) / 3
    scale = size * np.minimum(sigmoid(shape[:, :, :3]), bound)
    if weighted:
        sh = read.visibility.double().numpy()
        opacity = (
            opacity * sigmoid((basis(v, degree_of(sh.shape[1])) * sh).sum(axis=1))[:, None]
        )
        if read.weighting.depth:
            depth = position @ matrix[:3, 2] + matrix[3, 2]
            opacity = opacity * (1 - depth / read.weighting.sigma).clip(0, 1)
    kept = ((opacity > 0) & (level <= whole)[:, None]).ravel()
    return Wanted(
        kept,
        position.reshape(-1, 3)[kept],
        opacity.ravel()[kept],
        covariance_upper(scale.reshape(-1, 3)[kept], shape[:, :, 3:].reshape(-1, 4)[kept]),
        sigmoid(head(nets.color)).reshape(-1, 3)[kept],
        np.repeat(doubtful, k),
    )


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("seed", range(3))
def test_cells_are_decoded_as_the_method_does(seed: int, mode: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    options = AnchorOptions(
        anchors=40,
        per_anchor=int(rng.integers(1, 8)),
        width=4 * int(rng.integers(1, 6)),
        distance=tuple(bool(x) for x in rng.integers(0, 2, 3)),  # type: ignore[arg-type]
        level=bool(rng.integers(0, 2)),
        united=True,
        seed=seed,
    )
    chosen = {"degree": int(rng.integers(0, 4)), "depth": bool(rng.integers(0, 2))}
    fork = int(rng.integers(2, 5))
    read = read_cells(write_duplex(tmp_path, options, mode=mode, fork=fork, **chosen))  # type: ignore[arg-type]
    levels = Levels.of(read.anchors)
    hidden = 0
    for distance in (1.5, 6.0, 30.0):
        view = camera(rng, distance)
        for weighted in (False, True):
            opacity = "weighted" if weighted else "decoded"
            wanted = oracle(read, view, weighted=weighted)
            hidden += int((~wanted.kept).sum())
            if wanted.kept.any():
                assert_like(*eager(DuplexGS(read, levels, opacity=opacity), view), wanted)  # type: ignore[arg-type]
    assert hidden, "nothing was ever hidden, so levels were not tried"


def test_visibility_and_background_are_those_of_the_published_code() -> None:
    golden = np.load(shared("data/checkpoints/duplex_a/golden.npz"))
    read = read_cells(shared("data/checkpoints/duplex_a/ckpt"))
    how = read.weighting
    assert how.sigma == pytest.approx(golden["meta_sigma"][0])
    assert how.background == pytest.approx(golden["meta_wbg"][0])
    assert how.grade == pytest.approx(golden["meta_ET"])
    assert how.depth == golden["meta_depth_correct"]
    generator = DuplexGS(read, Levels.of(read.anchors), opacity="weighted")
    for index in range(3):
        view = golden["in_world_view_transform"][index]
        rows, _ = eager(generator, view)
        there = np.repeat(golden[f"out{index}_anchor_mask"], 5)
        depth = golden[f"out{index}_means3D"] @ view[:3, 2] + view[3, 2]
        wanted = np.maximum(golden[f"out{index}_opacities"], 0) * golden[f"out{index}_vi"]
        wanted = wanted[:, 0] * (1 - depth / how.sigma).clip(0, 1)
        np.testing.assert_allclose(rows[there, 3], wanted, atol=1e-6)


def test_only_so_many_cells_are_decoded_where_asked(tmp_path: Path) -> None:
    read = read_cells(write_duplex(tmp_path, AnchorOptions(anchors=30, united=True)))
    levels, view = Levels.of(read.anchors), camera(np.random.default_rng(0), 20.0)
    chosen = {"opacity": "weighted", "selection": Selection("none", 29)}
    few, all_ = DuplexGS(read, levels, **chosen), DuplexGS(read, levels, opacity="weighted")  # type: ignore[arg-type]
    with torch.no_grad():
        made, every = few(torch.from_numpy(view)), all_(torch.from_numpy(view))
    count = int(made.count)
    shown = (all_.gate(torch.linalg.inv(torch.from_numpy(view))[3:, :3]) > 0).ravel()
    kept = shown.repeat_interleave(read.anchors.cloud.per_anchor)
    assert 0 < count < len(every.opacity)
    torch.testing.assert_close(made.opacity[:count], every.opacity[kept])
    torch.testing.assert_close(made.covariance[:count], every.covariance[kept])


# ===== Trouble


def test_checkpoints_of_relatives_are_refused_by_name(tmp_path: Path) -> None:
    octree = write_octree(tmp_path / "octree", AnchorOptions(united=True))
    with pytest.raises(CheckpointInvalid, match=r"(?s)no cells.*gsgen export octree-gs"):
        read_cells(octree)
    duplex = write_duplex(tmp_path / "duplex", AnchorOptions(united=True))
    with pytest.raises(CheckpointInvalid, match="gsgen export duplex-gs"):
        read_anchors(duplex, octree=True)


def test_options_of_another_run_are_refused(tmp_path: Path) -> None:
    folder = write_duplex(tmp_path, AnchorOptions(united=True), degree=2)
    cfg = folder / "cfg_args"
    cfg.write_text(cfg.read_text().replace("max_sh_degree=2", "max_sh_degree=3"))
    with pytest.raises(CheckpointInvalid, match=r"takes 15 .* has 8"):
        read_cells(folder)


def test_a_scene_without_sigma_is_refused(tmp_path: Path) -> None:
    folder = write_duplex(tmp_path, AnchorOptions(united=True), sigma=0.0)
    with pytest.raises(CheckpointInvalid, match="sigma"):
        read_cells(folder)


# ===== The published code, and the command


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Exported:
    generator = duplex_gs.build(shared("data/checkpoints/duplex_a/ckpt"))
    path = tmp_path_factory.mktemp("duplex") / "duplex.onnx"
    return export(generator, path, target="webgpu", settings=Settings(level=Level.LIVE))


def test_the_model_agrees_with_the_method_three_times_better_than_asked(
    made: Exported,
) -> None:
    for agrees, errors in judge("duplex_a", made.path):
        assert agrees
        for field, error in errors.items():
            assert error <= EXPECTED[field] / MARGIN, (field, error)


def test_half_precision_agrees_as_well_as_asked() -> None:
    tool = acceptance()
    generator = duplex_gs.build(shared("data/checkpoints/duplex_a/ckpt"))
    packed = PackedGenerator(generator, Packed(torch.float16, 251 * 5))
    for index, (feeds, target) in enumerate(tool.targets("duplex_a")):
        with torch.no_grad():
            rows, color, _ = packed(torch.from_numpy(feeds["camera"]))
        agrees, errors = tool.check(
            "duplex_a", index, rows.numpy(), color.numpy(), "f16", target
        )
        assert agrees, errors


def test_it_runs_in_webgpu_and_no_replay_is_stale(made: Exported) -> None:
    assert_captured(made.report)


def test_a_user_is_told_what_was_found_and_how_it_will_be_blended(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_duplex(tmp_path, AnchorOptions(anchors=9, iteration=40000))
    made = duplex_gs.build(folder, opacity="weighted", cull="frustum", max_anchors=5)
    told = capsys.readouterr().err
    assert "9 cells × 5 Gaussians" in told
    assert "visibility of degree 3" in told
    assert "blended by sorting" in told
    assert made.producer is not None
    assert [one.role for one in made.inputs] == ["view", "projection"]
