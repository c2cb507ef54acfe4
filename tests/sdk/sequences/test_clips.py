"""A clip's tables and graph hold the frames of a sequence, compared with an oracle in float64."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.sdk.exporting.constant_generator import ConstantRows
from gsgen.sdk.sequences.clip_source import ClipSource
from gsgen.sdk.sequences.encoding import ErrorBudget
from gsgen.sdk.sequences.frame_store import cholesky_factors
from gsgen.sdk.sequences.low_rank import find_basis
from gsgen.sdk.sequences.quantisation import digits_of

STATIC = Settings(level=Level.STATIC)
UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def random_frames(
    seed: int, *, rows: int = 300, frames: int = 9, space: str = "sh", channels: int = 12
) -> list[ConstantRows]:
    """Return frames of Gaussians: a third stays, a third moves along waves, a third fades, too."""
    rng = np.random.default_rng(seed)
    third = rows // 3
    start, direction = rng.normal(size=(2, rows, 3))
    direction[:third] = 0
    axes = 0.05 * rng.normal(size=(rows, 3, 3))
    twist = 0.02 * rng.normal(size=(rows, 3, 3))
    twist[:third] = 0
    opacity, birth = rng.uniform(0.3, 1, rows), rng.uniform(size=rows)
    color = rng.uniform(size=(rows, channels))
    sequence = []
    for number in range(frames):
        wave = np.sin(2 * np.pi * number / frames)
        shape = axes + wave * twist
        sigma = shape @ shape.transpose(0, 2, 1) + 1e-6 * np.eye(3)
        window = np.ones(rows)
        window[2 * third :] = np.clip(1.5 - 3 * np.abs(number / frames - birth[2 * third :]), 0, 1)
        packed = np.concatenate(
            [
                start + wave * direction,
                (opacity * window)[:, None],
                np.stack([sigma[:, i, j] for i, j in UPPER], axis=1),
            ],
            axis=1,
        )
        sequence.append(
            ConstantRows(
                rows=packed.astype(np.float32),
                appearance=color.astype(np.float32),
                space="rgb" if space == "rgb" else "sh",
                description="random rows",
            )
        )
    return sequence


def source(frames: Sequence[ConstantRows], **options: object) -> ClipSource:
    names = [f"{number}.ply" for number in range(len(frames))]
    return ClipSource(names=names, read=lambda number: frames[number], **options)  # type: ignore[arg-type]


def run(path: Path, time: float) -> dict[str, np.ndarray]:
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]
    return dict(zip(names, session.run(None, {"time": np.array([time], np.float32)}), strict=True))


def matched(rows: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Return the rows of a clip in the order of the expected ones: centres are all different."""
    distances = np.linalg.norm(rows[None, :, :3] - expected[:, None, :3], axis=2)
    order = distances.argmin(axis=1)
    assert len(set(order.tolist())) == len(rows)
    return order


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("space", "channels"), [("sh", 12), ("sh", 3), ("rgb", 3)])
def test_moments_of_a_clip_are_those_of_its_frames_within_the_budget(
    tmp_path: Path, seed: int, space: str, channels: int
) -> None:
    frames = random_frames(seed, space=space, channels=channels)
    path, budget = tmp_path / "clip.onnx", ErrorBudget()
    exported = source(frames).export(path, settings=STATIC)
    assert exported.manifest.inputs[0].frames == len(frames)
    for place in (0, 3, 3.5, 7.25, 8):
        low, part = int(place), place - int(place)
        neighbours = [np.float64(frames[min(low + step, len(frames) - 1)].rows) for step in (0, 1)]
        weights = (1 - part, part)
        outputs = run(path, place / len(frames))
        # Centres and opacities are interpolated, and Cholesky factors: not covariances.
        expected = sum(w * rows for w, rows in zip(weights, neighbours, strict=True))
        factors = sum(
            w * np.linalg.cholesky(symmetric(rows[:, 4:]))
            for w, rows in zip(weights, neighbours, strict=True)
        )
        order = matched(outputs["gaussians"], np.asarray(expected))
        rows = outputs["gaussians"][order].astype(np.float64)
        size = np.sqrt(np.trace(symmetric(neighbours[0][:, 4:]), axis1=1, axis2=2) / 3)
        assert rms((rows[:, :3] - expected[:, :3]) / size[:, None]) < 2 * budget.motion
        assert rms(rows[:, 3] - expected[:, 3]) < 2 * budget.opacity
        written = np.linalg.cholesky(symmetric(rows[:, 4:]) + 1e-9 * np.eye(3))
        assert rms((written - factors) / size[:, None, None]) < 3 * budget.factors
        (color,) = (outputs[name] for name in outputs if name.startswith("color"))
        assert np.abs(color[order][:, :3] - frames[0].appearance[:, :3]).max() < 2 * budget.color


def symmetric(upper: np.ndarray) -> np.ndarray:
    matrices = np.zeros((len(upper), 3, 3))
    for column, (i, j) in enumerate(UPPER):
        matrices[:, i, j] = matrices[:, j, i] = upper[:, column]
    return matrices


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_a_loop_ends_where_it_begins_and_other_clips_hold_their_last_frame(tmp_path: Path) -> None:
    frames = random_frames(5)
    for loop, last in ((True, 0), (False, len(frames) - 1)):
        path = tmp_path / f"{loop}.onnx"
        source(frames, loop=loop).export(path, settings=STATIC)
        end, expected = run(path, 1.0), run(path, last / len(frames))
        np.testing.assert_allclose(end["gaussians"], expected["gaussians"], atol=1e-6)


def test_rows_that_do_not_change_are_stored_once(tmp_path: Path) -> None:
    few, many = (random_frames(1, rows=3000, frames=count) for count in (4, 16))
    for frames in (few, many):
        for frame in frames:  # a scene in which a hundred rows move
            frame.rows[100:] = frames[0].rows[100:]
    sizes = []
    for index, frames in enumerate((few, many)):
        path = tmp_path / f"{index}.onnx"
        source(frames).export(path, settings=STATIC)
        sizes.append(path.stat().st_size)
    assert sizes[1] < 1.2 * sizes[0]


def test_tables_are_float16_where_a_target_dequantises_wrongly(tmp_path: Path) -> None:
    moments = []
    for target in ("core", "visionary"):
        path = tmp_path / f"{target}.onnx"
        source(random_frames(6, rows=90, channels=48)).export(path, settings=STATIC, target=target)
        operators = {node.op_type for node in onnx.load(path).graph.node}
        assert ("DequantizeLinear" in operators) == (target == "core")
        moments.append(run(path, 0.37))
    for name, values in moments[0].items():
        np.testing.assert_allclose(moments[1][name], values, atol=1e-5)


def test_one_frame_is_no_sequence(tmp_path: Path) -> None:
    with pytest.raises(ConfigInvalid, match="1 frame, expected two or more"):
        source(random_frames(2)[:1]).export(tmp_path / "clip.onnx", settings=STATIC)
    assert not list(tmp_path.iterdir())


def test_digits_are_bytes_that_add_up() -> None:
    rng = np.random.default_rng(0)
    for bits in (3, 7, 8, 15, 16, 23, 30):
        numbers = rng.integers(-(2**bits), 2**bits, 500)
        digits = digits_of(numbers)
        values = sum((row.astype(int) - 128) * 256**power for power, row in enumerate(digits))
        np.testing.assert_array_equal(values, numbers)


def test_a_basis_leaves_the_error_that_it_says() -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(size=(7, 40)) * np.geomspace(1, 1e-3, 7)[:, None]
    basis = find_basis(values @ values.T, values.shape[1])
    for rank in range(8):
        weights = basis.weights[:, :rank]
        left = values - weights @ (weights.T @ values)
        worst_frame = np.sqrt(np.square(left).mean(axis=1)).max()
        np.testing.assert_allclose(basis.residual[rank], worst_frame, atol=1e-6)
        assert basis.rank(float(basis.residual[rank])) <= rank


def test_cholesky_factors_are_those_of_numpy_and_flat_gaussians_have_some() -> None:
    rng = np.random.default_rng(4)
    shape = rng.normal(size=(50, 3, 3))
    sigma = shape @ shape.transpose(0, 2, 1)
    upper = np.stack([sigma[:, i, j] for i, j in UPPER], axis=1)
    factors = np.linalg.cholesky(sigma)
    expected = np.stack([factors[:, i, j] for j, i in UPPER], axis=1)
    np.testing.assert_allclose(cholesky_factors(upper), expected, rtol=1e-6, atol=1e-6)
    flat = cholesky_factors(np.array([[1, 0, 0, 1, 0, 0], [0, 0, 0, 0, 0, 0]], np.float32))
    assert np.isfinite(flat).all()
    assert (flat[:, [0, 3, 5]] > 0).all()
