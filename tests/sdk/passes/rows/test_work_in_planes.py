"""Rows of a few numbers computed with the rows last: the same numbers, whatever is done to them."""

import numpy as np
import pytest

from gsgen.sdk.passes.rows import work_in_planes
from gsgen.sdk.passes.rows.work_in_planes import RewriteRowsToPlanes
from sdk.passes.rows.test_work_in_columns import ROWS, WEIGHTS
from support.passes import operators, parsed, run, text_of

CUBES = "j = Concat <axis = 1> (x, z, x) m = Reshape (j, cube) k = Exp (m) "
PLANES = {
    **ROWS,
    "product of matrices": (CUBES + "p = MatMul (m, k) y = Mul (p, p)", "N,A,B"),
    "product with a vector": (
        CUBES + "u = Unsqueeze (z, mid) p = MatMul (k, u) y = Squeeze (p, mid)",
        "N,A",
    ),
    "product of a row": (CUBES + "u = Unsqueeze (z, one) y = MatMul (u, k)", "N,A,B"),
    "outer product": (
        "u = Unsqueeze (z, mid) v = Unsqueeze (x, one) y = MatMul (u, v)",
        "N,A,B",
    ),
    "numbers of the frame": (
        "v = Mul (three, t) a = Mul (x, v) b = Mul (c, t) y = Sub (a, b)",
        "N,A",
    ),
    "power and product": ("p = Pow (x, two) q = ReduceProd <keepdims = 1> (p, last) y = Mul (q, z)", "N,A"),
    "mean": ("p = ReduceMean <keepdims = 1> (x, one) y = Sub (x, p)", "N,A"),
    "matrix turned and cut": (
        CUBES + "q = Transpose <perm = [0, 2, 1]> (k) s = Slice (q, one, far, mid) y = Mul (s, s)",
        "N,A,B",
    ),
}  # fmt: skip


def model_of(body: str, dims: str, rows: int = 5000):
    return parsed(
        f"g (float[{rows},3] x, float[{rows},3] z, float[{rows},1] c, float[1] t) => "
        f"(float[{dims}] y) {WEIGHTS.replace('70000', str(rows))} {{ {body} }}"
    )


def inputs(rows: int = 5000) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(5)
    sizes = {"x": (rows, 3), "z": (rows, 3), "c": (rows, 1), "t": (1,)}
    return {name: rng.normal(size=size).astype(np.float32) for name, size in sizes.items()}


@pytest.mark.parametrize("name", PLANES)
def test_planes_equal_rows(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work_in_planes, "_MAX_COST_RATIO", np.inf)
    model, values = model_of(*PLANES[name]), inputs()
    (before,) = run(model, **values)
    assert RewriteRowsToPlanes()(model).modified
    assert "MatMul" not in operators(model)
    assert model.graph.outputs[0].name == "y"
    (after,) = run(model, **values)
    assert after.shape == before.shape
    np.testing.assert_allclose(after, before, rtol=2e-5, atol=1e-5)


def test_planes_equal_float64_products() -> None:
    """An oracle of numpy, and not only the graph before."""
    model, values = model_of(*PLANES["product of matrices"]), inputs()
    assert RewriteRowsToPlanes()(model).modified
    (actual,) = run(model, **values)
    m = np.concatenate([values["x"], values["z"], values["x"]], 1).astype(np.float64)
    m = m.reshape(-1, 3, 3)
    np.testing.assert_allclose(actual, (m @ np.exp(m)) ** 2, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("seed", range(12))
def test_random_chains_keep_their_value(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Graphs of random operators on tensors of random rank, read inside and outside of the group."""
    monkeypatch.setattr(work_in_planes, "_MAX_COST_RATIO", np.inf)
    rng = np.random.default_rng(seed)
    body, known = "", [("x", 3), ("z", 3), ("c", 1)]
    for number in range(12):
        (a, width), (b, other) = (known[rng.integers(len(known))] for _ in range(2))
        name, kind = f"v{number}", rng.integers(5)
        if kind == 0 and (width == other or 1 in (width, other)):
            body += f"{name} = {rng.choice(['Add', 'Mul', 'Max'])} ({a}, {b}) "
            known.append((name, max(width, other)))
        elif kind == 1 and width + other <= 9:
            body += f"{name} = Concat <axis = 1> ({a}, {b}) "
            known.append((name, width + other))
        elif kind == 2:
            body += f"{name} = ReduceSum <keepdims = 1> ({a}, last) "
            known.append((name, 1))
        elif kind == 3 and width > 1:
            body += f"{name} = Slice ({a}, one, far, one) "
            known.append((name, min(width, 3) - 1))
        else:
            body += f"{name} = Tanh ({a}) "
            known.append((name, width))
    outputs = ", ".join(f"float[N,A{index}] {name}" for index, (name, _) in enumerate(known[-3:]))
    text = f"g (float[5000,3] x, float[5000,3] z, float[5000,1] c) => ({outputs}) {WEIGHTS} {{ {body} }}"
    model, values = parsed(text), inputs()
    del values["t"]
    before = run(model, **values)
    assert RewriteRowsToPlanes()(model).modified
    for expected, actual in zip(before, run(model, **values), strict=True):
        np.testing.assert_allclose(actual, expected, rtol=2e-5, atol=2e-5)


def test_pass_is_idempotent() -> None:
    model = model_of(*PLANES["product of matrices"])
    assert RewriteRowsToPlanes()(model).modified
    assert not RewriteRowsToPlanes()(model).modified


@pytest.mark.parametrize(
    ("body", "rows"),
    [
        ("y = Mul (x, z)", 5000),  # as fast as it is
        ("y = Concat <axis = 1> (x, c)", 5000),
        (PLANES["product of matrices"][0], 900),  # launches cost more
        (PLANES["product of matrices"][0], 70000),  # columns are faster
    ],
)
def test_rows_that_are_fast_enough_stay(body: str, rows: int) -> None:
    model = model_of(body, "N,A,B" if "MatMul" in body else "N,A", rows)
    before = text_of(model)
    assert not RewriteRowsToPlanes()(model).modified
    assert text_of(model) == before
