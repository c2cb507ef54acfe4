"""Two files are compared number by number, and run with the memory that their weights take."""

from pathlib import Path

import numpy as np
import onnx_ir as ir
import pytest

from gsgen.contract.probing.probes import Probe
from gsgen.contract.process.limits import Limits
from gsgen.sdk.errors import RewriteFailed
from gsgen.sdk.passes.framework.base import BIT_EXACT
from gsgen.sdk.rewriting.output_equivalence import _limits_for_model, compare_files
from support.passes import parsed


def test_integers_are_compared_where_a_double_cannot_tell_them_apart(tmp_path: Path) -> None:
    for name, added in (("before", 0), ("after", 1)):
        text = f"g (int64[1] x) => (int64[1] y) <int64 c = {{{added}}}> {{ y = Add (x, c) }}"
        ir.save(parsed(text), tmp_path / f"{name}.onnx")
    files = tmp_path / "before.onnx", tmp_path / "after.onnx"
    probes = [Probe(label="large", inputs={"x": np.array([1 << 53], np.int64)})]
    with pytest.raises(RewriteFailed, match="'y' differs by 1 "):
        compare_files(*files, ["y"], probes, Limits(), BIT_EXACT, "a pass")


def test_weights_in_a_file_of_any_name_are_granted_their_memory(tmp_path: Path) -> None:
    model = parsed("g (float[4096] x) => (float[4096] y) { y = Neg (x) }")
    array = np.arange(4096, dtype=np.float32)
    value = ir.Value(
        name="w",
        const_value=ir.tensor(array, name="w"),
        type=ir.TensorType(ir.DataType.FLOAT),
        shape=ir.Shape(array.shape),
    )
    model.graph.register_initializer(value)
    ir.save(model, tmp_path / "in.onnx", external_data="weights.bin")
    memory_limits = _limits_for_model(tmp_path / "in.onnx", Limits(memory=1)).memory
    assert memory_limits > Limits(memory=1).for_model(array.nbytes).memory


@pytest.mark.parametrize(("divisor", "uncompared"), [(0, ("y",)), (2, ())])
def test_nonnumeric_output_is_not_compared(
    tmp_path: Path, divisor: int, uncompared: tuple[str, ...]
) -> None:
    text = f"""g (float[2] x) => (float[2] y, float[0, 2] e, float[2] z)
        <float zero = {{0}}, float d = {{{divisor}}}, float[0, 2] none = {{}}>
        {{ q = Mul (x, zero) y = Div (q, d) e = Identity (none) z = Neg (x) }}"""
    ir.save(parsed(text), tmp_path / "m.onnx")
    probes = [Probe(label=str(i), inputs={"x": np.full(2, i, np.float32)}) for i in range(2)]
    files = tmp_path / "m.onnx", tmp_path / "m.onnx"
    result = compare_files(*files, ["y", "e", "z"], probes, Limits(), BIT_EXACT, "a pass")
    assert result.differences == ()
    assert result.uncompared == (*uncompared, "e")
