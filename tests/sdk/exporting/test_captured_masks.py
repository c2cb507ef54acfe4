"""A loop, a mask and a sampled plane: refused as they are, captured once rewritten, in float16 too."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

from gsgen.contract.spec.manifest import Bounds
from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.sdk.float16.convert_model import write_float16
from gsgen.sdk.rewriting.rewrite import RewriteResult, rewrite_file
from support.models.captured import assert_captured
from support.models.small_models import good_rows, manifest_of, model, save, weight

N = 300
WEBGPU = load_target("webgpu")
TEXT = """
culled (float[1] time) => (float[K,10] gaussians, float[K,3] color, int32[1] num_points)
<int64[1] flat = {-1}, int64 first = {0}, int64 trips = {3}, float tenth = {0.1},
 int64[4] grid_shape = {1, 1, ROWS, 2}, int64[2] rows_last = {3, ROWS}, int64[1] zero = {0},
 int64[1] one = {1}, int64[1] two = {2}> {
    moved = Loop (trips, , rest) <body = turn (int64 i, bool c, float[ROWS,3] v) => (bool on, float[ROWS,3] w) {
        on = Identity (c)
        number = Cast <to = 1> (i)
        pace = Mul (number, tenth)
        now = Mul (pace, time)
        step = Mul (now, v)
        w = Add (v, step)
    }>
    uv = Slice (moved, zero, two, one)
    grid = Reshape (uv, grid_shape)
    sampled = GridSample <align_corners = 1, padding_mode = "border"> (plane, grid)
    columns = Reshape (sampled, rows_last)
    feature = Transpose <perm = [1, 0]> (columns)
    squares = Mul (moved, moved)
    sum = ReduceSum (squares, one)
    length = Sqrt (sum)
    direction = Div (moved, length)
    mixed = Add (direction, feature)
    shade = Sigmoid (mixed)
    x = Gather <axis = 1> (moved, first)
    edge = Sub (time, tenth)
    shown = Greater (x, edge)
    rows = Concat <axis = 1> (moved, others)
    columns_of = NonZero (shown)
    places = Transpose <perm = [1, 0]> (columns_of)
    gaussians = GatherND (rows, places)
    color = GatherND (shade, places)
    ones = Cast <to = 6> (shown)
    total = ReduceSum <keepdims = 0> (ones)
    num_points = Reshape (total, flat)
}
"""


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rows = good_rows(N)
    plane = np.random.default_rng(0).normal(size=(1, 3, 16, 16))
    proto = model(
        TEXT.replace("ROWS", str(N)),
        weight("rest", 0.7 * rows[:, :3]),
        weight("others", rows[:, 3:]),
        weight("plane", plane.astype(np.float32)),
    )
    manifest = replace(manifest_of(N), bounds=Bounds((-2,) * 3, (2,) * 3))
    return save(tmp_path_factory.mktemp("culled") / "culled.onnx", proto, manifest)


@pytest.fixture(scope="module")
def rewritten(source: Path) -> RewriteResult:
    return rewrite_file(source, source.with_name("rewritten.onnx"), WEBGPU)


def frames(path: Path) -> list[list[np.ndarray]]:
    session = onnxruntime.InferenceSession(path.read_bytes())
    times = (np.array([t], np.float32) for t in (0.0, 0.4, 1.0))
    return [session.run(None, {"time": t}) for t in times]


def test_rewritten_mask_model_has_no_capture_obstacle(
    source: Path, rewritten: RewriteResult
) -> None:
    assert len(rewritten.before.uncaptured) >= 2
    assert rewritten.after.uncaptured == ()
    done = {change.rewrite for change in rewritten.changes}
    assert {"unroll-control-flow", "mask-rows", "restore-guards"} <= done
    assert rewritten.path is not None
    counts = [int(frame[2][0]) for frame in frames(source)]
    assert N > counts[0] > counts[1] > counts[2] == 0
    for old, new in zip(frames(source), frames(rewritten.path), strict=True):
        (k,) = old[2]
        np.testing.assert_array_equal(new[2], old[2])
        for before, after in zip(old[:2], new[:2], strict=True):
            assert len(after) == N
            np.testing.assert_allclose(after[:k], before, rtol=1e-5, atol=1e-6)
            assert not after[k:].any()


@pytest.mark.parametrize("half", [False, True])
def test_masked_model_is_captured_and_replayed_live(rewritten: RewriteResult, half: bool) -> None:
    path = rewritten.path
    assert path is not None
    if half:
        result = write_float16(path, path.with_name("half.onnx"))
        assert result.converted_count > len(result.retained)
        assert result.path is not None
        path = result.path
    report = validate(path, Settings(level=Level.LIVE, target=WEBGPU))
    assert_captured(report)
    assert report.verdict == "conforms", report.findings
