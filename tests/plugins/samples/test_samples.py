"""The sample files: complete, readable, valid, and moved as their joints say."""

import json
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

from gsgen.contract.spec.layout import decode
from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.formats import open_splats
from gsgen.reference_plugins.samples import write_samples
from gsgen.reference_plugins.samples.files import SAMPLE_WRITERS
from gsgen.reference_plugins.samples.sunflower import JOINTS
from support.commands import gsgen_here

MOST_BYTES = 6_000_000


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("samples")
    write_samples(folder)
    return folder


def outputs(path: Path, **inputs: object) -> tuple[np.ndarray, np.ndarray]:
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    feeds = {name: np.asarray(value, np.float32) for name, value in inputs.items()}
    rows, colors, _ = session.run(None, feeds)
    return rows, colors


def rodrigues(vector: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of an axis-angle, in float64."""
    angle = np.linalg.norm(vector)
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def test_the_command_writes_and_lists_every_file(tmp_path: Path) -> None:
    result = gsgen_here("samples", tmp_path / "new" / "folder", "--json")
    assert result.code == 0, result.err
    paths = [Path(path) for path in json.loads(result.out)]
    assert [path.name for path in paths] == list(SAMPLE_WRITERS)
    assert sum(path.stat().st_size for path in paths) < MOST_BYTES


def test_a_file_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", "utf-8")
    result = gsgen_here("samples", tmp_path / "file")
    assert result.code == 2
    assert "Traceback" not in result.err


def test_the_garden_reads_back_and_stands_on_the_ground(folder: Path) -> None:
    splats = open_splats(folder / "garden.ply")
    assert 50_000 < len(splats) < 80_000
    assert np.abs(np.linalg.norm(splats.rotation, axis=1) - 1).max() < 1e-5
    height = -splats.position[:, 1]  # y is down
    assert height.min() > -0.3
    assert 2 < height.max() < 4


@pytest.mark.parametrize("target", ["core", "webgpu", "gsgen"])
def test_the_sunflower_conforms(folder: Path, target: str) -> None:
    settings = Settings(level=Level.BEHAVIOUR, target=load_target(target))
    report = validate(folder / "sunflower.onnx", settings)
    assert report.verdict == "conforms", report.findings


@pytest.mark.parametrize("seed", range(6))
def test_the_head_follows_the_chain_of_joints(folder: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose = rng.uniform(-1, 1, (3, 3)) * (seed > 0)
    time = rng.uniform(0, 1)
    path = folder / "sunflower.onnx"
    rest_rows, _ = outputs(path, time=[0.0], pose=np.zeros((3, 3)))
    moved, _ = outputs(path, time=[time], pose=pose)
    # The head is rigid: undo its motion at rest, and apply that of the pose, in float64.
    head = slice(-1000, None)
    matrix_rest, shift_rest = chain(0.0, np.zeros((3, 3)))
    matrix, shift = chain(time, pose)
    local = (rest_rows[head, :3] - shift_rest) @ matrix_rest
    np.testing.assert_allclose(moved[head, :3], local @ matrix.T + shift, atol=2e-5)
    turn = matrix @ matrix_rest.T
    expected = turn @ full_matrices(rest_rows[head, 4:]) @ turn.T
    np.testing.assert_allclose(full_matrices(moved[head, 4:]), expected, atol=2e-7)


def chain(time: float, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation and shift of the head: x → matrix (x − rest) + its place."""
    sway = np.array([[0.03, 0, 0.06], [0.05, 0, 0.1], [0.08, 0.05, 0.12]])
    vectors = pose + sway * np.sin(2 * np.pi * time - 0.6 * np.arange(3))[:, None]
    stem, neck, head = map(rodrigues, vectors)
    bones = np.array([joint.rest for joint in JOINTS])
    joint_position = stem @ (bones[1] - bones[0]) + stem @ neck @ (bones[2] - bones[1])
    matrix = stem @ neck @ head
    return matrix, joint_position - matrix @ bones[2]


def full_matrices(upper: np.ndarray) -> np.ndarray:
    return upper[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]].astype(np.float64)


def test_the_sway_loops_and_zero_is_the_rest(folder: Path) -> None:
    path = folder / "sunflower.onnx"
    start, colors = outputs(path, time=[0.0], pose=np.zeros((3, 3)))
    end, _ = outputs(path, time=[1.0], pose=np.zeros((3, 3)))
    np.testing.assert_allclose(start, end, atol=1e-5)
    decoded = decode(start, colors, "rgb")
    assert (decoded.opacity > 0.9).all()


def test_cameras_stand_on_an_arc_around_the_scene(folder: Path) -> None:
    documents = json.loads((folder / "cameras.json").read_text("utf-8"))
    views = np.array([document["view"] for document in documents])
    eyes = -np.einsum("nji,nj->ni", views[:, :3, :3], views[:, :3, 3])
    np.testing.assert_allclose(np.hypot(eyes[:, 0], eyes[:, 2]), 3.9, rtol=1e-5)
    np.testing.assert_allclose(eyes[:, 1], -1.75, rtol=1e-5)
    np.testing.assert_allclose(eyes[:, 0], -eyes[::-1, 0], atol=1e-5)


def test_user_files_are_not_overwritten_without_force(tmp_path: Path) -> None:
    own = {"garden.ply": b"my garden", "scene.json": b'{"models": ["mine.ply"]}'}
    for name, content in own.items():
        (tmp_path / name).write_bytes(content)
    result = gsgen_here("samples", ".", cwd=tmp_path)
    assert result.code == 2
    assert "garden.ply, scene.json of other content would be overwritten" in result.err
    assert "--force" in result.err
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == own
    assert gsgen_here("samples", ".", "--force", cwd=tmp_path).code == 0
    assert not {path.read_bytes() for path in tmp_path.iterdir()} & set(own.values())


def test_existing_samples_are_accepted(folder: Path) -> None:
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    result = gsgen_here("samples", folder)
    assert result.code == 0, result.err
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
