"""Numbers with as many axes as their tensor: the same bits, and no element-wise broadcast."""

import numpy as np
import pytest

from gsgen.sdk.passes.rows.widen_numbers import WidenNumbers
from support.passes import parsed, run

OPERATORS = ("Add", "Sub", "Mul", "Div", "Max", "Min", "Equal", "Greater", "LessOrEqual")


@pytest.mark.parametrize("operator", OPERATORS)
@pytest.mark.parametrize("is_first", [False, True])
@pytest.mark.parametrize("number", ["constant", "computed"])
def test_an_operator_with_a_number_keeps_every_bit(
    operator: str, is_first: bool, number: str
) -> None:
    kind = "bool" if operator in ("Equal", "Greater", "LessOrEqual") else "float"
    operand = "c" if number == "constant" else "t"
    pair = f"{operand}, x" if is_first else f"x, {operand}"
    model = parsed(
        f"g (float[1500,4,1] x, float[1] t) => ({kind}[1500,4,1] y) <float c = {{0.3}}>"
        f" {{ y = {operator} ({pair}) }}"
    )
    x = np.random.default_rng(0).normal(size=(1500, 4, 1)).astype(np.float32)
    x.reshape(-1)[:5] = [np.nan, np.inf, -np.inf, -0.0, 0.3]
    inputs = {"x": x, "t": np.array([-0.7], np.float32)}
    (before,) = run(model, **inputs)
    assert WidenNumbers()(model).modified
    ranks = {len(value.shape) for node in model.graph for value in node.inputs if value.name != "t"}
    assert 3 in ranks
    (after,) = run(model, **inputs)
    np.testing.assert_array_equal(after.view(np.uint8), before.view(np.uint8))
    assert not WidenNumbers()(model).modified


@pytest.mark.parametrize(
    "text",
    [
        "g (float[5000,3] x) => (float[5000,3] y) <float c = {2}> { y = Mul (x, c) }",
        "g (float[50,1] x) => (float[50,1] y) <float c = {2}> { y = Mul (x, c) }",
        "g (float[5000,1] x) => (float[5000,1] y) <float[1,1] c = {2}> { y = Mul (x, c) }",
        "g (float[N,1] x) => (float[N,1] y) <float c = {2}> { y = Mul (x, c) }",
    ],
)
def test_numbers_that_cost_nothing_are_left_alone(text: str) -> None:
    assert not WidenNumbers()(parsed(text)).modified
