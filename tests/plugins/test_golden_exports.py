"""Models that `gsgen export` writes, against what the methods' own code gave."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import onnx
import pytest
from typer.testing import CliRunner

from gsgen.cli.command_group import build
from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.reference_plugins.anchors import octree_gs_plugin, scaffold_gs_plugin
from gsgen.reference_plugins.deformation import (
    deformable_3dgs_plugin,
    hexplane_4dgs_plugin,
    sc_gs_plugin,
)
from gsgen.reference_plugins.heads import gaussian_avatars_plugin
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.spacetime import rotor_4dgs_plugin, spacetime_gaussians_plugin
from gsgen.reference_plugins.synthetic import (
    AnchorOptions,
    HexPlaneOptions,
    write_hexplane,
    write_octree,
    write_scaffold,
)
from gsgen.sdk import GaussianGenerator, export
from gsgen.sdk.exporting.pipeline import Exported
from gsgen.sdk.float16.weight_tables import MIN_TABLE_ELEMENTS
from support.checkpoints.plugin_checks import assert_margin, stored, weights_of
from support.commands import gsgen_here, shared
from support.models.captured import assert_captured

BUILD: dict[str, Callable[..., GaussianGenerator]] = {
    "scaffold_a": scaffold_gs_plugin.build,
    "octree_a": octree_gs_plugin.build,
    "hexplane_dnerf": hexplane_4dgs_plugin.build,
    "deform_blender": deformable_3dgs_plugin.build,
    "scgs_blender": sc_gs_plugin.build,
    "gavatars_teeth": gaussian_avatars_plugin.build,
    "rotor4d_dnerf": partial(rotor_4dgs_plugin.build, time_duration=(0.0, 1.0)),
    "stg_lite": spacetime_gaussians_plugin.build,
    "stg_full": partial(spacetime_gaussians_plugin.build, decode="per-splat"),
}


@dataclass(frozen=True)
class Case:
    name: str
    generator: GaussianGenerator
    exported: Exported


@pytest.fixture(scope="module", params=BUILD)
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Case:
    name = request.param
    generator = BUILD[name](shared(f"data/checkpoints/{name}/ckpt"))
    path = tmp_path_factory.mktemp(name) / f"{name}.onnx"
    settings = Settings(level=Level.STATIC)
    return Case(name, generator, export(generator, path, target="webgpu", settings=settings))


def test_the_model_agrees_with_the_method_three_times_better_than_asked(case: Case) -> None:
    assert_margin(case.name, case.exported.path)


@pytest.mark.slow
def test_model_runs_in_webgpu_without_stale_replays(case: Case) -> None:
    settings = Settings(level=Level.LIVE, target=load_target("webgpu"))
    assert_captured(validate(case.exported.path, settings))


def test_the_manifest_says_which_weights_it_was_made_of(case: Case) -> None:
    folder = shared(f"data/checkpoints/{case.name}/ckpt")
    files = [
        path
        for path in (*folder.rglob("iteration_*/*"), *folder.glob("chkpnt*"))
        if path.suffix in (".ply", ".pt", ".pth")
    ]
    contents = b"".join(path.read_bytes() for path in sorted(files))
    producer = case.exported.manifest.producer
    assert producer is not None
    assert producer.weights_sha256 == hashlib.sha256(contents).hexdigest()
    assert producer.source is not None
    assert producer.source.startswith("https://")


@pytest.mark.slow
def test_half_precision_halves_the_weights_and_agrees_three_times_better_than_asked(
    case: Case, tmp_path: Path
) -> None:
    live = case.name == "hexplane_dnerf"  # once is enough: arithmetic is the same
    settings = Settings(level=Level.LIVE if live else Level.STATIC)
    path = tmp_path / "half.onnx"
    exported = export(case.generator, path, dtype="float16", target="webgpu", settings=settings)
    if live:
        assert_captured(exported.report)
    assert_margin(case.name, path)
    assert exported.float16_result is not None
    retained = weights_of(
        path, {weight.node for weight in exported.float16_result.retained_weights}
    )
    assert all(size < 4 * MIN_TABLE_ELEMENTS for size in retained)  # all large tables are halved
    assert stored(path) - sum(retained) <= 0.52 * (stored(case.exported.path) - sum(retained))


@pytest.mark.slow
def test_the_file_holds_weights_and_little_else(case: Case) -> None:
    model = onnx.load(case.exported.path)
    weights = sum(len(tensor.raw_data) for tensor in model.graph.initializer)
    graph = 40_000  # nodes, names and the manifest: the same for any number of Gaussians
    assert case.exported.path.stat().st_size <= weights + graph
    parts = [model.graph, *model.graph.node, *model.graph.value_info, *model.graph.output]
    assert not any(part.metadata_props for part in parts)  # torch's notes about its graph


@pytest.mark.slow
def test_nothing_in_the_graph_keeps_it_from_being_captured(case: Case) -> None:
    model = onnx.load(case.exported.path, load_external_data=False)
    nodes = model.graph.node
    kinds = {node.op_type for node in nodes}
    assert not kinds & {"NonZero", "GridSample", "ScatterND", "Loop", "If", "Compress"}
    assert all(len(node.input) <= 7 for node in nodes if node.op_type == "Concat")


@pytest.mark.slow
def test_viewer_export_prints_the_detected_method(tmp_path: Path) -> None:
    options = AnchorOptions(
        anchors=20, cameras=3, appearance=4, has_feature_bank=True, iteration=40000
    )
    run = write_octree(tmp_path / "run", options, mode="progressive")
    words = ["export", "octree-gs", "--checkpoint", str(run), "--appearance-id", "1"]
    words += ["-o", str(tmp_path / "tree.onnx"), "--target", "visionary"]
    words += ["--dtype", "float16", "--level", "static"]
    completed = CliRunner().invoke(build(), words)
    assert completed.exit_code == 0, completed.output
    for text in ("iteration 40000", "20 anchors × 5 Gaussians", "feature bank", "progressive"):
        assert text in completed.stderr
    assert "3 appearances of 4" in completed.stderr
    settings = Settings(level=Level.STATIC, target=load_target("visionary"))
    assert validate(tmp_path / "tree.onnx", settings).verdict == "conforms"


@pytest.mark.slow
def test_harmonics_of_any_degree_are_exported_in_half_precision(tmp_path: Path) -> None:
    run = write_hexplane(tmp_path / "run", HexPlaneOptions(count=5, degree=2))
    words = ["export", "hexplane-4dgs", "--checkpoint", str(run), "--dtype", "float16"]
    words += ["-o", str(tmp_path / "out.onnx"), "--level", "static"]
    completed = CliRunner().invoke(build(), words)
    assert completed.exit_code == 0, completed.output
    assert "SH of degree 2 are written as degree 3: rows fill words" in completed.stderr
    (color,) = (o for o in onnx.load(tmp_path / "out.onnx").graph.output if "sh" in o.name)
    assert [d.dim_value for d in color.type.tensor_type.shape.dim] == [5, 48]


def test_mistaken_export_options_are_explained(tmp_path: Path) -> None:
    write_octree(tmp_path / "run", AnchorOptions(anchors=3, iteration=40000, is_single_file=True))
    words = ("--checkpoint", "run", "--iteration", "7", "-o", "x.onnx")
    completed = gsgen_here("export", "octree-gs", *words, cwd=tmp_path)
    assert completed.code == 2, completed.err
    assert "There are: 40000." in completed.err
    assert "Traceback" not in completed.err
    assert not (tmp_path / "x.onnx").exists()


def test_unknown_appearance_is_refused(tmp_path: Path) -> None:
    options = AnchorOptions(anchors=3, cameras=2, appearance=4, is_single_file=True)
    write_scaffold(tmp_path / "two", options)
    with pytest.raises(CheckpointInvalid, match="2 is not one of the 2 training cameras"):
        scaffold_gs_plugin.build(tmp_path / "two", appearance_id=2)
    write_scaffold(tmp_path / "none", AnchorOptions(anchors=3, is_single_file=True))
    with pytest.raises(CheckpointInvalid, match="no appearance embedding"):
        scaffold_gs_plugin.build(tmp_path / "none", appearance_id=0)


def test_a_flag_that_is_not_honoured_is_warned_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_octree(tmp_path, AnchorOptions(anchors=3, iteration=40000, is_single_file=True))
    text = (tmp_path / "cfg_args").read_text()
    octree_gs_plugin.build(tmp_path)
    assert "warning" not in capsys.readouterr().err
    (tmp_path / "cfg_args").write_text(text.replace("[1.0]", "[2.0]"))
    octree_gs_plugin.build(tmp_path)
    assert "warning: resolution_scales=[2.0] is not supported" in capsys.readouterr().err
