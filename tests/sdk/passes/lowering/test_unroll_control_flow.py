"""Control flow written out gives every bit that ONNX Runtime's own gives."""

import numpy as np
import pytest

from gsgen.sdk.passes.lowering.unroll_control_flow import UnrollControlFlow
from support.passes import operators, parsed, run, text_of

LOOP = """
g (float[2] x, float[2] s) => (float[2] y, float[T,2] seen)
<int64 trips = {TRIPS}, bool go = {1}, bool stop = {0}> {
    y, seen = Loop (trips, START) <body = b (int64 i, bool c, float[2] v) => (bool on, float[2] w, float[2] kept)
    <float half = {0.5}> {
        on = Identity (ON)
        f = Cast <to = 1> (i)
        a = Mul (v, half)
        b1 = Add (a, f)
        w = Add (b1, s)
        kept = Identity (v)
    }>
}
"""


def loop(trips: int, start: str = "go", on: str = "c") -> str:
    text = LOOP.replace("TRIPS", str(trips)).replace("ON)", f"{on})")
    return text.replace("START", f"{start}, x")


def inputs(seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {name: rng.normal(size=2).astype(np.float32) for name in ("x", "s")}


@pytest.mark.parametrize(
    ("trips", "start", "on", "turns"),
    [(3, "go", "c", 3), (1, "go", "c", 1), (5, "", "go", 5), (4, "go", "stop", 1)],
)
def test_a_loop_of_known_length_is_a_chain(trips: int, start: str, on: str, turns: int) -> None:
    model = parsed(loop(trips, start, on))
    values = inputs()
    before = run(model, **values)
    assert len(before[1]) == turns
    assert UnrollControlFlow()(model).modified
    assert "Loop" not in operators(model)
    for actual, expected in zip(run(model, **values), before, strict=True):
        np.testing.assert_array_equal(actual, expected)


def test_a_loop_that_never_runs_hands_its_state_through() -> None:
    model = parsed(
        "g (float[2] x) => (float[2] y) <int64 trips = {0}> { y = Loop (trips, , x)"
        " <body = b (int64 i, bool c, float[2] v) => (bool on, float[2] w)"
        " { on = Identity (c)\n w = Neg (v) }> }"
    )
    UnrollControlFlow()(model)
    x = np.array([1, 2], np.float32)
    np.testing.assert_array_equal(run(model, x=x)[0], x)


def test_loops_in_loops_and_in_branches_are_written_out() -> None:
    text = """
    g (float[2] x) => (float[2] y) <int64 two = {2}, int64 three = {3}, bool yes = {1}> {
        y = If (yes) <then_branch = t () => (float[2] u) {
            u = Loop (two, , x) <body = o (int64 i, bool c, float[2] v) => (bool on, float[2] w) {
                on = Identity (c)
                w = Loop (three, c, v) <body = n (int64 j, bool d, float[2] p) => (bool e, float[2] q) {
                    e = Identity (d)
                    k = Add (i, j)
                    f = Cast <to = 1> (k)
                    q = Add (p, f)
                }>
            }>
        }, else_branch = e () => (float[2] r) { r = Neg (x) }>
    }"""
    model = parsed(text)
    x = np.array([0.5, -3], np.float32)
    (before,) = run(model, x=x)
    rewrite = UnrollControlFlow()
    assert rewrite(model).modified
    assert operators(model) <= {"Add", "Cast", "Identity"}
    np.testing.assert_array_equal(run(model, x=x)[0], before)
    assert not rewrite(model).modified


@pytest.mark.parametrize("cond", [True, False])
def test_the_branch_of_a_known_condition_stands_alone(cond: bool) -> None:
    text = f"""g (float[2] x) => (float[2] y) <bool c = {{{int(cond)}}}> {{
        y = If (c) <then_branch = t () => (float[2] u) <float two = {{2}}> {{ u = Mul (x, two) }},
                    else_branch = e () => (float[2] v) {{ v = Identity (x) }}> }}"""
    model = parsed(text)
    x = np.array([1, -4], np.float32)
    (before,) = run(model, x=x)
    assert UnrollControlFlow()(model).modified
    assert [value.name for value in model.graph.outputs] == ["y"]
    np.testing.assert_array_equal(run(model, x=x)[0], before)


@pytest.mark.parametrize("backwards", [0, 1])
@pytest.mark.parametrize("axis", [0, 1, -1])
def test_a_scan_takes_and_gives_along_its_axes(axis: int, backwards: int) -> None:
    shape = "3,2" if axis == 0 else "2,3"
    text = f"""
    g (float[2] x, float[{shape}] rows) => (float[2] y, float[A,B] seen) {{
        y, seen = Scan (x, rows) <num_scan_inputs = 1, scan_input_axes = [{axis}],
            scan_input_directions = [{backwards}], scan_output_axes = [{axis}],
            scan_output_directions = [{1 - backwards}],
            body = b (float[2] v, float[2] row) => (float[2] w, float[2] made) {{
                w = Add (v, row)
                made = Mul (w, row)
            }}>
    }}"""
    model = parsed(text)
    rng = np.random.default_rng(1)
    inputs = {"x": rng.normal(size=2), "rows": rng.normal(size=sizes_of(shape))}
    inputs = {name: array.astype(np.float32) for name, array in inputs.items()}
    before = run(model, **inputs)
    assert UnrollControlFlow()(model).modified
    assert "Scan" not in operators(model)
    for actual, expected in zip(run(model, **inputs), before, strict=True):
        np.testing.assert_array_equal(actual, expected)


def sizes_of(text: str) -> tuple[int, ...]:
    return tuple(int(size) for size in text.split(","))


UNSUPPORTED_LOOPS = {
    "its end depends on data that differ between frames": (
        "g (float[2] x, bool go) => (float[2] y) <int64 n = {3}> { y = Loop (n, , x)"
        " <body = b (int64 i, bool c, float[2] v) => (bool on, float[2] w)"
        " { on = Identity (go)\n w = Neg (v) }> }"
    ),
    "its trip count differs between frames": (
        "g (float[2] x, int64 n) => (float[2] y) { y = Loop (n, , x)"
        " <body = b (int64 i, bool c, float[2] v) => (bool on, float[2] w)"
        " { on = Identity (c)\n w = Neg (v) }> }"
    ),
    "its condition differs between frames": (
        "g (float[2] x, bool c) => (float[2] y) { y = If (c)"
        " <then_branch = t () => (float[2] u) { u = Neg (x) },"
        " else_branch = e () => (float[2] v) { v = Abs (x) }> }"
    ),
    "300 iterations": loop(300),
    "no shape": loop(0),
    "length of its scanned inputs": (
        "g (float[2] x, float[N,2] rows) => (float[2] y) { y = Scan (x, rows)"
        " <num_scan_inputs = 1, body = b (float[2] v, float[2] row) => (float[2] w)"
        " { w = Add (v, row) }> }"
    ),
}


@pytest.mark.parametrize("reason", UNSUPPORTED_LOOPS)
def test_unknown_or_long_loops_are_left_alone(reason: str) -> None:
    model = parsed(UNSUPPORTED_LOOPS[reason])
    before = text_of(model)
    rewrite = UnrollControlFlow()
    assert not rewrite(model).modified
    assert reason in rewrite.refusals[0].reason
    assert text_of(model) == before


def test_the_number_of_nodes_is_limited_too() -> None:
    model = parsed(loop(3))
    rewrite = UnrollControlFlow(nodes=17)
    assert not rewrite(model).modified
    assert "18 nodes" in rewrite.refusals[0].reason
    assert UnrollControlFlow(nodes=18)(model).modified
