"""Weights that stand in a graph several times are held once, and nothing else is."""

from pathlib import Path

import numpy as np
import onnx_ir as ir
import pytest

from gsgen.sdk.passes.simplify.deduplicate_weights import DeduplicateWeights
from support.passes import parsed, run, text_of

DUPLICATE_WEIGHTS_TEXT = """
g (float[3] x) => (float[3] y) {
    a = Add (x, first)
    y = Mul (a, second)
}
"""


def with_weights(text: str, **arrays: np.ndarray) -> ir.Model:
    model = parsed(text)
    for name, array in arrays.items():
        tensor = ir.tensor(array, name=name)
        value = next(
            v for n in model.graph.all_nodes() for v in n.inputs if v is not None and v.name == name
        )
        value.const_value = tensor
        value.type, value.shape = ir.TensorType(tensor.dtype), ir.Shape(array.shape)
        model.graph.register_initializer(value)
    return model


def float3(*numbers: float) -> np.ndarray:
    return np.array(numbers, np.float32)


@pytest.mark.parametrize(
    ("first", "second", "left"),
    [
        (float3(1, 2, 3), float3(1, 2, 3), 1),
        (float3(0, 2, 3), float3(-0.0, 2, 3), 2),
        (float3(1, 2, np.nan), float3(1, 2, np.nan), 1),
        (float3(1, 2, 3), float3(1, 2, 4), 2),
        (float3(2, 2, 2), float3(2), 2),
    ],
)
def test_weights_are_shared_if_every_byte_is_equal(
    first: np.ndarray, second: np.ndarray, left: int
) -> None:
    model = with_weights(DUPLICATE_WEIGHTS_TEXT, first=first, second=second)
    x = float3(0.5, -1, 7)
    (before,) = run(model, x=x)
    result = DeduplicateWeights()(model)
    assert result.modified is (left == 1)
    assert len(model.graph.initializers) == left
    np.testing.assert_array_equal(run(model, x=x)[0], before)
    assert not DeduplicateWeights()(model).modified


def test_nan_of_other_bits_is_another_weight() -> None:
    bits = np.array([0x7FC00000, 0x7FC00001, 0], np.uint32)
    first = bits[[0, 2, 2]].view(np.float32)
    second = bits[[1, 2, 2]].view(np.float32)
    model = with_weights(DUPLICATE_WEIGHTS_TEXT, first=first, second=second)
    assert not DeduplicateWeights()(model).modified


def test_weights_of_a_body_are_shared_with_those_around_it_but_not_between_branches() -> None:
    text = """
    g (bool c, float[3] x) => (float[3] y) <float[3] out = {1, 2, 3}> {
        a = Add (x, out)
        y = If (c) <
            then_branch = t () => (float[3] u) <float[3] in = {1, 2, 3}, float[3] two = {5, 5, 5}> {
                b = Mul (a, in)
                u = Mul (b, two)
            },
            else_branch = e () => (float[3] v) <float[3] three = {5, 5, 5}> { v = Add (a, three) }
        >
    }
    """
    model = parsed(text)
    x = float3(1, -2, 3)
    before = [run(model, c=np.array(c), x=x)[0] for c in (True, False)]
    rewrite = DeduplicateWeights()
    assert rewrite(model).modified
    assert rewrite.changed == ["in"]
    after = [run(model, c=np.array(c), x=x)[0] for c in (True, False)]
    np.testing.assert_array_equal(after, before)


def test_a_weight_that_can_be_fed_stays() -> None:
    model = with_weights(DUPLICATE_WEIGHTS_TEXT, first=float3(1, 2, 3), second=float3(1, 2, 3))
    model.graph.inputs.append(model.graph.initializers["second"])
    before = text_of(model)
    rewrite = DeduplicateWeights()
    assert not rewrite(model).modified
    assert [refusal.where for refusal in rewrite.refusals] == ["second"]
    assert text_of(model) == before


def test_weights_beside_the_model_are_compared_with_those_inside(tmp_path: Path) -> None:
    array = np.arange(3, dtype=np.float32)
    (tmp_path / "w.bin").write_bytes(b"\0" * 8 + array.tobytes() * 2)
    model = with_weights(DUPLICATE_WEIGHTS_TEXT, first=array, second=array)
    for name, offset in (("first", 8), ("second", 20)):
        model.graph.initializers[name].const_value = ir.ExternalTensor(
            "w.bin",
            offset,
            12,
            ir.DataType.FLOAT,
            name=name,
            shape=ir.Shape([3]),
            base_dir=tmp_path,
        )
    assert DeduplicateWeights()(model).modified
    assert isinstance(model.graph.initializers["first"].const_value, ir.ExternalTensor)
