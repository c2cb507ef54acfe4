"""Parts taken and put by Gather: the same bits as Slice, Split, GatherND and the scatters give."""

from collections.abc import Sequence

import numpy as np
import onnx_ir as ir
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.sdk.passes.indexing.gather_scatters import GatherScatters
from gsgen.sdk.passes.indexing.gather_slices import GatherSlices
from gsgen.sdk.passes.lowering.pick_parts import LowerSplitsToSlices
from support.passes import HEAD, operators, parsed, run, text_of


def list_text(*numbers: int) -> str:
    return "{" + ", ".join(map(str, numbers)) + "}"


def type_text(dims: Sequence[int] | str) -> str:
    """Write a type; a scalar has no brackets in ONNX text."""
    return f"float[{','.join(map(str, dims))}]" if dims else "float"


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    begin=st.integers(-8, 8),
    end=st.sampled_from([-(2**63), -9, -6, -5, -1, 0, 1, 3, 5, 6, 2**63 - 1]),
    step=st.sampled_from([-3, -2, -1, 1, 2, 3]),
    axis=st.sampled_from([0, 1, -1]),
)
def test_random_slices_become_gathers(begin: int, end: int, step: int, axis: int) -> None:
    text = (
        "g (float[5,6] x) => (float[A,B] y) "
        f"<int64[1] b = {list_text(begin)}, int64[1] e = {list_text(end)}, int64[1] a = {list_text(axis)}, "
        f"int64[1] s = {list_text(step)}> {{ n = Neg (x) m = Slice (n, b, e, a, s) y = Neg (m) }}"
    )
    model, x = parsed(text), np.arange(30, dtype=np.float32).reshape(5, 6)
    (before,) = run(model, x=x)
    ambiguous = step < 0 and end == 2**63 - 1  # the standard and ONNX Runtime disagree
    assert GatherSlices()(model).modified is not ambiguous
    assert ("Slice" in operators(model)) is ambiguous
    (after,) = run(model, x=x)
    assert after.shape == before.shape
    np.testing.assert_array_equal(after, before)


def test_a_slice_of_two_axes_or_of_no_named_ones_is_gathered() -> None:
    text = (
        "g (int32[4,5] x) => (int32[A,B] y) <int64[2] b = {1, 0}, int64[2] e = {3, 4}> "
        "{ y = Slice (x, b, e) }"
    )
    model, x = parsed(text), np.arange(20, dtype=np.int32).reshape(4, 5)
    assert GatherSlices()(model).modified
    np.testing.assert_array_equal(run(model, x=x)[0], x[1:3, :4])


@pytest.mark.parametrize(
    "text",
    [
        "g (float[5] x, int64[1] b) => (float[A] y) <int64[1] e = {3}> { y = Slice (x, b, e) }",
        "g (float[N] x) => (float[A] y) <int64[1] b = {0}, int64[1] e = {3}> { y = Slice (x, b, e) }",
        "g (float[5,2] x, int64[3,1] i) => (float[3,2] y) { y = GatherND (x, i) }",
        "g (float[2,3] x) => (float[2] y) <int64[2,1] i = {0, 1}> { y = GatherND <batch_dims = 1> (x, i) }",
    ],
)
def test_parts_that_only_a_frame_knows_are_left_alone(text: str) -> None:
    model = parsed(text)
    before = text_of(model)
    assert not GatherSlices()(model).modified
    assert text_of(model) == before


@pytest.mark.parametrize("opset", [11, 13, 18])
def test_a_split_becomes_slices_and_those_are_gathered_in_the_next_round(opset: int) -> None:
    inputs = ", split = [1, 0, 4]" if opset < 13 else ""
    weight, argument = ("", "") if opset < 13 else ("<int64[3] s = {1, 0, 4}>", ", s")
    text = (
        f"g (float16[2,5] x) => (float16[A,B] p, float16[C,D] q, float16[E,F] r) {weight} "
        f"{{ p, q, r = Split <axis = 1{inputs}> (x{argument}) }}"
    )
    model = parsed(text, HEAD.replace("18", str(opset)))
    x = np.arange(10, dtype=np.float16).reshape(2, 5)
    before = run(model, x=x)
    assert GatherSlices()(model).modified
    assert operators(model) == {"Slice"}
    for expected, actual in zip(before, run(model, x=x), strict=True):
        np.testing.assert_array_equal(actual, expected)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    shape=st.lists(st.integers(1, 4), min_size=1, max_size=4),
    rows=st.lists(st.integers(0, 3), max_size=2),
    depth=st.integers(1, 4),
    seed=st.integers(0, 99),
)
def test_a_gather_of_known_places_looks_into_one_axis(
    shape: list[int], rows: list[int], depth: int, seed: int
) -> None:
    rng, depth = np.random.default_rng(seed), min(depth, len(shape))
    indices = np.stack([rng.integers(-size, size, rows) for size in shape[:depth]], axis=-1)
    model = with_places(
        f"g ({type_text(shape)} x) => ({type_text('ABCDEFG'[: len(rows) + len(shape) - depth])} y)",
        "y = GatherND (x, places)",
        indices,
    )
    x = rng.normal(size=shape).astype(np.float32)
    (before,) = run(model, x=x)
    assert GatherSlices()(model).modified
    assert "GatherND" not in operators(model)
    np.testing.assert_array_equal(run(model, x=x)[0], before)


def with_places(head: str, body: str, places: np.ndarray) -> ir.Model:
    """Parse a graph that reads ``places``, a weight that text cannot hold."""
    sizes = ",".join(map(str, places.shape))
    flat = ", ".join(str(int(number)) for number in places.reshape(-1))
    return parsed(f"{head} <int64[{sizes}] places = {{{flat}}}> {{ {body} }}")


# ---- Scatters --------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    shape=st.lists(st.integers(1, 4), min_size=1, max_size=4),
    rows=st.lists(st.integers(0, 3), max_size=2),
    depth=st.integers(1, 4),
    seed=st.integers(0, 99),
)
def test_a_scatter_of_known_rows_is_gathered(
    shape: list[int], rows: list[int], depth: int, seed: int
) -> None:
    rng, depth = np.random.default_rng(seed), min(depth, len(shape))
    indices = np.stack([rng.integers(-size, size, rows) for size in shape[:depth]], axis=-1)
    new = [*rows, *shape[depth:]]
    model = with_places(
        f"g ({type_text(shape)} x, {type_text(new)} u) => ({type_text(shape)} y)",
        "y = ScatterND (x, places, u)",
        indices,
    )
    x, u = (rng.normal(size=shape).astype(np.float32), rng.normal(size=new).astype(np.float32))
    copy = x.copy()
    for location in np.ndindex(*rows):
        copy[tuple(indices[location])] = u[location]
    assert GatherScatters()(model).modified
    assert "ScatterND" not in operators(model)
    np.testing.assert_array_equal(run(model, x=x, u=u)[0], copy)


@pytest.mark.parametrize("axis", [0, 1, -1])
@pytest.mark.parametrize("dtype", ["float", "int32", "bool"])
def test_a_scatter_of_known_elements_is_gathered(dtype: str, axis: int) -> None:
    places = np.array([[2, -1, 0], [1, 1, 1]])
    model = with_places(
        f"g ({dtype}[3,4] x, {dtype}[2,3] u) => ({dtype}[3,4] y)",
        f"y = ScatterElements <axis = {axis}> (x, places, u)",
        places,
    )
    rng = np.random.default_rng(1)
    kind = {"float": "float32"}.get(dtype, dtype)
    x, u = rng.integers(0, 9, (3, 4)).astype(kind), rng.integers(0, 9, (2, 3)).astype(kind)
    (before,) = run(model, x=x, u=u)
    assert GatherScatters()(model).modified
    if axis != 0:  # along the first axis two rows are put to one place: their order is open
        np.testing.assert_array_equal(run(model, x=x, u=u)[0], before)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            "g (float[3] x, int64[1,1] i, float[1] u) => (float[3] y) { y = ScatterND (x, i, u) }",
            "indices",
        ),
        (
            "g (float[N] x, float[1] u) => (float[N] y) <int64[1,1] i = {0}> { y = ScatterND (x, i, u) }",
            "shape",
        ),
        (
            "g (float[2,0] x, float[1,0] u) => (float[2,0] y) <int64[1,1] i = {0}> { y = ScatterND (x, i, u) }",
            "empty",
        ),
        (
            'g (float[3] x, float[1] u) => (float[3] y) <int64[1,1] i = {0}> { y = ScatterND <reduction = "add"> (x, i, u) }',
            "'add'",
        ),
    ],
)
def test_a_scatter_that_cannot_be_rewritten_says_why(text: str, reason: str) -> None:
    rewrite = GatherScatters()
    assert not rewrite(parsed(text)).modified
    assert reason in rewrite.refusals[0].reason


def test_a_scatter_in_a_branch_is_rewritten() -> None:
    text = (
        "g (bool c, float[3] x) => (float[3] y) <int64[1,1] i = {1}, float[1] u = {7}> { y = If (c) <"
        "then_branch = t () => (float[3] a) { a = ScatterND (x, i, u) }, "
        "else_branch = e () => (float[3] b) { b = Neg (x) }> }"
    )
    model = parsed(text)
    assert GatherScatters()(model).modified
    x = np.array([1, 2, 3], np.float32)
    assert run(model, c=np.array(True), x=x)[0].tolist() == [1, 7, 3]


@pytest.mark.parametrize("location", [4, -5])
def test_a_place_beyond_what_was_joined_is_left_to_the_runtime(location: int) -> None:
    text = (
        f"g (float[2] x, float[2] z) => (float[1] y) <int64[1] i = {{{location}}}> "
        "{ c = Concat <axis = 0> (x, z) y = Gather <axis = 0> (c, i) }"
    )
    assert not LowerSplitsToSlices()(parsed(text)).modified
