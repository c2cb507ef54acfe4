"""`duplex-gs` against the formulas of Duplex-GS in float64, and what its own code gave."""

from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.geometry import covariance_upper
from gsgen.contract.spec.manifest import CellsOutput
from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.spherical_harmonics import basis, degree_of
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins.anchors import duplex_gs_plugin
from gsgen.reference_plugins.anchors.anchor_checkpoint import Mlp
from gsgen.reference_plugins.anchors.cell_checkpoint import CellCheckpoint, read_cells
from gsgen.reference_plugins.anchors.duplex_gs import DuplexGS
from gsgen.reference_plugins.anchors.octree_gs import LEVEL_ROUNDING, Levels
from gsgen.reference_plugins.anchors.selection import Selection
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.synthetic import AnchorOptions, write_duplex
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.sources.source import GeneratorSource
from gsgen.sdk import export
from gsgen.sdk.authoring.packed_module import Packed, PackedGenerator
from gsgen.sdk.exporting.pipeline import Exported
from gsgen.sdk.float16.weight_tables import MIN_TABLE_ELEMENTS
from support.checkpoints.golden_duplex import BACKDROP, golden_view
from support.checkpoints.plugin_checks import (
    MARGIN,
    acceptance,
    assert_like,
    camera,
    eager,
    judge,
    stored,
    weights_of,
)
from support.checkpoints.plugin_oracles import ExpectedGaussians
from support.commands import shared
from support.models.captured import assert_captured

EXPECTED = {"xyz": 2e-5, "op": 2e-5, "cov": 5e-5, "col": 2e-5, "leak": 1 / 512}


def sigmoid(x: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-x))


def evaluate_mlp(net: Mlp, inputs: np.ndarray) -> np.ndarray:
    weights = (net.hidden, net.hidden_bias, net.out, net.out_bias)
    a, b, c, d = (weight.double().numpy() for weight in weights)
    return np.maximum(inputs @ a.T + b, 0) @ c.T + d


def oracle(read: CellCheckpoint, view: np.ndarray, *, weighted: bool) -> ExpectedGaussians:
    """Duplex-GS in float64: scales bounded by the cell, levels without the half cell."""
    cloud, nets, cfg = read.anchors.cloud, read.anchors.nets, read.anchors.run.cfg
    n, k = len(cloud), cloud.per_anchor
    matrix = view.astype(np.float64)
    centre = np.linalg.inv(matrix.T)[:3, 3]
    anchor, offset = cloud.position.double().numpy(), cloud.offset.double().numpy()
    v = anchor - centre
    d = np.linalg.norm(v, axis=1, keepdims=True)
    v = v / d
    level = cloud.level.double().numpy()
    level_of_distance = np.log(cloud.info[1].item() / d[:, 0]) / np.log(cfg.values["fork"])
    level_of_distance = level_of_distance + cloud.extra_level.double().numpy()
    top_level, fade = level.max() - level.min(), np.ones(n)
    if cfg.values["dist2level"] == "progressive":
        shifted = level_of_distance + 1
        clamped = shifted.clip(0.9999, top_level + 0.9999)
        whole = np.floor(clamped)
        fade = np.where(level == whole, clamped - whole, 1.0)
    else:
        shifted = level_of_distance + (0.5 if cfg.values["dist2level"] == "round" else 0)
        whole = {"round": np.round, "floor": np.floor, "ceil": np.ceil}[cfg.values["dist2level"]](
            level_of_distance
        ).clip(0, top_level)
    is_ambiguous = np.abs(shifted - shifted.round()) < 1e-4

    def head(net: Mlp) -> np.ndarray:
        parts = [cloud.feature.double().numpy(), v]
        parts += [d] if net.distance else []
        parts += [level[:, None]] if nets.level else []
        return evaluate_mlp(net, np.concatenate(parts, axis=1))

    size = np.exp(cloud.log_scale[:, :3].double().numpy())[:, None]
    position = anchor[:, None] + offset * size
    opacity = np.tanh(head(nets.opacity)) * fade[:, None]
    shape = head(nets.covariance).reshape(n, k, 7)
    bound = (2 - np.linalg.norm(offset, axis=2, keepdims=True)) / 3
    scale = size * np.minimum(sigmoid(shape[:, :, :3]), bound)
    if weighted:
        sh = read.visibility.double().numpy()
        opacity = opacity * sigmoid((basis(v, degree_of(sh.shape[1])) * sh).sum(axis=1))[:, None]
        if read.weighting.depth:
            depth = position @ matrix[:3, 2] + matrix[3, 2]
            opacity = opacity * (1 - depth / read.weighting.sigma).clip(0, 1)
    retained = ((opacity > 0) & (level <= whole)[:, None]).ravel()
    return ExpectedGaussians(
        retained,
        position.reshape(-1, 3)[retained],
        opacity.ravel()[retained],
        covariance_upper(scale.reshape(-1, 3)[retained], shape[:, :, 3:].reshape(-1, 4)[retained]),
        sigmoid(head(nets.color)).reshape(-1, 3)[retained],
        np.repeat(is_ambiguous, k),
    )


@pytest.mark.parametrize("mode", LEVEL_ROUNDING)
@pytest.mark.parametrize("seed", range(3))
def test_cells_are_decoded_as_the_method_does(seed: int, mode: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    options = AnchorOptions(
        anchors=40,
        per_anchor=int(rng.integers(1, 8)),
        width=4 * int(rng.integers(1, 6)),
        distance=tuple(bool(x) for x in rng.integers(0, 2, 3)),  # type: ignore[arg-type]
        level=bool(rng.integers(0, 2)),
        is_single_file=True,
        seed=seed,
    )
    settings = {"degree": int(rng.integers(0, 4)), "depth": bool(rng.integers(0, 2))}
    fork = int(rng.integers(2, 5))
    read = read_cells(write_duplex(tmp_path, options, mode=mode, fork=fork, **settings))  # type: ignore[arg-type]
    levels = Levels.of(read.anchors)
    hidden = 0
    for distance in (1.5, 6.0, 30.0):
        view = camera(rng, distance)
        for weighted in (False, True):
            opacity = "weighted" if weighted else "decoded"
            expected = oracle(read, view, weighted=weighted)
            hidden += int((~expected.retained).sum())
            if expected.retained.any():
                assert_like(*eager(DuplexGS(read, levels, opacity=opacity), view), expected)  # type: ignore[arg-type]
    assert hidden, "nothing was ever hidden, so levels were not tried"


def test_visibility_and_background_are_those_of_the_published_code() -> None:
    golden = np.load(shared("data/checkpoints/duplex_a/golden.npz"))
    read = read_cells(shared("data/checkpoints/duplex_a/ckpt"))
    weighting = read.weighting
    assert weighting.sigma == pytest.approx(golden["meta_sigma"][0])
    assert weighting.background == pytest.approx(golden["meta_wbg"][0])
    assert weighting.opacity_divisor == pytest.approx(golden["meta_ET"])
    assert weighting.depth == golden["meta_depth_correct"]
    generator = DuplexGS(read, Levels.of(read.anchors), opacity="weighted")
    for index in range(3):
        view = golden["in_world_view_transform"][index]
        rows, _ = eager(generator, view)
        visible = np.repeat(golden[f"out{index}_anchor_mask"], 5)
        depth = golden[f"out{index}_means3D"] @ view[:3, 2] + view[3, 2]
        expected = np.maximum(golden[f"out{index}_opacities"], 0) * golden[f"out{index}_vi"]
        expected = expected[:, 0] * (1 - depth / weighting.sigma).clip(0, 1)
        np.testing.assert_allclose(rows[visible, 3], expected, atol=1e-6)


# ===== Cells


def cell_oracle(read: CellCheckpoint, view: np.ndarray) -> np.ndarray:
    """The rows of cells in float64, without what levels hide.

    Visibility as in the published rasteriser's inputs, rotation as in ``generate_cells``: the mean
    of the Gaussians' quaternions, weighted by opacity times visibility.
    """
    cloud, nets = read.anchors.cloud, read.anchors.nets
    n, k = len(cloud), cloud.per_anchor
    centre = np.linalg.inv(view.astype(np.float64).T)[:3, 3]
    anchor = cloud.position.double().numpy()
    v = anchor - centre
    d = np.linalg.norm(v, axis=1, keepdims=True)
    sh = read.visibility.double().numpy()
    visibility = sigmoid((basis(v / d, degree_of(sh.shape[1])) * sh).sum(axis=1))

    def head(net: Mlp) -> np.ndarray:
        parts = [cloud.feature.double().numpy(), v / d]
        parts += [d] if net.distance else []
        parts += [cloud.level.double().numpy()[:, None]] if nets.level else []
        return evaluate_mlp(net, np.concatenate(parts, axis=1))

    weight = np.maximum(np.tanh(head(nets.opacity)), 0) * visibility[:, None]
    quaternion = head(nets.covariance).reshape(n, k, 7)[:, :, 3:]
    quaternion = quaternion / np.linalg.norm(quaternion, axis=2, keepdims=True)
    mean = (quaternion * weight[:, :, None]).mean(axis=1)
    mean[(weight == 0).all(axis=1)] = [1, 0, 0, 0]
    size = np.exp(cloud.log_scale[:, :3].double().numpy())
    cells = covariance_upper(size, mean)
    return np.concatenate([anchor, visibility[:, None], cells], axis=1)


@pytest.mark.parametrize("seed", range(3))
def test_cells_are_those_that_the_method_sums_by(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    options = AnchorOptions(
        anchors=40, per_anchor=int(rng.integers(1, 8)), is_single_file=True, seed=seed
    )
    read = read_cells(write_duplex(tmp_path, options, degree=seed + 1, depth=seed != 1))
    levels = Levels.of(read.anchors)
    generator = DuplexGS(read, levels, blend="wsr")
    weighting, declared_sum = read.weighting, generator.weighted_sum
    assert declared_sum is not None
    assert (declared_sum.background, declared_sum.opacity_divisor) == (
        weighting.background,
        weighting.opacity_divisor,
    )
    assert declared_sum.depth_range == (weighting.sigma if weighting.depth else None)
    for distance in (1.5, 6.0, 30.0):
        view = camera(rng, distance)
        expected = oracle(read, view, weighted=False)
        with torch.no_grad():
            outputs = generator(torch.from_numpy(view))
        cells = torch.cat(
            [outputs.cells.position, outputs.cells.visibility, outputs.cells.covariance], dim=1
        ).numpy()
        complete = cell_oracle(read, view)
        visible = generator.level_gate(torch.linalg.inv(torch.from_numpy(view))[3:, :3]).numpy() > 0
        complete[:, 3] *= visible[:, 0]
        np.testing.assert_allclose(cells, complete, rtol=2e-5, atol=2e-6)
        rows, colors = eager(generator, view)
        assert_like(rows, colors, expected)
        hidden = np.repeat(cells[:, 3] == 0, options.per_anchor)
        assert (rows[hidden, 3] == 0).all()


def test_opacities_are_not_weighed_twice(tmp_path: Path) -> None:
    read = read_cells(write_duplex(tmp_path, AnchorOptions(is_single_file=True)))
    with pytest.raises(GsgenError, match=r"(?s)--opacity weighted: .*weights opacities.*Leave"):
        DuplexGS(read, Levels.of(read.anchors), opacity="weighted", blend="wsr")


def test_decoding_a_subset_of_cells_agrees_with_all(tmp_path: Path) -> None:
    read = read_cells(write_duplex(tmp_path, AnchorOptions(anchors=30, is_single_file=True)))
    levels, view = Levels.of(read.anchors), camera(np.random.default_rng(0), 20.0)
    few_anchors = DuplexGS(read, levels, blend="wsr", selection=Selection("none", 29))
    all_cells = DuplexGS(read, levels, blend="wsr")
    with torch.no_grad():
        outputs, complete = few_anchors(torch.from_numpy(view)), all_cells(torch.from_numpy(view))
    live = int(outputs.count) // read.anchors.cloud.per_anchor
    retained = complete.cells.visibility.ravel() > 0
    assert 0 < live < 30
    for field in ("position", "visibility", "covariance"):
        limited, complete_cells = (getattr(result.cells, field) for result in (outputs, complete))
        torch.testing.assert_close(limited[:live], complete_cells[retained])
    packed = PackedGenerator(few_anchors, Packed(torch.float32, 29 * 5))
    with torch.no_grad():
        _, _, _, cells = packed(torch.from_numpy(view))
    assert (cells[:live, 3] > 0).all()
    assert (cells[live:, 3] == 0).all()


def test_max_cells_limits_the_decoded_cells(tmp_path: Path) -> None:
    read = read_cells(write_duplex(tmp_path, AnchorOptions(anchors=30, is_single_file=True)))
    levels, view = Levels.of(read.anchors), camera(np.random.default_rng(0), 20.0)
    settings = {"opacity": "weighted", "selection": Selection("none", 29)}
    few_anchors, all_cells = (
        DuplexGS(read, levels, **settings),
        DuplexGS(read, levels, opacity="weighted"),
    )  # type: ignore[arg-type]
    with torch.no_grad():
        outputs, complete = few_anchors(torch.from_numpy(view)), all_cells(torch.from_numpy(view))
    count = int(outputs.count)
    visible = (all_cells.level_gate(torch.linalg.inv(torch.from_numpy(view))[3:, :3]) > 0).ravel()
    retained = visible.repeat_interleave(read.anchors.cloud.per_anchor)
    assert 0 < count < len(complete.opacity)
    torch.testing.assert_close(outputs.opacity[:count], complete.opacity[retained])
    torch.testing.assert_close(outputs.covariance[:count], complete.covariance[retained])


# ===== Trouble


def test_options_of_another_run_are_refused(tmp_path: Path) -> None:
    folder = write_duplex(tmp_path, AnchorOptions(is_single_file=True), degree=2)
    cfg = folder / "cfg_args"
    cfg.write_text(cfg.read_text().replace("max_sh_degree=2", "max_sh_degree=3"))
    with pytest.raises(CheckpointInvalid, match=r"needs 15 .* has 8"):
        read_cells(folder)


@pytest.mark.parametrize("sigma", [0.0, -1.0, np.inf, np.nan])
def test_a_scene_without_sigma_is_refused(sigma: float, tmp_path: Path) -> None:
    folder = write_duplex(tmp_path, AnchorOptions(is_single_file=True), sigma=sigma)
    with pytest.raises(CheckpointInvalid, match="sigma"):
        read_cells(folder)


# ===== The published code, and the command


@pytest.fixture(scope="module")
def summed(tmp_path_factory: pytest.TempPathFactory) -> Exported:
    generator = duplex_gs_plugin.build(shared("data/checkpoints/duplex_a/ckpt"), blend="wsr")
    path = tmp_path_factory.mktemp("duplex") / "cells.onnx"
    return export(generator, path, target="webgpu", settings=Settings(level=Level.LIVE))


def golden_cells(outputs: np.ndarray, target: dict[str, np.ndarray], margin: float) -> None:
    """Compare packed cells with what the method's own code gave its rasteriser."""
    visible = target["cell_mask"]
    cells = outputs.astype(np.float64)
    assert np.isfinite(cells).all()
    assert (cells[~visible, 3] == 0).all()
    covariance = acceptance().kernel_cov6(target["cell_scale"], target["cell_rot"])
    for part, expected, allowed in (
        (slice(0, 3), target["cell_xyz"], 2e-5),
        (slice(3, 4), target["vi"], 2e-5),
        (slice(4, 10), covariance, 5e-5),
    ):
        error = np.abs(cells[visible, part] - expected).max() / np.abs(expected).max()
        assert error <= allowed * margin, (part, error)


def test_cells_agree_with_the_method_three_times_better_than_asked(summed: Exported) -> None:
    for agrees, errors in judge("duplex_a", summed.path):
        assert agrees
        for field, error in errors.items():
            assert error <= EXPECTED[field] / MARGIN, (field, error)
    session = onnxruntime.InferenceSession(summed.path, providers=["CPUExecutionProvider"])
    for feeds, target in acceptance().targets("duplex_a"):
        (cells,) = session.run(["cells"], {"camera": feeds["camera"]})
        golden_cells(cells, target, 1 / MARGIN)


def test_cells_in_half_precision_agree_as_well_as_asked() -> None:
    generator = duplex_gs_plugin.build(shared("data/checkpoints/duplex_a/ckpt"), blend="wsr")
    packed = PackedGenerator(generator, Packed(torch.float16, 251 * 5))
    for feeds, target in acceptance().targets("duplex_a"):
        with torch.no_grad():
            *_, cells = packed(torch.from_numpy(feeds["camera"]))
        assert cells.dtype == torch.float16
        golden_cells(cells.numpy(), target, 1.5e-3 / 2e-5)


def test_cells_are_declared_with_their_weights(summed: Exported) -> None:
    golden = np.load(shared("data/checkpoints/duplex_a/golden.npz"))
    declared = summed.manifest
    assert declared.blend == "wsr"
    assert declared.outputs.cells == CellsOutput("cells", 5, "float32")
    declared_sum = declared.weighted_sum
    assert declared_sum is not None
    assert declared_sum.depth_range == pytest.approx(golden["meta_sigma"][0])
    assert declared_sum.background == pytest.approx(golden["meta_wbg"][0])
    assert declared_sum.opacity_divisor == pytest.approx(golden["meta_ET"])


@pytest.mark.parametrize("number", [0, 1])
def test_the_model_is_drawn_as_the_method_draws_it(
    summed: Exported, published: Renderer, number: int
) -> None:
    """From the checkpoint to the picture, over the background that it was made with."""
    view_camera, image = golden_view(number)
    source = GeneratorSource(summed.path)
    source.update(view_camera, {})
    scene = Scene([source.splats(None, None)])
    picture = published.render(scene, view_camera, background=BACKDROP)
    source.close()
    assert np.abs(picture.rgba[..., :3] - image).max() <= 5e-5


@pytest.fixture(scope="module")
def published() -> Renderer:
    return Renderer(rasteriser="tiles", published=True)


def test_cells_run_in_webgpu_and_no_replay_is_stale(summed: Exported) -> None:
    assert_captured(summed.report)


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Exported:
    generator = duplex_gs_plugin.build(shared("data/checkpoints/duplex_a/ckpt"))
    path = tmp_path_factory.mktemp("duplex") / "duplex.onnx"
    return export(generator, path, target="webgpu", settings=Settings(level=Level.LIVE))


def test_the_model_agrees_with_the_method_three_times_better_than_asked(exported: Exported) -> None:
    for agrees, errors in judge("duplex_a", exported.path):
        assert agrees
        for field, error in errors.items():
            assert error <= EXPECTED[field] / MARGIN, (field, error)


def test_half_precision_halves_the_weights_and_agrees_as_well_as_asked(
    exported: Exported, tmp_path: Path
) -> None:
    generator = duplex_gs_plugin.build(shared("data/checkpoints/duplex_a/ckpt"))
    settings, path = Settings(level=Level.STATIC), tmp_path / "half.onnx"
    half = export(generator, path, dtype="float16", target="webgpu", settings=settings)
    assert all(agrees for agrees, _ in judge("duplex_a", path))
    assert half.float16_result is not None
    retained = weights_of(path, {weight.node for weight in half.float16_result.retained_weights})
    assert all(size < 4 * MIN_TABLE_ELEMENTS for size in retained)  # all large tables are halved
    integers = 1000  # bytes of sizes and indices
    assert stored(path) - sum(retained) <= 0.5 * (stored(exported.path) - sum(retained)) + integers


def test_model_runs_in_webgpu_without_stale_replays(exported: Exported) -> None:
    assert_captured(exported.report)


def test_export_prints_method_and_blending(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_duplex(tmp_path, AnchorOptions(anchors=9, iteration=40000))
    generator = duplex_gs_plugin.build(folder, opacity="weighted", cull="frustum", max_anchors=5)
    message = capsys.readouterr().err
    assert "9 cells × 5 Gaussians" in message
    assert "visibility of degree 3" in message
    assert "needs sorted Gaussians. --blend wsr keeps the cells" in message
    assert generator.producer is not None
    assert [declared.role for declared in generator.inputs] == ["view", "projection"]
