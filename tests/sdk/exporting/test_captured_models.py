"""Models shaped like the published methods run wholly on the GPU, captured, and are not stale."""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import onnx_ir as ir
import pytest
import torch

from gsgen.contract.model.model_file import open_model, write_manifest
from gsgen.contract.spec.manifest import ImageOutput, Input, PostProcessManifest, PostProcessOutputs
from gsgen.contract.spec.manifest_io import parse
from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.sdk.exporting.embed_manifest import rewrite_and_embed
from gsgen.sdk.passes.framework.base import RewriteTarget
from gsgen.sdk.rewriting.model_io import save_model
from gsgen.sdk.rewriting.rewrite import GraphStats, graph_stats, rewrite_graph
from support.models.captured import assert_captured
from support.models.reference_models import Avatar, Denoiser, HexPlane, ScaffoldDecoder, rotation_of
from support.models.traced import traced

pytestmark = pytest.mark.slow


LIVE_SETTINGS = Settings(level=Level.LIVE, target=load_target("webgpu"))

# Each with its number of Gaussians, and the degree of its SH.
GENERATORS = {
    "scaffold": (ScaffoldDecoder, 240, None),
    "hexplane": (HexPlane, 60, 3),
    "avatar": (Avatar, 60, None),
}


def plain(name: str, folder: Path) -> Path:
    """Export a model as torch does, and give it a manifest."""
    path = folder / f"{name}.onnx"
    if name != "denoiser":
        make, rows, degree = GENERATORS[name]
        result = traced(make(), name, rows, degree)
        rewrite_and_embed(result.model, result.manifest, load_target("core"), rewrite=False)
        save_model(result.model, path)
        return path
    image, step = torch.rand(1, 3, 8, 8), torch.tensor([200], dtype=torch.int32)
    program = torch.onnx.export(
        Denoiser().eval(),
        (image, step),
        dynamo=True,
        verbose=False,
        opset_version=18,
        input_names=["image", "step"],
        output_names=["out"],
    )
    program.save(path)
    manifest = PostProcessManifest(
        name="denoiser",
        inputs=(
            Input(name="image", role="image"),
            Input(name="step", role="timestep", range=(0.0, 999.0)),
        ),
        outputs=PostProcessOutputs(ImageOutput("out")),
    )
    write_manifest(path, manifest, path)
    return path


@dataclass(frozen=True)
class Case:
    """A model as torch exports it, and what the rewrites make of it."""

    path: Path
    before: GraphStats
    after: GraphStats


@pytest.fixture(scope="module")
def rewritten(tmp_path_factory) -> dict[str, Case]:
    """Each model, rewritten for every consumer that is known."""
    folder = tmp_path_factory.mktemp("rewritten")
    cases = {}
    for name in (*GENERATORS, "denoiser"):
        first, path = plain(name, folder), folder / f"{name}_rewritten.onnx"
        manifest = parse(open_model(first).manifest_text).manifest
        goal = RewriteTarget.of(load_target("core"), manifest)
        model = ir.load(first)
        rewrite_graph(model, goal)
        save_model(model, path)
        cases[name] = Case(path, graph_stats(first, goal), graph_stats(path, goal))
    return cases


@pytest.mark.parametrize("name", [*GENERATORS, "denoiser"])
def test_every_node_of_a_rewritten_model_has_a_kernel_in_every_release(
    name: str, rewritten: dict[str, Case]
) -> None:
    done = rewritten[name]
    message = [f"{name}: {line}" for line in done.before.uncaptured]
    sys.stdout.write("\n".join([*message, f"{name}: {len(done.after.uncaptured)} left\n"]))
    assert done.after.uncaptured == ()


# The plugins' own exports of such models are run live before each change, rewritten in the same way.
@pytest.mark.parametrize(
    "name",
    [
        "hexplane",
        *(pytest.param(n, marks=pytest.mark.nightly) for n in ("scaffold", "avatar", "denoiser")),
    ],
)
def test_a_rewritten_model_is_captured_and_replayed_live(
    name: str, rewritten: dict[str, Case]
) -> None:
    report = validate(rewritten[name].path, LIVE_SETTINGS)
    assert_captured(report)
    assert report.environment["capture"].startswith("accepted, ")


@pytest.mark.parametrize("name", ["scaffold", "hexplane", "avatar"])
def test_a_model_as_torch_exports_it_is_not_captured_everywhere(
    name: str, rewritten: dict[str, Case]
) -> None:
    """Else the tests above would prove nothing of the rewrites."""
    assert rewritten[name].before.uncaptured


def test_wide_joins_of_exporters_are_narrow_afterwards(rewritten: dict[str, Case]) -> None:
    for case in rewritten.values():
        concat_nodes = [n for n in onnx.load(case.path).graph.node if n.op_type == "Concat"]
        assert max((len(node.input) for node in concat_nodes), default=0) <= 7


def test_the_avatar_turns_its_joints_by_their_axis_and_angle() -> None:
    """The model itself is right: Rodrigues' formula against a quaternion."""
    pose = torch.tensor([0.3, -1.1, 0.7])
    avatar = Avatar()
    poses = torch.zeros(6, 3)
    poses[0] = pose
    with torch.no_grad():
        moved = avatar(poses, torch.zeros(3)).position
        rest_rows = avatar.rest - avatar.joint[0]
        expected = rest_rows @ rotation_of(pose).T + avatar.joint[0]
    np.testing.assert_allclose(moved.numpy(), expected.numpy(), atol=1e-5)
