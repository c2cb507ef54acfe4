"""Masked rows of static shape: the kept rows are the same, in order, and the others are zero."""

import warnings

import numpy as np
import onnx
import onnx_ir as ir
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.sdk.passes.rows.mask_rows import MaskRows
from gsgen.sdk.passes.simplify.fold_shapes import FoldShapes
from support.passes import operators, parsed, run, text_of

DYNAMIC = {"NonZero", "Compress", "ScatterND", "Shape", "ConstantOfShape", "Range"}
N = 11

HEAD = f"g (float[{N},4] x, float[1] t) => (float[K,4] y, int32[1] count)"
WEIGHTS = "<int64[1] one = {1}, int64[1] zero = {0}, int64 first = {0}, int64 second = {1}, int64[3] cube = {-1, 2, 2}, float[2,2] pair = {1, 2, 3, 4}, int64[1] flat = {-1}, float two = {2}, int64[2] wide = {-1, 4}>"
MASK = "a = Gather <axis = 1> (x, first)\n m = Greater (a, t)\n"
COUNT = "mi = Cast <to = 6> (m)\n ks = ReduceSum <keepdims = 0> (mi)\n count = Reshape (ks, flat)\n"
SELECTION_FORMS = {
    "Compress": "r = Compress <axis = 0> (x, m)",
    "NonZero and GatherND": "i = NonZero (m)\n j = Transpose <perm = [1, 0]> (i)\n r = GatherND (x, j)",
    "NonZero and Gather": "i = NonZero (m)\n j = Squeeze (i, zero)\n r = Gather (x, j)",
    "NonZero, reshaped": "i = NonZero (m)\n j = Reshape (i, flat)\n r = Gather (x, j)",
    "NonZero of its first row": "i = NonZero (m)\n j = Gather (i, first)\n r = Gather (x, j)",
}
ROW_WISE_BODIES = {
    "nothing": "y = Identity (r)",
    "elementwise": "s = Sigmoid (r)\n u = Mul (s, two)\n v = Add (u, t)\n y = Div (r, v)",
    "columns": "s, u = Split <axis = 1> (r, halves)\n y = Concat <axis = 1> (u, s)",
    "a product": "y = MatMul (r, square)",
    "sums along columns": "s = ReduceSum <keepdims = 1> (r, one)\n y = Div (r, s)",
    "axes": "s = Unsqueeze (r, one)\n u = Transpose <perm = [1, 0, 2]> (s)\n v = Squeeze (u, zero)\n y = Reshape (v, wide)",
    "a width that is a shape": "s = Shape <start = 1> (r)\n o = Expand (two, s)\n y = Mul (r, o)",
    "softmax": "y = Softmax <axis = 1> (r)",
}


def masked(selection: str, following_text: str, count: str = COUNT) -> ir.Model:
    weights = WEIGHTS.replace(
        ">",
        ", int64[2] halves = {1, 3}, float[4,4] square = {"
        + ", ".join(str(k % 5) for k in range(16))
        + "}>",
    )
    return parsed(f"{HEAD} {weights} {{ {MASK} {selection}\n {following_text}\n {count} }}")


def inputs(seed: int, t: float) -> dict[str, np.ndarray]:
    x = np.random.default_rng(seed).normal(size=(N, 4)).astype(np.float32)
    return {"x": x, "t": np.array([t], np.float32)}


def assert_same_rows(before: list[np.ndarray], after: list[np.ndarray]) -> None:
    *rows, count = before
    *padded, actual = after
    np.testing.assert_array_equal(actual, count)
    (k,) = count
    for first, other in zip(rows, padded, strict=True):
        assert other.shape == (N, *first.shape[1:])
        np.testing.assert_array_equal(other[:k], first)
        np.testing.assert_array_equal(other[k:], 0)


@pytest.mark.parametrize("selection", SELECTION_FORMS)
@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 10**6), t=st.sampled_from([-9.0, -0.5, 0.0, 1.0, 9.0]))
def test_every_form_of_taking_rows_gives_them_in_order(selection: str, seed: int, t: float) -> None:
    model = masked(SELECTION_FORMS[selection], ROW_WISE_BODIES["elementwise"])
    fed = inputs(seed, t)
    before = run(model, **fed)
    rewrite = MaskRows()
    assert rewrite(model).modified, rewrite.refusals
    assert not operators(model) & DYNAMIC
    assert list(model.graph.outputs[0].shape) == [N, 4]
    assert_same_rows(before, run(model, **fed))


@pytest.mark.parametrize("following_text", ROW_WISE_BODIES)
def test_rows_pass_through_row_wise_operators(following_text: str) -> None:
    model = masked(SELECTION_FORMS["NonZero and GatherND"], ROW_WISE_BODIES[following_text])
    fed = inputs(3, 0.1)
    before = run(model, **fed)
    rewrite = MaskRows()
    assert rewrite(model).modified, rewrite.refusals
    assert not operators(model) & DYNAMIC
    assert_same_rows(before, run(model, **fed))


@pytest.mark.parametrize("n", [1, 2, 3, 7, 8, 9, 64])
def test_the_order_is_right_at_every_size(n: int) -> None:
    text = f"""g (bool[{n}] m, float[{n}] x) => (float[K] y, int64[1] count) <int64[1] flat = {{-1}}> {{
        y = Compress <axis = 0> (x, m)
        s = Shape (y)
        count = Identity (s) }}"""
    rng = np.random.default_rng(n)
    model = parsed(text)
    rewrite = MaskRows()
    assert rewrite(model).modified, rewrite.refusals
    for share in (0, 0.2, 0.5, 1):
        m, x = rng.random(n) < share, rng.normal(size=n).astype(np.float32)
        actual, count = run(model, m=m, x=x)
        np.testing.assert_array_equal(actual, [*x[m], *np.zeros(n - m.sum())])
        np.testing.assert_array_equal(count, [m.sum()])


ONE_OF_EACH_ROW = """
g (float[11,3,2] x, int64[11] label) => (float[11,2] y, int32[1] count)
<int64[3] labels = {0, 1, 2}, int64[1] last = {-1}, float half = {0.5}, int64[2] shape = {11, 2},
 int64[1] zero = {0}, int64[1] one = {1}> {
    column = Unsqueeze (label, last)
    MASK
    columns = NonZero (m)
    places = Transpose <perm = [1, 0]> (columns)
    r = GatherND (x, places)
    y = Reshape (r, shape)
    size = Shape <start = 0, end = 1> (r)
    number = Squeeze (size)
    small = Cast <to = 6> (number)
    count = Expand (small, one)
}
"""
FIXED_COUNT_MASKS = {
    "one_hot": "e = Equal (column, labels)\n f = Cast <to = 1> (e)\n m = Greater (f, half)",
    "comparison": "m = Equal (labels, column)",
    # The graph does not prove that it is one of each row: rows are moved forward.
    "any other": "l = LessOrEqual (column, labels)\n s = GreaterOrEqual (column, labels)\n m = And (l, s)",
}


@pytest.mark.parametrize("name", FIXED_COUNT_MASKS)
def test_a_mask_that_selects_a_fixed_number_of_rows_gives_them_in_order(name: str) -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(11, 3, 2)).astype(np.float32)
    fed = {"x": x, "label": rng.integers(0, 3, 11)}
    model = parsed(ONE_OF_EACH_ROW.replace("MASK", FIXED_COUNT_MASKS[name]))
    before = run(model, **fed)
    assert MaskRows()(model).modified
    assert not operators(model) & DYNAMIC
    assert ("CumSum" in operators(model)) is (name == "any other")
    for first, other in zip(before, run(model, **fed), strict=True):
        np.testing.assert_array_equal(other, first)


def test_masked_rows_do_not_reach_the_output() -> None:
    model = masked(SELECTION_FORMS["Compress"], "s = Sqrt (r)\n y = Div (two, s)")
    x = np.array([[k - 5, 1, 1, 1] for k in range(N)], np.float32)
    x[:3, 2] = np.nan
    inputs = {"x": x, "t": np.zeros(1, np.float32)}
    before = run(model, **inputs)
    MaskRows()(model)
    after = run(model, **inputs)
    assert np.isfinite(after[0]).all()
    assert_same_rows(before, after)


@pytest.mark.parametrize("op", ["ReduceSum", "ReduceMean", "ReduceMax", "ReduceMin"])
@pytest.mark.parametrize(("axes", "kept_count"), [("zero", 1), ("zero", 0), ("both", 0)])
@pytest.mark.parametrize("t", [-9.0, 0.1, 9.0])
def test_rows_that_are_not_kept_take_no_part_in_sums(
    op: str, axes: str, kept_count: int, t: float
) -> None:
    text = f"g (float[{N},4] x, float[1] t) => (float z) <int64[1] zero = {{0}}, int64[2] both = {{0, 1}}, int64 first = {{0}}> {{ {MASK} r = Compress <axis = 0> (x, m)\n z = {op} <keepdims = {kept_count}> (r, {axes}) }}"
    text = text.replace(
        "(float z)",
        "(float[A,B] z)" if kept_count else "(float[A] z)" if axes == "zero" else "(float z)",
    )
    model = parsed(text)
    fed = inputs(4, t)
    (before,) = run(model, **fed)
    assert MaskRows()(model).modified
    assert not operators(model) & DYNAMIC
    np.testing.assert_allclose(run(model, **fed)[0], before, rtol=1e-5, atol=1e-6)


NESTED = {
    "NonZero and GatherND": "i = NonZero (m2)\n j = Transpose <perm = [1, 0]> (i)\n r = GatherND (r1, j)",
    "Compress": "r = Compress <axis = 0> (r1, m2)",
}


@pytest.mark.parametrize("selection", NESTED)
def test_a_mask_among_kept_rows_is_a_mask_of_both(selection: str) -> None:
    nested = f"r1 = Compress <axis = 0> (x, m)\n b = Gather <axis = 1> (r1, second)\n m2 = Greater (b, t)\n {NESTED[selection]}"
    model = masked(nested, "y = Neg (r)", "s = Shape <end = 1> (r)\n count = Cast <to = 6> (s)")
    fed = inputs(5, -0.3)
    before = run(model, **fed)
    assert 0 < before[1] < N
    rewrite = MaskRows()
    assert rewrite(model).modified, rewrite.refusals
    assert not operators(model) & DYNAMIC
    assert_same_rows(before, run(model, **fed))


MIXED_MASK_BODIES = {
    "places among kept rows looked up in a table": "r1 = Compress <axis = 0> (x, m)\n b = Gather <axis = 1> (r1, second)\n m2 = Less (b, t)\n i = NonZero (m2)\n j = Transpose <perm = [1, 0]> (i)\n y = GatherND (x, j)",
    "rows of one mask at the places of another": "b = Gather <axis = 1> (x, second)\n m2 = Greater (b, t)\n r1 = Compress <axis = 0> (x, m2)\n i = NonZero (m)\n j = Transpose <perm = [1, 0]> (i)\n y = ScatterND (x, j, r1)",
    "rows of two masks added": "b = Gather <axis = 1> (x, second)\n m2 = Greater (b, t)\n r1 = Compress <axis = 0> (x, m2)\n r2 = Compress <axis = 0> (x, m)\n y = Add (r1, r2)",
}


@pytest.mark.parametrize("name", MIXED_MASK_BODIES)
def test_rows_of_two_masks_are_not_mixed_up(name: str) -> None:
    model = masked(MIXED_MASK_BODIES[name], "")
    before = text_of(model)
    rewrite = MaskRows()
    assert not rewrite(model).modified
    assert rewrite.refusals
    assert text_of(model) == before


PRODUCTS = {
    "of matrices of each row": "a1 = Reshape (r, cube)\n y1 = MatMul (a1, a1)\n y = Reshape (y1, wide)",
    "by Einsum": "a1 = Reshape (r, cube)\n y1 = Einsum <equation = 'nij,nkj->nik'> (a1, a1)\n y = Reshape (y1, wide)",
    "with one matrix for all": "a1 = Reshape (r, cube)\n y1 = MatMul (a1, pair)\n y = Reshape (y1, wide)",
}


@pytest.mark.parametrize("name", PRODUCTS)
def test_per_row_matrix_products_are_masked(name: str) -> None:
    model = masked(SELECTION_FORMS["Compress"], PRODUCTS[name].replace("'", '"'))
    fed = inputs(6, 0.0)
    before = run(model, **fed)
    rewrite = MaskRows()
    assert rewrite(model).modified, rewrite.refusals
    after = run(model, **fed)
    (k,) = before[1]
    np.testing.assert_allclose(after[0][:k], before[0], rtol=1e-5, atol=1e-6)
    assert not after[0][k:].any()


UNSUPPORTED_BODIES = {
    "a product over the rows": ("s = ReduceProd <keepdims = 1> (r, zero)\n y = Add (r, s)", COUNT),
    "rows in another order": ("y = CumSum (r, first)", COUNT),
    "a count that is no count": ("y = Neg (r)", "count = Identity (eleven)"),
    "rows that index": ("q = Cast <to = 6> (r)\n y = GatherElements <axis = 0> (x, q)", COUNT),
}


@pytest.mark.parametrize("name", UNSUPPORTED_BODIES)
def test_operators_that_mix_rows_are_left_alone(name: str) -> None:
    following_text, count = UNSUPPORTED_BODIES[name]
    model = masked(SELECTION_FORMS["NonZero and GatherND"], following_text, count)
    if "eleven" in count:
        value = model.graph.outputs[1].producer().inputs[0]
        value.const_value = ir.tensor(np.array([N], np.int32), name="eleven")
        value.shape = ir.Shape([1])
        model.graph.register_initializer(value)
    before = text_of(model)
    rewrite = MaskRows()
    assert not rewrite(model).modified
    assert rewrite.refusals
    assert text_of(model) == before


@pytest.mark.parametrize("end", ["Mul (k0, onei)", "Add (k0, zeroi)", "Identity (k0)"])
def test_a_count_is_known_however_it_ends(end: str) -> None:
    """Outputs that Reshape makes are ended on Mul by one, which capture records."""
    count = (
        COUNT.replace("count =", "k0 =")
        + f"onei = Cast <to = 6> (one)\n zeroi = Cast <to = 6> (zero)\n count = {end}"
    )
    model = masked(SELECTION_FORMS["Compress"], "y = Neg (r)", count)
    FoldShapes()(model)
    fed = inputs(0, 0.2)
    before = run(model, **fed)
    assert MaskRows("count")(model).modified
    assert_same_rows(before, run(model, **fed))


def test_the_count_must_be_the_one_that_the_manifest_names() -> None:
    model = masked(SELECTION_FORMS["Compress"], "y = Neg (r)")
    assert not MaskRows("num_points")(model).modified
    assert MaskRows("count")(model).modified


def test_unsupported_mask_does_not_block_another() -> None:
    text = f"""g (float[{N},4] x, bool[{N}] m, bool[{N}] q) => (float[K,4] y, int64[1] count, float[4] z) <int64[1] zero = {{0}}> {{
        y = Compress <axis = 0> (x, m)
        count = Shape <end = 1> (y)
        r = Compress <axis = 0> (x, q)
        z = ReduceProd <keepdims = 0> (r, zero) }}"""
    model = parsed(text)
    rng = np.random.default_rng(0)
    inputs = {
        "x": rng.normal(size=(N, 4)).astype(np.float32),
        "m": rng.random(N) < 0.5,
        "q": rng.random(N) < 0.5,
    }
    y, count, z = run(model, **inputs)
    rewrite = MaskRows()
    assert rewrite(model).modified
    assert len(rewrite.refusals) == 1
    actual, number, same = run(model, **inputs)
    np.testing.assert_array_equal(actual[: len(y)], y)
    np.testing.assert_array_equal(number, count)
    np.testing.assert_array_equal(same, z)


# -- What torch exports


class Kept(torch.nn.Module):
    """Rows are taken and counted."""

    def forward(self, x: torch.Tensor, t: torch.Tensor) -> tuple[torch.Tensor, ...]:
        mask = x[:, 0] > t
        y = x[mask]
        y = torch.cat([y[:, :2] + t, torch.sigmoid(y[:, 2:3]), y[:, 3:]], dim=1)
        sh = (x[:, None, :] * torch.ones(1, 3, 1))[mask].reshape(-1, 12)
        return y, sh, mask.sum().reshape(1).to(torch.int32)


class Sized(torch.nn.Module):
    """The count is a shape."""

    def forward(self, x: torch.Tensor, t: torch.Tensor) -> tuple[torch.Tensor, ...]:
        y = x[torch.nonzero(x[:, 0] > t).squeeze(1)]
        return torch.cat([y, torch.ones(y.shape[0], 1)], dim=1), torch.tensor(
            [y.shape[0]], dtype=torch.int32
        )


class Filled(torch.nn.Module):
    """Rows are filled up to a capacity."""

    def forward(self, x: torch.Tensor, t: torch.Tensor) -> tuple[torch.Tensor, ...]:
        y = torch.exp(x[x[:, 0] > t])
        room = 14 - y.shape[0]
        return torch.cat([y, y.new_zeros(room, 4)]), torch.nn.functional.pad(
            y, (0, 0, 0, room), value=0.5
        )


class Written(torch.nn.Module):
    """Rows are changed where they are."""

    def forward(self, x: torch.Tensor, t: torch.Tensor) -> tuple[torch.Tensor, ...]:
        mask = x[:, 0] > t
        y = x.clone()
        y[mask] = torch.exp(y[mask]) * 2
        return (y,)


class Everything(torch.nn.Module):
    """All of these, in one graph: exporting is slow."""

    def forward(self, x: torch.Tensor, t: torch.Tensor) -> tuple[torch.Tensor, ...]:
        parts = (Kept(), Sized(), Filled(), Written())
        return tuple(value for part in parts for value in part(x, t))


@pytest.fixture(scope="module")
def exported() -> bytes:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            Everything(),
            (torch.randn(N, 4), torch.zeros(1)),
            dynamo=True,
            opset_version=18,
            verbose=False,
        )
    return program.model_proto.SerializeToString()


def test_masks_exported_by_torch_are_recognised(exported: bytes) -> None:
    model = ir.serde.deserialize_model(onnx.ModelProto.FromString(exported))
    assert operators(model) & DYNAMIC
    rewrite = MaskRows()
    assert rewrite(model).modified, rewrite.refusals
    assert not rewrite.refusals
    assert not operators(model) & DYNAMIC
    for seed, t in ((0, 0.0), (1, -5.0), (2, 5.0)):
        fed = inputs(seed, t)
        expected_rows = Everything()(*(torch.tensor(v) for v in fed.values()))
        outputs = run(model, **fed)
        assert [len(entry) for entry in outputs] == [N, N, 1, N, 1, 14, 14, N]
        for first, other in zip(outputs, expected_rows, strict=True):
            np.testing.assert_allclose(first[: len(other)], other.numpy(), rtol=1e-6)
            np.testing.assert_array_equal(first[len(other) :], 0)
