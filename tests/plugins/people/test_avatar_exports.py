"""Exported avatars, against what the methods' own code gave, and as a user exports them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import pytest

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.people import gauhuman_plugin, lhm_plugin, r3_avatar_plugin
from gsgen.reference_plugins.synthetic import (
    PersonOptions,
    write_body,
    write_gauhuman,
    write_lhm,
    write_motion,
    write_r3,
)
from gsgen.sdk import GaussianGenerator, export
from gsgen.sdk.exporting.pipeline import Exported
from gsgen.sdk.float16.weight_tables import MIN_TABLE_ELEMENTS
from support.checkpoints.plugin_checks import MARGIN, acceptance, eager, run, stored, weights_of
from support.commands import shared
from support.models.captured import assert_captured

BUILD: dict[str, Callable[[Path], GaussianGenerator]] = {
    "gauhuman_plain": gauhuman_plugin.build,
    "lhm": lhm_plugin.build,
    "r3_zju": lambda path: r3_avatar_plugin.build(path, dataset="zju", pose_ids="0-99"),
}
# Our names → those of the acceptance tool.
NAMES = {
    "pose": ("poses", "pose"),
    "root_rotation": ("R",),
    "root_translation": ("Th", "trans"),
    "shape": ("shapes",),
    "expression": ("expr",),
    "frame_index": ("pose_id",),
}
EXPECTED = {"xyz": 2e-5, "op": 2e-5, "cov": 5e-5, "col": 2e-5}


@dataclass(frozen=True)
class Case:
    name: str
    generator: GaussianGenerator
    exported: Exported

    def feeds(self, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {
            declared.name: np.asarray(
                next(values[key] for key in NAMES[declared.name] if key in values)
            ).reshape(declared.shape)
            for declared in self.generator.inputs
        }


@pytest.fixture(scope="module", params=BUILD)
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Case:
    name = request.param
    generator = BUILD[name](shared(f"data/checkpoints/{name}/ckpt"))
    path = tmp_path_factory.mktemp(name) / f"{name}.onnx"
    settings = Settings(level=Level.STATIC)
    return Case(name, generator, export(generator, path, target="webgpu", settings=settings))


def test_the_model_agrees_with_the_method_three_times_better_than_asked(case: Case) -> None:
    tool = acceptance()
    for index, (values, target) in enumerate(tool.targets(case.name)):
        rows, color = run(case.exported.path, case.feeds(values))[:2]
        agrees, errors = tool.check(case.name, index, rows, color, "f32", target)
        assert agrees
        for field, error in errors.items():
            assert error <= EXPECTED[field] / MARGIN, (field, error)


# One avatar before each change, all of them at night: the search of an export takes half a minute.
@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    ["gauhuman_plain", *(pytest.param(n, marks=pytest.mark.nightly) for n in ("lhm", "r3_zju"))],
    indirect=True,
)
def test_half_precision_halves_the_weights_and_agrees_as_well_as_asked(
    case: Case, tmp_path: Path
) -> None:
    tool, path = acceptance(), tmp_path / "half.onnx"
    live = case.name != "r3_zju"
    settings = Settings(level=Level.LIVE if live else Level.STATIC)
    result = export(case.generator, path, dtype="float16", target="webgpu", settings=settings)
    if live:
        assert_captured(result.report)
    for index, (values, target) in enumerate(tool.targets(case.name)):
        rows, color = run(path, case.feeds(values))[:2]
        agrees, errors = tool.check(case.name, index, rows, color, "f16", target)
        assert agrees, errors
    assert result.float16_result is not None
    retained = weights_of(path, {entry.node for entry in result.float16_result.retained_weights})
    assert all(size < 4 * MIN_TABLE_ELEMENTS for size in retained)  # all large tables are halved
    assert stored(path) - sum(retained) <= 0.55 * (stored(case.exported.path) - sum(retained))


@pytest.mark.slow
def test_novel_poses_agree_with_the_method_s_own(tmp_path: Path) -> None:
    folder = shared("data/checkpoints/r3_zju")
    generator = r3_avatar_plugin.build(
        folder / "ckpt", dataset="zju", pose_ids="0-99", novel_poses=True
    )
    exported = export(
        generator, tmp_path / "novel.onnx", target="webgpu", settings=Settings(level=Level.LIVE)
    )
    assert_captured(exported.report)
    golden = np.load(folder / "golden.npz")
    parts = [entry.name for entry in generator.inputs if entry.role == "frame_index"]
    for index, pair in enumerate(golden["in_pair_t"]):
        values = {"pose": golden["in_poses"][index], "root_rotation": golden["in_R"][index]}
        values |= {"root_translation": golden["in_Th"][index], "shape": golden["in_shapes"][0]}
        feeds = {
            entry.name: values[entry.name].astype(np.float32).reshape(entry.shape)
            for entry in generator.inputs
            if entry.name in values
        }
        feeds |= {
            part: np.array([number], np.int32) for part, number in zip(parts, pair, strict=True)
        }
        rows, _ = run(exported.path, feeds)[:2]
        fields = (("xyz", rows[:, :3]), ("opacity", rows[:, 3:4]), ("cov6", rows[:, 4:]))
        for name, actual in fields:
            target = golden[f"nops{index}_{name}"]
            allowed = EXPECTED[{"opacity": "op", "cov6": "cov"}.get(name, name)] / MARGIN
            assert np.abs(actual - target).max() <= allowed * np.abs(target).max(), (index, name)


@pytest.mark.slow
def test_novel_poses_are_inputs_of_one_body(tmp_path: Path) -> None:
    for words in ({"instances": 2}, {"motion": tmp_path / "walk.npz"}):
        with pytest.raises(ConfigInvalid, match="cannot be combined with --novel-poses"):
            r3_avatar_plugin.build(tmp_path, novel_poses=True, **words)


@pytest.mark.slow
def test_avatar_runs_in_webgpu_without_stale_replays(case: Case) -> None:
    settings = Settings(level=Level.LIVE, target=load_target("webgpu"))
    assert_captured(validate(case.exported.path, settings))


@pytest.mark.slow
def test_the_file_holds_weights_and_little_else(case: Case) -> None:
    model = onnx.load(case.exported.path)
    weights = sum(len(tensor.raw_data) for tensor in model.graph.initializer)
    weight_bytes = sum(
        buffer.numel() * buffer.element_size() for buffer in case.generator.buffers()
    )
    graph = 80_000  # nodes, names and the manifest: the same for any number of Gaussians
    assert weights <= 1.05 * weight_bytes + 20_000
    assert case.exported.path.stat().st_size <= weights + graph


@pytest.mark.slow
def test_nothing_in_the_graph_keeps_it_from_being_captured(case: Case) -> None:
    nodes = onnx.load(case.exported.path).graph.node
    kinds = {node.op_type for node in nodes}
    assert not kinds & {"NonZero", "GridSample", "ScatterND", "Loop", "If", "Compress"}
    assert all(len(node.input) <= 7 for node in nodes if node.op_type == "Concat")


@pytest.mark.slow
def test_a_motion_plays_in_a_viewer_that_knows_no_poses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_gauhuman(tmp_path / "run", PersonOptions(count=20))
    motion = write_motion(tmp_path / "sway.npz")
    generator = gauhuman_plugin.build(folder, motion=motion, loop=True, instances=2)
    notes = capsys.readouterr().err
    for words in (
        "20 Gaussians",
        "SMPL of 150 vertices",
        "8 frames at 30 frames per second",
        "no shape coefficients: they are zero without --shape",
        "parts of SMPL, whose licence forbids redistribution",
    ):
        assert words in notes
    path, target = tmp_path / "sway.onnx", "visionary"
    settings = Settings(level=Level.STATIC, target=load_target(target))
    result = export(generator, path, target=target, dtype="float16", settings=settings)
    assert result.report.verdict == "conforms"
    assert [
        (declared.role, declared.frames, declared.loop) for declared in result.manifest.inputs
    ] == [("time", 8, True)]
    assert result.manifest.producer is not None
    assert result.manifest.producer.license == "LicenseRef-SMPL-derived-no-redistribution"


def test_missing_body_model_is_explained(tmp_path: Path) -> None:
    folder = write_gauhuman(tmp_path / "run")
    (folder / "assets/SMPL_NEUTRAL.pkl").unlink()
    with pytest.raises(CheckpointInvalid) as caught:
        gauhuman_plugin.build(folder)
    for words in (
        "run/assets/SMPL_NEUTRAL.pkl",
        "https://smpl.is.tue.mpg.de",
        "--body SMPL_NEUTRAL.pkl",
        "J_regressor",
        "24 joints",
    ):
        assert words in str(caught.value)
    with pytest.raises(CheckpointInvalid, match=r"elsewhere\.npz: the body model SMPL-X"):
        lhm_plugin.build(write_lhm(tmp_path / "lhm"), body=tmp_path / "elsewhere.npz")


def test_a_body_may_lie_anywhere_and_be_of_either_format(tmp_path: Path) -> None:
    folder = write_gauhuman(tmp_path / "run")
    options = PersonOptions()
    npz_body = write_body(tmp_path / "other.npz", options)
    pose = np.random.default_rng(0).normal(0, 0.3, (24, 3)).astype(np.float32)
    root_inputs = (np.eye(3, dtype=np.float32), np.zeros(3, np.float32), np.ones(10, np.float32))
    first = eager(gauhuman_plugin.build(folder), pose, *root_inputs)
    second = eager(gauhuman_plugin.build(folder, body=npz_body), pose, *root_inputs)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["gauhuman", "lhm", "r3"])
def test_every_frame_of_a_motion_is_reached(method: str, tmp_path: Path) -> None:
    options, frames = PersonOptions(count=6, nets=True), 7
    motion = write_motion(tmp_path / "sway.npz", frames=frames)
    folder = tmp_path / "run"
    if method == "gauhuman":
        generator = gauhuman_plugin.build(write_gauhuman(folder, options), motion=motion)
    elif method == "lhm":
        generator = lhm_plugin.build(write_lhm(folder, options), motion=motion)
    else:
        generator = r3_avatar_plugin.build(write_r3(folder, options), motion=motion)
    (time,) = generator.inputs
    assert (time.role, time.frames, time.fps) == ("time", frames, 30.0)
    frames_shown = {
        share: [
            eager(generator, np.array([(frame + share) / frames], np.float32))[0]
            for frame in range(frames)
        ]
        for share in (0.0, 0.3, 0.99)
    }
    for time_value in (0.3, 0.99):
        np.testing.assert_array_equal(frames_shown[0.0], frames_shown[time_value])
    assert len({rows.tobytes() for rows in frames_shown[0.0]}) == frames
    for requested_time, frame in ((1.0, -1), (7.0, -1), (-3.0, 0)):
        rows, _ = eager(generator, np.array([requested_time], np.float32))
        np.testing.assert_array_equal(rows, frames_shown[0.0][frame])


@pytest.mark.slow
def test_motion_equals_its_poses(tmp_path: Path) -> None:
    folder = write_gauhuman(tmp_path / "run", PersonOptions(nets=True))
    path = write_motion(tmp_path / "sway.npz", frames=5)
    played = gauhuman_plugin.build(folder, motion=path, shape="0.5,-1", instances=2, spacing=0.5)
    rows, _ = eager(played, np.array([0.5], np.float32))
    with np.load(path) as read:
        poses, translation = read["poses"][2], read["trans"][2]
    pose = np.zeros(72)
    pose[:66] = poses[:66]  # the hand joints of SMPL are not those of SMPL+H
    values = (pose.reshape(24, 3), np.eye(3), translation, np.array([0.5, -1.0] + [0.0] * 8))
    live = gauhuman_plugin.build(folder)
    expected, _ = eager(live, *(value.astype(np.float32) for value in values))
    half = len(rows) // 2
    np.testing.assert_allclose(rows[:half], expected, atol=1e-6)
    np.testing.assert_allclose(rows[half:, :3], expected[:, :3] + [0.5, 0, 0], atol=1e-6)


def test_another_gender_is_warned_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_gauhuman(tmp_path / "run", PersonOptions(count=3))
    gauhuman_plugin.build(folder)
    assert "warning" not in capsys.readouterr().err
    cfg = folder / "cfg_args"
    cfg.write_text(cfg.read_text().replace("'neutral'", "'male'"))
    gauhuman_plugin.build(folder, body=folder / "assets/SMPL_NEUTRAL.pkl")
    assert "warning: actor_gender='male' is not supported" in capsys.readouterr().err
    cfg.unlink()
    gauhuman_plugin.build(folder)
    assert "a neutral SMPL body is assumed" in capsys.readouterr().err


def test_speed_needs_a_motion(tmp_path: Path) -> None:
    with pytest.raises(ConfigInvalid, match="--fps and --loop need a motion"):
        gauhuman_plugin.build(write_gauhuman(tmp_path), fps=30)


def test_flame_needs_both_files(tmp_path: Path) -> None:
    with pytest.raises(ConfigInvalid, match="must be given together"):
        lhm_plugin.build(tmp_path, flame=tmp_path / "FLAME_NEUTRAL.pkl")


@pytest.mark.parametrize(
    ("text", "ids"), [("3", [3]), ("0-2,7", [0, 1, 2, 7]), ("5, 1-2", [5, 1, 2])]
)
def test_pose_ids_are_lists_of_numbers_and_ranges(text: str, ids: list[int]) -> None:
    assert r3_avatar_plugin.parse_pose_ids(text) == ids


@pytest.mark.parametrize("text", ["", "a", "1-", "-3", "1,,2", "3-1", "0-999999999999"])
def test_other_pose_ids_are_refused(text: str) -> None:
    with pytest.raises(ConfigInvalid):
        r3_avatar_plugin.parse_pose_ids(text)
