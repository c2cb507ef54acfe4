import numpy as np
import pytest

from gsgen.contract.model.inspected_model import inspect_model
from gsgen.contract.model.model_file import open_model
from gsgen.contract.probing.outputs import CHUNK_ROWS, chunks, read_outputs
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.targets import load_target
from support.models.small_models import good_rows, manifest_of, moving, save


@pytest.fixture(scope="module")
def subject(tmp_path_factory):
    path = tmp_path_factory.mktemp("emission") / "a.onnx"
    opened = open_model(save(path, moving(good_rows(4)), manifest_of(4)))
    return inspect_model(opened, load_target("core"), Limits())


def emission(subject, rows=4, **outputs):
    defaults = {
        "gaussians": good_rows(rows),
        "color": np.zeros((rows, 3), np.float32),
        "num_points": np.array([rows], np.int32),
    }
    return read_outputs(subject, "test", defaults | outputs)


def test_outputs_are_sorted_by_what_the_manifest_says(subject):
    result = emission(subject)
    assert result.gaussians.shape == (4, 10)
    assert result.appearance.shape == (4, 3)
    assert (result.count, result.probe, result.zeros) == (4, "test", False)
    assert result.declared.space == "rgb"


@pytest.mark.parametrize(
    ("count", "live"),
    [
        (np.array([3], np.int32), 3),
        (np.array([[2]], np.int64), 2),
        (np.array(1, np.uint8), 1),
        (np.array([-5], np.int32), 0),
        (np.array([9], np.int32), 4),
        (np.array([], np.int32), 4),
        (np.array([2.0], np.float32), 4),
        (np.array([np.nan], np.float32), 4),
        (np.array([np.inf]), 4),
        (np.array([True]), 4),
    ],
)
def test_the_count_is_a_whole_number_clipped_to_the_capacity(subject, count, live):
    assert emission(subject, num_points=count).count == live


@pytest.mark.parametrize(
    "rows",
    [
        np.zeros((4, 9), np.float32),
        np.zeros((1, 4, 10), np.float32),
        np.zeros((4, 10), np.float64),
        np.zeros((4, 10), np.int32),
    ],
)
def test_rows_of_another_shape_are_skipped(subject, rows):
    result = emission(subject, gaussians=rows)
    assert result.gaussians is None
    assert list(chunks(result)) == []


def test_an_appearance_of_another_length_is_left_to_another_rule(subject):
    assert emission(subject, color=np.zeros((5, 3), np.float32)).appearance is None


def test_rows_come_in_chunks_that_cover_all(subject):
    result = emission(subject, rows=2 * CHUNK_ROWS + 5)
    parts = list(chunks(result))
    assert [(part.start, len(part)) for part in parts] == [
        (0, CHUNK_ROWS),
        (CHUNK_ROWS, CHUNK_ROWS),
        (2 * CHUNK_ROWS, 5),
    ]
    joined_rows = np.concatenate([part.packed for part in parts])
    np.testing.assert_array_equal(joined_rows, result.gaussians)


def test_rows_before_the_count_are_live_across_chunks(subject):
    result = emission(subject, rows=2 * CHUNK_ROWS, num_points=np.array([CHUNK_ROWS + 3], np.int32))
    first, second = chunks(result)
    assert (first.live_rows, second.live_rows) == (CHUNK_ROWS, 3)
    assert first.counted.all()
    assert second.counted.nonzero()[0].tolist() == [0, 1, 2]


def test_a_chunk_unpacks_its_fields(subject):
    rows = np.arange(40, dtype=np.float32).reshape(4, 10)
    (part,) = chunks(emission(subject, gaussians=rows))
    np.testing.assert_array_equal(part.position, rows[:, :3].T)
    np.testing.assert_array_equal(part.opacity, rows[:, 3])
    np.testing.assert_array_equal(part.covariance, rows[:, 4:].T)
    np.testing.assert_array_equal(part.trace, rows[:, 4] + rows[:, 7] + rows[:, 9])


def test_rows_that_are_finite_opaque_and_counted_are_drawn(subject):
    rows, color = good_rows(6), np.zeros((6, 3), np.float32)
    rows[0, 0], rows[1, 9], color[2, 1] = np.nan, np.inf, np.nan
    rows[3, 3] = 0.003
    count = np.array([5], np.int32)
    (part,) = chunks(emission(subject, gaussians=rows, color=color, num_points=count))
    assert part.finite.tolist() == [False, False, False, True, True, True]
    assert part.drawn.tolist() == [False] * 4 + [True, False]
    assert part.drawn_count == 1


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_the_peak_of_a_colour_is_its_largest_magnitude_with_nan_on_top(subject, dtype):
    color = np.zeros((6, 3), dtype)
    color[1:, 1] = [-1, np.finfo(dtype).max, -np.inf, np.nan, 0]
    color[3:5, 2] = [2, -np.inf]
    (part,) = chunks(emission(subject, rows=6, color=color))
    assert np.argsort(part.color_peak, kind="stable").tolist() == [0, 5, 1, 2, 3, 4]
    assert part.finite.tolist() == [True, True, True, False, False, True]


def test_the_peak_of_usual_colours_is_not_looked_for(subject):
    (part,) = chunks(emission(subject, color=np.full((4, 3), 0.5, np.float32)))
    assert part.color_peak.tolist() == [0, 0, 0, 0]
