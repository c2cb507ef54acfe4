"""Octree-AnyGS: neural, explicit and flat Gaussians, against the method in float64."""

from pathlib import Path

import numpy as np
import pytest

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins.anchors.octree_gs import LEVEL_ROUNDING
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.octree_anygs.anygs_checkpoint import read_anygs
from gsgen.reference_plugins.octree_anygs.octree_anygs_plugin import build
from gsgen.reference_plugins.static.static import StaticScene
from gsgen.reference_plugins.synthetic import AnchorOptions, write_anygs
from gsgen.sdk import GaussianGenerator, export
from plugins.octree_anygs.anygs_oracle import expected_gaussians
from support.checkpoints.plugin_checks import assert_like, camera, eager, run
from support.models.captured import assert_captured

DISTANCES = (1.5, 4.0, 12.0, 40.0)


def generator_of(folder: Path, **options: object) -> GaussianGenerator:
    generator = build(folder, **options)  # type: ignore[arg-type]
    assert isinstance(generator, GaussianGenerator)
    return generator


@pytest.mark.parametrize("mode", LEVEL_ROUNDING)
@pytest.mark.parametrize("base", ["scaffoldgs", "3dgs", "2dgs"])
def test_gaussians_of_every_level_are_those_of_the_method(
    base: str, mode: str, tmp_path: Path
) -> None:
    rng = np.random.default_rng([len(base), len(mode)])
    options = AnchorOptions(
        anchors=60, per_anchor=int(rng.integers(1, 6)), width=8, has_feature_bank=mode == "round",
        direction=0 if mode == "floor" else 3, seed=int(rng.integers(1000)),
    )  # fmt: skip
    folder = write_anygs(
        tmp_path, options, base=base, mode=mode, degree=int(rng.integers(0, 4)),
        fork=int(rng.integers(2, 5)), levels=int(rng.integers(2, 6)),
    )  # fmt: skip
    generator, hidden = generator_of(folder), 0
    for distance in DISTANCES:
        view = camera(rng, distance, 0.7)
        expected = expected_gaussians(folder, view)
        assert_like(*eager(generator, view), expected)
        hidden += int((~expected.retained).sum())
    assert hidden, "no distance hid any level, so nothing was tried"


def test_a_neural_model_without_levels_is_that_of_the_method(tmp_path: Path) -> None:
    options = AnchorOptions(anchors=20, width=8, cameras=3, appearance=4)
    folder = write_anygs(tmp_path, options, levels=0)
    rng = np.random.default_rng(0)
    view = camera(rng)
    rows, color = eager(generator_of(folder), view, np.array([2], np.int32))
    assert_like(rows, color, expected_gaussians(folder, view, 2))
    rows, color = eager(generator_of(folder, appearance_id=1), view)
    assert_like(rows, color, expected_gaussians(folder, view, 1))


@pytest.mark.parametrize("base", ["3dgs", "2dgs"])
def test_explicit_gaussians_without_levels_are_a_static_scene(base: str, tmp_path: Path) -> None:
    folder = write_anygs(tmp_path, base=base, levels=0, degree=1)
    scene = build(folder)
    assert isinstance(scene, StaticScene)
    packed = scene.pack("float32", "core")
    assert_like(
        packed.rows, packed.appearance, expected_gaussians(folder, camera(np.random.default_rng()))
    )


@pytest.mark.parametrize("base", ["scaffoldgs", "3dgs"])
def test_exported_models_are_captured_and_agree(base: str, tmp_path: Path) -> None:
    folder = write_anygs(tmp_path / "run", AnchorOptions(anchors=40), base=base, mode="progressive")
    exported = export(
        generator_of(folder), tmp_path / "out.onnx", target="webgpu",
        settings=Settings(level=Level.LIVE),
    )  # fmt: skip
    assert exported.report.verdict == "conforms"
    assert_captured(exported.report)
    view = camera(np.random.default_rng(4), 5.0)
    rows, color = run(exported.path, {"camera": view})[:2]
    assert_like(rows, color, expected_gaussians(folder, view))


def edit_cfg(folder: Path, before: str, after: str) -> None:
    path = folder / "cfg_args"
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after))


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("model_config", "configuration", "model_config is missing"),
        ("'feat_dim'", "'gs_attr': 'explicit3D', 'feat_dim'", "the layout of a later version"),
        ("'name': 'GaussianLoDModel'", "'name': 'Model'", "name is 'Model'"),
        ("base_model='scaffoldgs'", "base_model='4dgs'", "base_model is '4dgs'"),
        ("'view_dim': 3", "'view_dim': 2", "view_dim is 2, expected 0 or 3"),
        ("'fork': 2", "'fork': 1", "fork 1"),
        ("'dist2level': 'round'", "'dist2level': 'truncate'", "dist2level is 'truncate'"),
        ("'n_offsets': 5", "'n_offsets': 6", "n_offsets is 6"),
    ],
)
def test_a_wrong_option_is_named(before: str, after: str, message: str, tmp_path: Path) -> None:
    folder = write_anygs(tmp_path, AnchorOptions(anchors=4))
    edit_cfg(folder, before, after)
    with pytest.raises(CheckpointInvalid, match=message):
        read_anygs(folder)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        (b"obj_info levels", b"obj_info layers", "the header lacks `obj_info standard_dist"),
        (b"standard_dist 6.0", b"standard_dist -6.", "standard_dist is -6"),
        (b"standard_dist 6.0", b"standard_dist six", "the header lacks"),
    ],
)
def test_a_wrong_header_is_named(before: bytes, after: bytes, message: str, tmp_path: Path) -> None:
    folder = write_anygs(tmp_path, base="3dgs")
    (ply,) = folder.rglob("*.ply")
    ply.write_bytes(ply.read_bytes().replace(before, after))
    with pytest.raises(CheckpointInvalid, match=message):
        read_anygs(folder)


def test_options_of_networks_are_refused_for_explicit_gaussians(tmp_path: Path) -> None:
    folder = write_anygs(tmp_path, base="3dgs")
    with pytest.raises(GsgenError, match="is frustum, but explicit Gaussians"):
        build(folder, cull="frustum")
    with pytest.raises(GsgenError, match="is 5, but explicit Gaussians"):
        build(folder, max_anchors=5)
