"""float16 with a list of nodes to keep that is measured: positions stay, colours go."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnx_ir as ir
import onnxruntime
import pytest
import typer
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.cli.commands.exporting.float16 import float16
from gsgen.contract.spec.manifest import Bounds, Tolerances
from gsgen.contract.validator import validate
from gsgen.sdk.errors import RewriteFailed
from gsgen.sdk.float16.convert_model import write_float16
from gsgen.sdk.float16.instrumented_model import InstrumentedModel
from gsgen.sdk.float16.sensitivity_search import max_quantizable
from gsgen.sdk.float16.to_float16 import Boundary, ToFloat16, node_key
from gsgen.sdk.float16.weight_tables import half_table
from support.commands import gsgen_here
from support.models.small_models import manifest_of, model, save, weight
from support.passes import HEAD, parsed, run

N = 40
TEXT = """
cloud (float[1] time) => (float[40,10] gaussians, float[40,3] color, int32[1] num_points)
<float one = {1}, float tenth = {0.1}, int64[1] last = {1}, float tiny = {1e-12}, float half = {0.5}> {
    step = Mul (time, velocity)
    far = Add (rest, origin)
    moved = Add (far, step)
    position = Sub (moved, origin)
    slow = Mul (time, tenth)
    growth = Add (slow, one)
    covariance = Mul (sigma, growth)
    opacity = Sigmoid (logit)
    gaussians = Concat <axis = 1> (position, opacity, covariance)
    squares = Mul (step, step)
    sum = ReduceSum (squares, last)
    safe = Max (sum, tiny)
    length = Sqrt (safe)
    direction = Div (step, length)
    feature = Concat <axis = 1> (direction, extra)
    hidden = MatMul (feature, first)
    active = Relu (hidden)
    raw = MatMul (active, second)
    color = Sigmoid (raw)
    num_points = Identity (live)
}
"""


def cloud(origin: float = 0.0, scale: float = 1.0) -> onnx.ModelProto:
    rng = np.random.default_rng(0)
    arrays = {
        "rest": rng.uniform(-1, 1, (N, 3)),
        "origin": np.full(3, origin),
        "velocity": rng.normal(0, 0.01, (N, 3)),
        "sigma": np.tile([0.01, 0, 0, 0.01, 0, 0.01], (N, 1)) * scale,
        "logit": rng.normal(size=(N, 1)),
        "extra": rng.normal(size=(N, 5)),
        "first": rng.normal(0, 0.3, (8, 16)),
        "second": rng.normal(0, 0.3, (16, 3)),
    }
    weights = [weight(name, array.astype(np.float32)) for name, array in arrays.items()]
    return model(TEXT, *weights, weight("live", np.array([N], np.int32)))


def saved(folder: Path, proto: onnx.ModelProto, **changes: object) -> Path:
    manifest = replace(manifest_of(N), bounds=Bounds((-2,) * 3, (2,) * 3), **changes)
    return save(folder / "cloud.onnx", proto, manifest)


def frames(path: Path) -> list[list[np.ndarray]]:
    session = onnxruntime.InferenceSession(path.read_bytes())
    times = (np.array([t], np.float32) for t in (0.0, 0.3, 1.0))
    return [session.run(None, {"time": t}) for t in times]


def test_colours_become_float16_and_positions_stay(tmp_path: Path) -> None:
    """Around 500 units from the origin float16 is half a unit coarse; a colour is not there."""
    source = saved(tmp_path, cloud(origin=500))
    result = write_float16(source, tmp_path / "half.onnx")
    retained = {group.node: group.reason for group in result.retained}
    assert {"moved", "position"} <= retained.keys()  # far is computed once, in float32
    assert retained["moved"] == "position"
    assert not {"hidden", "raw", "color", "opacity", "active"} & retained.keys()
    assert {"safe", "length", "direction"} <= retained.keys()
    assert "guard" in retained["safe"]
    assert result.parity.holds
    assert {field.field for field in result.parity.fields} == {
        "position",
        "covariance",
        "opacity",
        "appearance",
    }
    assert result.bytes_after < 0.8 * result.bytes_before
    assert result.outputs_after == result.outputs_before // 2
    for old, new in zip(frames(source), frames(tmp_path / "half.onnx"), strict=True):
        assert [array.dtype for array in new] == [np.float16, np.float16, np.int32]
        sigma = np.sqrt(old[0][:, 4:5])
        off = np.abs(new[0][:, :3] - old[0][:, :3]) / sigma
        assert off.max() < 1e-3 + 2**-11 / sigma.min()  # that of storage alone
        np.testing.assert_allclose(new[1][:, :3], old[1], atol=4e-3)
        assert np.isfinite(new[1]).all()  # at time zero too, where the length is zero
    report = validate(tmp_path / "half.onnx")
    assert report.verdict == "conforms", report.findings


def test_outputs_can_stay_float32(tmp_path: Path) -> None:
    source = saved(tmp_path, cloud(origin=500))
    result = write_float16(source, tmp_path / "half.onnx", outputs=False)
    assert result.outputs_after == result.outputs_before
    for old, new in zip(frames(source), frames(tmp_path / "half.onnx"), strict=True):
        assert [array.dtype for array in new] == [array.dtype for array in old]
        np.testing.assert_allclose(new[0][:, :3], old[0][:, :3], atol=2e-4)


def test_overflowing_nodes_stay_float32(tmp_path: Path) -> None:
    """Squares beyond 65,504 are infinite in float16, though their root is not."""
    text = TEXT.replace(
        "opacity = Sigmoid (logit)",
        "warm = Mul (logit, growth)\n big = Mul (warm, thousand)\n q = Mul (big, big)\n"
        " w = Sqrt (q)\n back = Div (w, thousand)\n opacity = Sigmoid (back)",
    )
    text = text.replace("float half", "float thousand = {1000}, float half")
    proto = cloud()
    changed = model(text, *[w for w in proto.graph.initializer if w.name in _WEIGHTS])
    result = write_float16(saved(tmp_path, changed), None)
    assert {"q", "w"} & {group.node for group in result.retained if group.reason == "opacity"}
    assert result.path is None


_WEIGHTS = ("rest", "origin", "velocity", "sigma", "logit", "extra", "first", "second", "live")


def test_looser_tolerances_retain_fewer_nodes(tmp_path: Path) -> None:
    source = saved(tmp_path, cloud())
    strict_result = write_float16(source, None, tolerances=Tolerances(1e-3, 1e-3, 1e-5, 1e-5))
    loose_result = write_float16(source, None, tolerances=Tolerances(1, 1, 1, 1))
    assert len(loose_result.retained) < len(strict_result.retained)
    assert {group.reason for group in loose_result.retained} <= {
        "a guard that float16 makes zero",
        "between a guard and its division",
        "saves Casts",
    }


def test_deciding_comparisons_stay_float32(tmp_path: Path) -> None:
    """Which rows are opaque must not flip between two probes."""
    text = TEXT.replace(
        "opacity = Sigmoid (logit)",
        "shown = Greater (logit, time)\n opacity = Where (shown, half, tenth)",
    )
    weights = [w for w in cloud().graph.initializer if w.name in _WEIGHTS]
    result = write_float16(saved(tmp_path, model(text, *weights)), None)
    assert {group.node: group.reason for group in result.retained}["shown"] == "it decides"


def test_outputs_that_float16_cannot_hold_are_refused(tmp_path: Path) -> None:
    source = saved(tmp_path, cloud(scale=1e7))
    with pytest.raises(RewriteFailed, match="float16 outputs alone"):
        write_float16(source, tmp_path / "half.onnx")
    assert not (tmp_path / "half.onnx").exists()


def test_a_model_without_a_manifest_is_refused(tmp_path: Path) -> None:
    source = save(tmp_path / "bare.onnx", cloud())
    with pytest.raises(RewriteFailed, match="no manifest"):
        write_float16(source, None)


# -- The conversion alone


CHAIN = """g (float[3] x) => (float[3] y) <float[3] w = {0.1, 0.2, 0.3}, float two = {2}> {
    a = Mul (x, w)
    b = Add (a, w)
    c = Sin (b)
    d = Mul (c, two)
    s = Shape (d)
    y = Div (d, w)
}"""


@settings(max_examples=12, deadline=None)
@given(kept_names=st.sets(st.sampled_from("abcdy")), outputs=st.booleans())
def test_every_choice_of_nodes_gives_a_sound_model(kept_names: set[str], outputs: bool) -> None:
    model_ = parsed(CHAIN)
    x = np.array([0.5, -1, 2], np.float32)
    (before,) = run(model_, x=x)
    expected = Boundary(model_.graph, 18).casts(kept_names)
    ToFloat16(kept_names, outputs=outputs)(model_)
    (after,) = run(model_, x=x)
    assert after.dtype == (np.float16 if outputs else np.float32)
    np.testing.assert_allclose(after, before, rtol=2e-2, atol=2e-2)
    casts = [node for node in model_.graph if node.op_type == "Cast"]
    is_output_cast = (outputs and "y" in kept_names) or (not outputs and "y" not in kept_names)
    assert len(casts) == expected + is_output_cast
    by_name = {node_key(node): node for node in model_.graph}
    for name in kept_names - {"y"}:
        assert by_name[name].outputs[0].dtype == ir.DataType.FLOAT
    for name in set("abcd") - kept_names:
        assert by_name[name].outputs[0].dtype == ir.DataType.FLOAT16


def test_operators_without_float16_stay_float32() -> None:
    text = """g (float[1,1,2,2] x) => (float[1,1,4,4] y) <float[4] s = {1, 1, 2, 2}, float a = {0}, float n = {3}, float one = {1}> {
        r = Range (a, n, one)
        t = ReduceSum <keepdims = 0> (r)
        z = Mul (x, t)
        y = Resize <mode = "nearest"> (z, , s)
    }"""
    model_ = parsed(text)
    x = np.arange(4, dtype=np.float32).reshape(1, 1, 2, 2)
    (before,) = run(model_, x=x)
    ToFloat16()(model_)
    (after,) = run(model_, x=x)
    np.testing.assert_array_equal(after, before)
    assert model_.graph.initializers["s"].dtype == ir.DataType.FLOAT


def test_results_with_input_dependent_dtype_keep_their_declaration() -> None:
    text = """g (float[3] x) => (float[3] y) <float two = {2}> {
        n = RandomUniformLike <seed = 1.0> (x)
        m = Mul (n, two)
        y = Sub (m, m) }"""
    model_ = parsed(text)
    ToFloat16()(model_)
    (visible_mask,) = run(model_, x=np.ones(3, np.float32))
    np.testing.assert_array_equal(visible_mask, np.zeros(3, np.float16))


def test_outputs_that_are_inputs_or_weights_are_converted() -> None:
    text = """g (float[2] x) => (float[2] w, float[2] y, float[2] x) <float[2] w = {0.5, 2}> {
        y = Mul (x, w) }"""
    model_ = ir.serde.deserialize_model(onnx.parser.parse_model(HEAD + text))
    rewrite = ToFloat16()
    rewrite(model_)
    assert [refusal.where for refusal in rewrite.refusals] == ["x"]
    assert [value.name for value in model_.graph.inputs] == ["x"]
    w, y, x = run(model_, x=np.array([3, 4], np.float32))
    np.testing.assert_array_equal(w, np.array([0.5, 2], np.float16))
    np.testing.assert_array_equal(y, np.array([1.5, 8], np.float16))
    np.testing.assert_array_equal(x, np.array([3, 4], np.float32))


def test_a_weight_may_be_called_like_the_copy_of_another() -> None:
    text = """g (float[2] x) => (float[2] y) <float[2] w = {0.5, 2}, float[2] w_float16 = {3, 4}> {
        a = Mul (x, w)
        b = Add (x, w)
        c = Mul (a, w_float16)
        y = Add (b, c) }"""
    model_ = parsed(text)
    x = np.array([1, 2], np.float32)
    (before,) = run(model_, x=x)
    ToFloat16(["b"])(model_)
    (after,) = run(model_, x=x)
    np.testing.assert_array_equal(after, before)


def test_bodies_stay_and_what_they_read_is_cast_for_them() -> None:
    text = """g (float[2] x, bool c) => (float[2] y) <float two = {2}> {
        a = Mul (x, two)
        b = If (c) <then_branch = t () => (float[2] u) { u = Add (a, two) },
                    else_branch = e () => (float[2] v) { v = Neg (a) }>
        y = Mul (b, two) }"""
    model_ = parsed(text)
    x = np.array([1, 2], np.float32)
    before = [run(model_, x=x, c=np.array(c))[0] for c in (True, False)]
    ToFloat16()(model_)
    after = [run(model_, x=x, c=np.array(c))[0] for c in (True, False)]
    np.testing.assert_array_equal(after, before)


# -- Measuring


def test_the_measuring_model_rounds_as_float16_does() -> None:
    half = InstrumentedModel(parsed(CHAIN))
    assert half.units == tuple("abcdy")
    x = np.array([0.5, -3, 2], np.float32)
    w = np.array([0.1, 0.2, 0.3], np.float32)
    nothing = half.run({"x": x}, np.zeros(5, np.bool_))["y"]
    np.testing.assert_array_equal(nothing, 2 * np.sin(x * w + w) / w)

    def r(value: np.ndarray) -> np.ndarray:
        return np.asarray(value).astype(np.float16).astype(np.float32)

    flags = np.array([True, False, False, True, False])
    actual = half.run({"x": x}, flags)["y"]
    a = r(r(x) * r(w))
    np.testing.assert_allclose(actual, r(r(np.sin(a + w)) * 2) / w, rtol=1e-6)


def test_measuring_model_flushes_subnormals_and_overflows() -> None:
    half = InstrumentedModel(
        parsed("g (float[3] x) => (float[3] y) <float one = {1}> { y = Mul (x, one) }")
    )
    x = np.array([3e-5, 7e-5, 1e5], np.float32)
    visible_mask = half.run({"x": x}, np.ones(1, np.bool_))["y"]
    np.testing.assert_array_equal(visible_mask, [0, np.float32(np.float16(7e-5)), np.inf])


@settings(max_examples=60, deadline=None)
@given(
    costs=st.lists(st.sampled_from([0.0, 1e-4, 0.1, 0.3, 0.6, 2.0, np.inf]), max_size=40),
    budget=st.integers(4, 300),
)
def test_search_quantizes_only_nodes_within_tolerance(costs: list[float], budget: int) -> None:
    """Costs that add up stand for errors that do."""

    def measure(units: object) -> tuple[float, str]:
        return sum(costs[unit] for unit in units), "position"

    actual = max_quantizable(range(len(costs)), measure, budget=budget)
    quantized = sum(costs[unit] for unit in actual.quantized)
    assert quantized <= 1
    retained = [unit for group in actual.retained for unit in group.units]
    assert sorted([*retained, *actual.quantized]) == list(range(len(costs)))
    if budget >= 300:
        remaining_costs = [costs[unit] for unit in retained]
        assert all(quantized + cost > 1 for cost in remaining_costs)


# -- The command


def test_command_lists_retained_nodes_and_reasons(tmp_path: Path) -> None:
    source = saved(tmp_path, cloud(origin=500))
    completed = gsgen_here("float16", source, "-o", tmp_path / "half.onnx")
    assert completed.code == 0, completed.err
    assert "float32 for position: " in completed.out
    assert "largest errors: position" in completed.out
    assert (tmp_path / "half.onnx").exists()


@pytest.mark.parametrize(
    ("name", "code", "expected_message"),
    [("bare.onnx", 1, "no manifest"), ("text.onnx", 4, "text.onnx"), ("none.onnx", 4, "none")],
)
def test_unconvertible_model_is_reported(
    tmp_path: Path, name: str, code: int, expected_message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    save(tmp_path / "bare.onnx", cloud())
    (tmp_path / "text.onnx").write_text("no model")
    with pytest.raises(typer.Exit) as exit_info:
        float16(tmp_path / name, tmp_path / "half.onnx", budget=200, timeout=120.0)
    assert exit_info.value.exit_code == code
    assert expected_message in capsys.readouterr().err
    assert not (tmp_path / "half.onnx").exists()


TABLES = """
cloud (float[1] time) => (float[40,10] gaussians, float[40,3] color, int32[1] num_points)
<float zero = {0}> {
    twice = Concat <axis = 0> (far, near)
    place = Gather <axis = 0> (twice, which)
    step = Mul (time, velocity)
    position = Add (place, step)
    opacity = Sigmoid (logit)
    gaussians = Concat <axis = 1> (position, opacity, sigma)
    shade = Sigmoid (paint)
    dim = Mul (time, zero)
    color = Add (shade, dim)
    num_points = Identity (live)
}
"""


def test_tables_that_are_read_once_are_stored_in_float16_unless_that_shows(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    arrays = {
        "far": 400 + rng.uniform(-1, 1, (N, 3)),
        "near": rng.uniform(-1, 1, (N, 3)) / 64,
        "velocity": rng.normal(0, 0.01, (N, 3)),
        "sigma": np.tile([0.01, 0, 0, 0.01, 0, 0.01], (N, 1)),
        "logit": rng.normal(size=(N, 1)),
        "paint": rng.normal(size=(N, 3)),
    }
    weights = [weight(name, array.astype(np.float32)) for name, array in arrays.items()]
    index = np.arange(N, 2 * N, dtype=np.int32) - N * (np.arange(N) < 3)
    weights += [weight("live", np.array([N], np.int32)), weight("which", index)]
    source = saved(tmp_path, model(TABLES, *weights))
    path = tmp_path / "half.onnx"
    result = write_float16(source, path, outputs=False)
    assert [retained_weight.node for retained_weight in result.retained_weights] == ["far"]
    assert result.retained_weights[0].reason == "position"
    stored = {weight.name: weight.data_type for weight in onnx.load(path).graph.initializer}
    half = {name for name, kind in stored.items() if kind == onnx.TensorProto.FLOAT16}
    assert {"near", "paint", "logit"} <= half
    assert not {"far", "far_float16"} & half
    nodes = {node.output[0]: node for node in onnx.load(path).graph.node}
    assert nodes["place"].input[0] == "twice"  # what follows from weights stays float32
    for old, new in zip(frames(source), frames(path), strict=True):
        assert np.abs(new[0][:, :3] - old[0][:, :3]).max() < 1e-4
        np.testing.assert_allclose(new[1], old[1], atol=1e-3)


SIZES = """
cloud (float[1] time) => (float[700,10] gaussians, float[700,3] color, int32[1] num_points)
<float zero = {0}, int64[3] count = {700, 6, 6}, int64[1] last = {2}> {
    square = Mul (size, size)
    diagonal = Reshape (square, count)
    kept = ReduceMax <keepdims = 0> (diagonal, last)
    spread = Mul (kept, mask)
    rest = Mul (time, zero)
    covariance = Add (spread, rest)
    gaussians = Concat <axis = 1> (place, opacity, covariance)
    color = Add (paint, rest)
    num_points = Identity (live)
}
"""


def test_a_table_of_sizes_is_float16_where_even_steps_would_show(tmp_path: Path) -> None:
    """Steps are closer by the mean square, and make small sizes zero."""
    rng = np.random.default_rng(0)
    n = 700
    sizes = 10 ** rng.uniform(-3, 1, (n, 1)) * np.ones((1, 36))
    arrays = {
        "size": sizes,
        "mask": np.array([[1, 0, 0, 1, 0, 1]]),
        "place": rng.uniform(-1, 1, (n, 3)) * sizes[:, :1],
        "opacity": rng.uniform(0.1, 0.9, (n, 1)),
        "paint": rng.uniform(0, 1, (n, 3)),
    }
    weights = [weight(name, array.astype(np.float32)) for name, array in arrays.items()]
    proto = model(SIZES, *weights, weight("live", np.array([n], np.int32)))
    manifest = replace(manifest_of(n), bounds=Bounds((-10,) * 3, (10,) * 3))
    source = save(tmp_path / "sizes.onnx", proto, manifest)
    path = tmp_path / "half.onnx"
    result = write_float16(source, path, outputs=False, tolerances=Tolerances(1, 1e-2, 1, 1))
    assert half_table(arrays["size"].astype(np.float32)).step is not None
    stored = {weight.name: weight.data_type for weight in onnx.load(path).graph.initializer}
    assert stored["size"] == onnx.TensorProto.FLOAT16
    assert "size" not in {retained_weight.node for retained_weight in result.retained_weights}
    assert result.parity.holds
