"""Models shaped like the published methods run wholly on the GPU, captured, and are not stale."""

import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

from gsgen.contract.config import Settings
from gsgen.contract.engine import validate
from gsgen.contract.finding import Level
from gsgen.contract.manifest import (
    ImageOutput,
    Input,
    PostProcessManifest,
    PostProcessOutputs,
)
from gsgen.contract.model import write_manifest
from gsgen.contract.targets import load_target
from gsgen.sdk import export
from gsgen.sdk.rewrite import Rewritten, rewrite_file
from support.generators import Growing
from support.reference_models import (
    Avatar,
    Denoiser,
    HexPlane,
    ScaffoldDecoder,
    rotation_of,
)

LIVE = Settings(level=Level.LIVE, target=load_target("webgpu"))
CAPTURED = ("GB011", "GB014", "GB015", "GB016", "GB017")
GENERATORS = {
    "scaffold": ScaffoldDecoder,
    "hexplane": HexPlane,
    "avatar": Avatar,
    "growing": Growing,
}


def plain(name: str, folder: Path) -> Path:
    """Export a model as torch does, and give it a manifest."""
    path = folder / f"{name}.onnx"
    if name != "denoiser":
        values = Settings(level=Level.STATIC)
        export(GENERATORS[name](), path, rewrite=False, settings=values)
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
        inputs=(Input("image", "image"), Input("step", "timestep", range=(0.0, 999.0))),
        outputs=PostProcessOutputs(ImageOutput("out")),
    )
    write_manifest(path, manifest, path)
    return path


@pytest.fixture(scope="module")
def rewritten(tmp_path_factory) -> dict[str, tuple[Path, Rewritten]]:
    """Each model, rewritten for every consumer that is known."""
    folder = tmp_path_factory.mktemp("rewritten")
    made = {}
    for name in (*GENERATORS, "denoiser"):
        path = folder / f"{name}_rewritten.onnx"
        done = rewrite_file(plain(name, folder), path, load_target("core"))
        made[name] = path, done
    return made


@pytest.mark.parametrize("name", [*GENERATORS, "denoiser"])
def test_every_node_of_a_rewritten_model_has_a_kernel_in_every_release(
    name: str, rewritten: dict[str, tuple[Path, Rewritten]]
) -> None:
    _, done = rewritten[name]
    told = [f"{name}: {line}" for line in done.before.uncaptured]
    sys.stdout.write("\n".join([*told, f"{name}: {len(done.after.uncaptured)} left\n"]))
    assert done.after.uncaptured == ()


@pytest.mark.parametrize("name", ["scaffold", "hexplane", "avatar", "denoiser"])
def test_a_rewritten_model_is_captured_and_replayed_live(
    name: str, rewritten: dict[str, tuple[Path, Rewritten]]
) -> None:
    report = validate(rewritten[name][0], LIVE)
    (level,) = (one for one in report.levels if one.level is Level.LIVE)
    assert level.ran, f"{level.reason}; install a driver with `make drivers`"
    assert {rule: report.outcome(rule).status for rule in CAPTURED} == dict.fromkeys(
        CAPTURED, "pass"
    )
    assert report.environment["capture"].startswith("accepted, ")


@pytest.mark.parametrize("name", ["scaffold", "hexplane", "growing"])
def test_a_model_as_torch_exports_it_is_not_captured_everywhere(
    name: str, rewritten: dict[str, tuple[Path, Rewritten]]
) -> None:
    """Else the tests above would prove nothing of the rewrites."""
    assert rewritten[name][1].before.uncaptured


def test_wide_joins_of_exporters_are_narrow_afterwards(
    rewritten: dict[str, tuple[Path, Rewritten]],
) -> None:
    for path, _ in rewritten.values():
        joins = [n for n in onnx.load(path).graph.node if n.op_type == "Concat"]
        assert max((len(node.input) for node in joins), default=0) <= 7


def test_the_avatar_turns_its_joints_by_their_axis_and_angle() -> None:
    """The model itself is right: Rodrigues' formula against a quaternion."""
    pose = torch.tensor([0.3, -1.1, 0.7])
    avatar = Avatar()
    poses = torch.zeros(6, 3)
    poses[0] = pose
    with torch.no_grad():
        moved = avatar(poses, torch.zeros(3)).position
        rest = avatar.rest - avatar.joint[0]
        wanted = rest @ rotation_of(pose).T + avatar.joint[0]
    np.testing.assert_allclose(moved.numpy(), wanted.numpy(), atol=1e-5)
