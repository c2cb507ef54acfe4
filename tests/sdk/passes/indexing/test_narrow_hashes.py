"""Hashes modulo a power of two, in int32: the same integers as in int64."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx_ir.passes.common import RemoveUnusedNodesPass

from gsgen.sdk.passes.indexing.narrow_hashes import NarrowHashes
from support.passes import operators, parsed, run

PRIMES = (1, 2654435761, 805459861)


def hashing(bits: int, most: int, *, low: int = 0, last: str = "", dtype: str = "int64") -> str:
    """A hash of three columns of cells from ``low`` to ``most``, modulo 2 to a number of bits."""
    last = last or "y = Mod (mixed, size)"
    return (
        f"g (float[40,3] x) => ({dtype}[40] y) <float low = {{{low}}}, float most = {{{most}}}, "
        f"{dtype}[3] primes = {{{', '.join(map(str, PRIMES))}}}, {dtype} size = {{{1 << bits}}}, "
        f"{dtype} mask = {{{(1 << bits) - 1}}}, int64 a = {{0}}, int64 b = {{1}}, int64 c = {{2}}> {{"
        f" bound = Clip (x, low, most) whole = Floor (bound) cell = Cast <to = 7> (whole)"
        f" scaled = Mul (cell, primes) first = Gather <axis = 1> (scaled, a)"
        f" second = Gather <axis = 1> (scaled, b) third = Gather <axis = 1> (scaled, c)"
        f" two = BitwiseXor (first, second) mixed = BitwiseXor (two, third) {last} }}"
    )


@settings(max_examples=15, deadline=None)
@given(
    bits=st.integers(1, 19),
    most=st.integers(1, 2048),
    low=st.sampled_from([0, -5, -2048]),
    seed=st.integers(0, 999),
)
def test_hashes_keep_their_values(bits: int, most: int, low: int, seed: int) -> None:
    model = parsed(hashing(bits, most, low=low))
    x = np.random.default_rng(seed).uniform(low - 2, most + 2, (40, 3)).astype(np.float32)
    (before,) = run(model, x=x)
    cells = np.floor(np.clip(x, low, most)).astype(np.int64)
    expected_hashes = [
        (int(a) ^ (int(b) * PRIMES[1]) ^ (int(c) * PRIMES[2])) % (1 << bits) for a, b, c in cells
    ]
    assert NarrowHashes()(model).modified
    RemoveUnusedNodesPass()(model)
    assert not operators(model) & {"BitwiseXor", "Mod"}
    (after,) = run(model, x=x)
    assert after.dtype == before.dtype
    np.testing.assert_array_equal(after, expected_hashes)
    np.testing.assert_array_equal(after, before)


def test_a_mask_of_bits_is_a_remainder() -> None:
    model = parsed(hashing(9, 100, last="y = BitwiseAnd (mixed, mask)"))
    x = np.random.default_rng(0).uniform(0, 100, (40, 3)).astype(np.float32)
    (before,) = run(model, x=x)
    assert NarrowHashes()(model).modified
    RemoveUnusedNodesPass()(model)
    assert "BitwiseAnd" not in operators(model)
    np.testing.assert_array_equal(run(model, x=x)[0], before)


@pytest.mark.parametrize("between", ["BitwiseAnd (mixed, wide)", "Mod (mixed, multiple)"])
def test_a_remainder_that_keeps_the_low_bits_changes_no_hash(between: str) -> None:
    text = hashing(9, 100, last=f"low_bits = {between} y = Mod (low_bits, size)").replace(
        "<", "<int64 wide = {4294967295}, int64 multiple = {1048576}, ", 1
    )
    model = parsed(text)
    x = np.random.default_rng(0).uniform(0, 100, (40, 3)).astype(np.float32)
    (before,) = run(model, x=x)
    assert NarrowHashes()(model).modified
    RemoveUnusedNodesPass()(model)
    assert not operators(model) & {"BitwiseXor", "BitwiseAnd", "Mod"}
    np.testing.assert_array_equal(run(model, x=x)[0], before)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (hashing(20, 1 << 13), "(modulo 1048576) may leave"),
        (hashing(9, 100).replace("Clip (x, low, most)", "Neg (x)"), "may leave the range of int32"),
    ],
)
def test_a_hash_that_may_leave_int32_stays_with_the_reason(text: str, reason: str) -> None:
    rewrite, model = NarrowHashes(), parsed(text)
    size = len(model.graph), len(model.graph.initializers)
    assert not rewrite(model).modified
    assert reason in rewrite.refusals[0].reason
    assert (len(model.graph), len(model.graph.initializers)) == size


@pytest.mark.parametrize("last", ["y = Add (mixed, size)", "y = Mod <fmod = 1> (mixed, size)"])
def test_other_integers_are_not_hashes(last: str) -> None:
    rewrite, model = NarrowHashes(), parsed(hashing(9, 100, last=last))
    assert not rewrite(model).modified
    assert rewrite.refusals == []
