"""Rewrites the exclusive or of spatial hashes in int32, with a table instead of a bit operator."""

__all__ = ["NarrowHashes"]

import numpy as np
import onnx_ir as ir

from gsgen.contract.model.value_ranges import Interval
from gsgen.sdk.passes.framework.base import TableRewrite, every_node, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import SkippableRewrite
from gsgen.sdk.passes.framework.gather_spans import fits_int32, spans_of
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import (
    attribute_values,
    constant_of,
    int_attribute,
    required,
)

_INTEGER_TYPES = (ir.DataType.INT32, ir.DataType.INT64)
_INT32 = ir.DataType.INT32
_LARGEST_INT32 = (1 << 31) - 1
# Bits of both operands that index the table of exclusive ors: 2¹⁴ entries.
_TABLE_BITS = 7
# Operators that move the elements of their first input.
_MOVE_OPERATORS = (
    "Gather",
    "Slice",
    "Squeeze",
    "Unsqueeze",
    "Reshape",
    "Transpose",
    "Expand",
    "Identity",
)


class _UnprovableRange(Exception):
    """Raised if the remainder of a value cannot be computed in int32; the message says why."""


class NarrowHashes(TableRewrite, SkippableRewrite):
    """Compute spatial hashes modulo a power of two in int32, without bit operators.

    Instant-NGP indexes a table of 2ᵏ entries by (x · p₁ ⊕ y · p₂ ⊕ z · p₃) mod 2ᵏ. PyTorch ports
    compute it in int64, because the primes exceed int32; no WebGPU runtime has kernels for int64,
    for BitwiseXor, or for Mod. The lowest k bits depend on the lowest k bits of each operand only::

        1  Mod(a · p, 2ᵏ)   →   r − (r / 2ᵏ) · 2ᵏ, where r = a · (p mod 2ᵏ) fits int32
        2  Mod(a ⊕ b, 2ᵏ)   →   Σ Gather(table, (a mod 2⁷) · 2⁷ + b mod 2⁷), over every 7 bits

    A node is rewritten only if range analysis proves that no product leaves int32: cell indices up
    to 2³¹⁻ᵏ. A remainder by a larger power of two in between changes nothing. Positions need a known range for that, such as after Clip or Sigmoid.
    """

    name = "narrow-hashes"
    wanted_by = "targets whose tables lack BitwiseXor"

    def rewrite(self, model: ir.Model) -> None:
        """Replace nodes that compute an XOR modulo a power of two by int32 arithmetic."""
        spans: dict[str, Interval] | None = None
        remainders = [
            n for n in every_node(model) if _modulus_bits(n) and _has_xor_ancestor(n.inputs[0])
        ]
        for node in reversed(remainders):  # the last of two needs the fewest bits
            if not (node.outputs[0].uses() or node.outputs[0].is_graph_output()):
                continue
            if node.graph is not model.graph:
                self.refuse(node, "the node is inside a subgraph, whose value ranges are unknown")
                continue
            spans = spans or spans_of(model, self.target.manifest if self.target else None)
            write = InsertionPoint(node)
            try:
                remainder = _RemainderMatch(write, _modulus_bits(node), spans).remainder_of(
                    required(node.inputs[0])
                )
            except _UnprovableRange as reason:
                self.refuse(node, str(reason))
                continue
            self.note(node)
            kind = required(node.outputs[0].dtype)
            write.replace(write.op("Cast", remainder, dtype=kind, to=int(kind)))


def _modulus_bits(node: ir.Node) -> int:
    """Return k if an ONNX node computes a remainder by 2ᵏ that is never negative; else 0."""
    if not is_op(node, "Mod", "BitwiseAnd") or node.outputs[0].dtype not in _INTEGER_TYPES:
        return 0
    divisor = constant_of(node.inputs[1])
    if divisor is None or divisor.size != 1 or int_attribute(node, "fmod", 0):
        return 0
    number = int(divisor.reshape(-1)[0]) + (1 if is_op(node, "BitwiseAnd") else 0)
    is_power = number > 1 and number & (number - 1) == 0
    return number.bit_length() - 1 if is_power else 0


def _keeps_low_bits(node: ir.Node, bits: int) -> bool:
    """Return whether a node leaves the lowest bits as they are, as ``h & 0xFFFFFFFF`` does."""
    divisor = constant_of(node.inputs[1]) if is_op(node, "Mod", "BitwiseAnd") else None
    if divisor is None or divisor.size != 1 or int_attribute(node, "fmod", 0):
        return False
    # A multiple of 2ᵏ as divisor, or a mask that ends with k ones.
    number = int(divisor.reshape(-1)[0]) + (1 if is_op(node, "BitwiseAnd") else 0)
    return number % (1 << bits) == 0


def _has_xor_ancestor(value: ir.Value | None) -> bool:
    """Return whether a value derives from an XOR through Adds, Casts, Reshapes and the like."""
    node = None if value is None else value.producer()
    if node is not None and _keeps_low_bits(node, 1):
        return _has_xor_ancestor(node.inputs[0])
    if node is None or not is_op(node, "BitwiseXor", "Cast", "Add", *_MOVE_OPERATORS):
        return False
    return is_op(node, "BitwiseXor") or any(_has_xor_ancestor(entry) for entry in node.inputs)


class _RemainderMatch:
    """Writes ONNX nodes that compute integer values modulo 2ᵏ in int32, from 0 to 2ᵏ − 1."""

    def __init__(self, write: InsertionPoint, bits: int, spans: dict[str, Interval]) -> None:
        self.write, self.bits, self.spans = write, bits, spans
        self._remainder_by_value: dict[int, ir.Value] = {}

    def remainder_of(self, value: ir.Value) -> ir.Value:
        """Return a graph value modulo 2ᵏ; nodes for the same value are created only once."""
        if id(value) not in self._remainder_by_value:
            self._remainder_by_value[id(value)] = self._computed_hash_digits(value)
        return self._remainder_by_value[id(value)]

    def _computed_hash_digits(self, value: ir.Value) -> ir.Value:
        known = constant_of(value)
        if known is not None:
            return self._write_constant(np.mod(known, 1 << self.bits))
        node = value.producer()
        if node is not None and is_op(node, "BitwiseXor"):  # Case 2
            return self._xor_digits(*(self.remainder_of(required(entry)) for entry in node.inputs))
        if node is not None and _keeps_low_bits(node, self.bits):
            return self.remainder_of(required(node.inputs[0]))
        if node is not None and is_op(node, *_MOVE_OPERATORS):
            moved_value = self.remainder_of(required(node.inputs[0]))
            return self.write.op(
                node.op_type, moved_value, *node.inputs[1:], **attribute_values(node)
            )
        if node is not None and is_op(node, "Mul", "Add", "Sub"):
            return self._arithmetic(node)
        span = self.spans.get(value.name or "")
        if not fits_int32(span):
            raise _UnprovableRange(f"values of tensor {value.name} may leave the range of int32")
        return self._reduce_to_range(self._write_cast(value), *required(span))

    def _arithmetic(self, node: ir.Node) -> ir.Value:
        """Return a sum, a difference or a product modulo 2ᵏ, computed by ONNX nodes."""
        size = 1 << self.bits
        a, b = (required(entry) for entry in node.inputs)
        if is_op(node, "Add", "Sub"):
            low, high = (0, 2 * size) if is_op(node, "Add") else (-size, size)
            return self._reduce_to_range(
                self.write.op(node.op_type, self.remainder_of(a), self.remainder_of(b)), low, high
            )
        if constant_of(a) is not None:
            a, b = b, a
        factor = constant_of(b)
        if factor is None:
            name = node.outputs[0].name
            raise _UnprovableRange(
                f"tensor {name} multiplies two varying integers: int32 may overflow"
            )
        # Factors from −2ᵏ⁻¹ to 2ᵏ⁻¹ keep the product one bit shorter than those from 0 to 2ᵏ.
        factor = np.mod(factor.astype(np.int64) + size // 2, size) - size // 2
        span = self.spans.get(a.name or "")
        if span is None or not fits_int32(span):
            raise _UnprovableRange(f"values of tensor {a.name} may leave the range of int32")
        most = max(abs(span[0]), abs(span[1])) * int(np.abs(factor).max(initial=0))
        if most + size > _LARGEST_INT32:
            raise _UnprovableRange(
                f"the product of {a.name} and a hash factor (modulo {size}) may leave the range of int32"
            )
        product = self.write.op("Mul", self._write_cast(a), self._write_constant(factor))
        return self._reduce_to_range(product, -most, most)

    def _reduce_to_range(self, value: ir.Value, low: float, high: float) -> ir.Value:
        """Return the remainder by 2ᵏ of an int32 value that lies between given limits."""
        size = 1 << self.bits
        if low >= 0 and high < size:
            return value
        if low < 0:  # a division rounds towards zero, so the value must not be negative
            offset = -int(low // size) * size
            if high + offset > _LARGEST_INT32:
                raise _UnprovableRange(
                    f"values of tensor {value.name} may leave the range of int32"
                )
            value = self.write.op("Add", value, self._write_constant(np.array(offset)))
        return self._low_bits(value, self.bits)

    def _low_bits(self, value: ir.Value, bits: int) -> ir.Value:
        size = self._write_constant(np.array(1 << bits))
        multiple_of_size = self.write.op("Mul", self.write.op("Div", value, size), size)
        return self.write.op("Sub", value, multiple_of_size)

    def _xor_digits(self, a: ir.Value, b: ir.Value) -> ir.Value:
        """Return the exclusive or of two values below 2ᵏ, by a look-up for every seven bits."""
        op, table_size = self.write.op, 1 << _TABLE_BITS
        first_digits, second_digits = np.indices((table_size, table_size))
        table = self._write_constant((first_digits ^ second_digits).reshape(-1))
        total: ir.Value | None = None
        for start in range(0, self.bits, _TABLE_BITS):
            scale = self._write_constant(np.array(1 << start))
            a_digit, b_digit = (
                self._low_bits(op("Div", value, scale) if start else value, _TABLE_BITS)
                for value in (a, b)
            )
            index = op(
                "Add", op("Mul", a_digit, self._write_constant(np.array(table_size))), b_digit
            )
            digit = op("Gather", table, index, axis=0)
            shifted_digit = op("Mul", digit, scale) if start else digit
            total = shifted_digit if total is None else op("Add", total, shifted_digit)
        return required(total)

    def _write_cast(self, value: ir.Value) -> ir.Value:
        if value.dtype == _INT32:
            return value
        return self.write.op("Cast", value, dtype=_INT32, shape=value.shape, to=int(_INT32))

    def _write_constant(self, array: np.ndarray) -> ir.Value:
        return self.write.constant(array.astype(np.int32), "hash")
