"""Wide Concats and Splits become trees that a shader stage can bind, bit for bit."""

import ml_dtypes
import numpy as np
import onnx_ir as ir
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.sdk.passes.portability.chunk_concat import ChunkConcat
from gsgen.sdk.passes.portability.chunk_split import ChunkSplit
from support.passes import HEAD, checked, parsed, run, text_of

# What the CPU's kernels take.
DTYPES = {
    "float": np.float32,
    "float16": np.float16,
    "double": np.float64,
    "int8": np.int8,
    "int16": np.int16,
    "int32": np.int32,
    "int64": np.int64,
    "uint8": np.uint8,
    "uint16": np.uint16,
    "uint32": np.uint32,
    "uint64": np.uint64,
    "bool": np.bool_,
}
EDGES = [2, 6, 7, 8, 14, 15, 49, 50, 343, 344, 1024]


def bits(rng: np.random.Generator, shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """Any bit pattern, NaNs with a payload and negative zeros among them."""
    if dtype is np.bool_:
        return rng.integers(0, 2, shape).astype(np.bool_)
    size = np.dtype(dtype).itemsize
    raw = rng.integers(0, 256, (*shape, size), dtype=np.uint8)
    return raw.view(dtype).reshape(shape)


def arrays_equal(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()


def wide_concat(width: int, dtype: str, rank: int, axis: int) -> ir.Model:
    """Joins ``width`` parts of one input that is repeated in pieces of one, two and no rows."""
    dims = ",".join("2" for _ in range(rank))
    names = [f"x{index % 3}" for index in range(width)]
    sized = [
        ",".join(str(size) if k == axis % rank else "2" for k in range(rank)) for size in (1, 2, 0)
    ]
    inputs = ", ".join(f"{dtype}[{size}] x{k}" for k, size in enumerate(sized))
    # Every part passes through a node of its own, as in a graph that a machine wrote.
    moved = "\n".join(f"m{k} = Identity ({name})" for k, name in enumerate(names))
    joined = ", ".join(f"m{k}" for k in range(width))
    open_dims = dims.replace("2", "N")
    return parsed(
        f"g ({inputs}) => ({dtype}[{open_dims}] y) {{ {moved}\n"
        f"y = Concat <axis = {axis}> ({joined}) }}"
    )


def concat_inputs(rng, dtype: type, rank: int, axis: int) -> dict[str, np.ndarray]:
    shapes = [[2] * rank for _ in range(3)]
    for shape, size in zip(shapes, (1, 2, 0), strict=True):
        shape[axis] = size
    return {f"x{k}": bits(rng, tuple(shape), dtype) for k, shape in enumerate(shapes)}


def judge_concat(width: int, dtype: str, rank: int, axis: int, limit: int) -> None:
    model = wide_concat(width, dtype, rank, axis)
    rng = np.random.default_rng([width, rank])
    inputs = concat_inputs(rng, DTYPES[dtype], rank, axis)
    parts = [inputs[f"x{k % 3}"] for k in range(width)]
    result = ChunkConcat(limit)(model)
    assert result.modified is (width > limit)
    concat_nodes = [node for node in model.graph if node.op_type == "Concat"]
    assert max(len(node.inputs) for node in concat_nodes) <= limit
    (actual,) = run(model, **inputs)
    assert arrays_equal(actual, np.concatenate(parts, axis))
    assert not ChunkConcat(limit)(model).modified


@pytest.mark.parametrize("width", EDGES)
def test_a_wide_concat_keeps_its_value(width: int) -> None:
    judge_concat(width, "float", 2, 1, 7)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    width=st.integers(2, 120),
    dtype=st.sampled_from(sorted(DTYPES)),
    rank=st.integers(1, 4),
    location=st.integers(-4, 3),
    limit=st.integers(2, 9),
)
def test_random_concat_keeps_its_value(
    width: int, dtype: str, rank: int, location: int, limit: int
) -> None:
    judge_concat(width, dtype, rank, max(-rank, min(location, rank - 1)), limit)


def wide_split(
    width: int, dtype: str, rank: int, axis: int, sizes: list[int] | None, head: str
) -> ir.Model:
    whole = sum(sizes) if sizes else 2 * width
    dims = ",".join(str(whole) if k == axis % rank else "2" for k in range(rank))
    open_dims = ",".join("N" for _ in range(rank))
    names = ", ".join(f"y{k}" for k in range(width))
    outputs = ", ".join(f"{dtype}[{open_dims}] y{k}" for k in range(width))
    old = '"" : 11' in head
    text = ", ".join(map(str, sizes or []))
    weight = f"<int64[{width}] s = {{{text}}}>" if sizes and not old else ""
    counted = f", num_outputs = {width}" if '"" : 18' in head and not sizes else ""
    inputs = f", split = [{text}]" if sizes and old else counted
    argument = ", s" if weight else ""
    return parsed(
        f"g ({dtype}[{dims}] x) => ({outputs}) {weight} "
        f"{{ {names} = Split <axis = {axis}{inputs}> (x{argument}) }}",
        head,
    )


def judge_split(
    width: int,
    dtype: str,
    rank: int,
    axis: int,
    sizes: list[int] | None,
    limit: int,
    head: str = HEAD,
) -> None:
    model = wide_split(width, dtype, rank, axis, sizes, head)
    shape = [2] * rank
    shape[axis] = sum(sizes) if sizes else 2 * width
    x = bits(np.random.default_rng([width, rank]), tuple(shape), DTYPES[dtype])
    result = ChunkSplit(limit)(model)
    assert result.modified is (width > limit)
    cuts = [node for node in model.graph if node.op_type == "Split"]
    assert max(len(node.outputs) for node in cuts) <= limit
    expected = np.split(x, np.cumsum(sizes or [2] * width)[:-1], axis)
    outputs = run(model, x=x)
    assert all(arrays_equal(a, b) for a, b in zip(outputs, expected, strict=True))
    assert not ChunkSplit(limit)(model).modified


@pytest.mark.parametrize("width", EDGES)
def test_a_wide_split_keeps_its_values(width: int) -> None:
    judge_split(width, "float", 2, 0, None, 7)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    sizes=st.lists(st.integers(0, 3), min_size=2, max_size=80),
    dtype=st.sampled_from(sorted(DTYPES)),
    rank=st.integers(1, 4),
    location=st.integers(-4, 3),
    limit=st.integers(2, 9),
    sizes_given=st.booleans(),
    opset=st.sampled_from([11, 13, 18]),
)
def test_random_split_keeps_its_values(
    sizes: list[int],
    dtype: str,
    rank: int,
    location: int,
    limit: int,
    sizes_given: bool,
    opset: int,
) -> None:
    axis = max(-rank, min(location, rank - 1))
    head = HEAD.replace("18", str(opset))
    known = sizes if sizes_given else None
    judge_split(len(sizes), dtype, rank, axis, known, limit, head)


def test_the_last_part_of_an_uneven_split_is_the_smaller() -> None:
    names = ", ".join(f"y{k}" for k in range(9))
    outputs = ", ".join(f"float[N] y{k}" for k in range(9))
    text = f"g (float[26] x) => ({outputs}) {{ {names} = Split <num_outputs = 9> (x) }}"
    model, x = parsed(text), np.arange(26, dtype=np.float32)
    before = run(model, x=x)
    assert ChunkSplit()(model).modified
    assert [part.tolist() for part in run(model, x=x)] == [b.tolist() for b in before]


def test_a_split_whose_sizes_vary_is_left_alone_and_named() -> None:
    names = ", ".join(f"y{k}" for k in range(8))
    outputs = ", ".join(f"float[N] y{k}" for k in range(8))
    text = f"g (float[26] x, int64[8] s) => ({outputs}) {{ {names} = Split (x, s) }}"
    model, rewrite = parsed(text), ChunkSplit()
    before = text_of(model)
    assert not rewrite(model).modified
    assert text_of(model) == before
    assert "not known" in rewrite.refusals[0].reason


def test_bodies_of_branches_are_rewritten_too() -> None:
    parts = ", ".join("x" for _ in range(9))
    model = parsed(
        "g (bool c, float[2] x) => (float[N] y) { y = If (c) <"
        f"then_branch = t () => (float[18] a) {{ a = Concat <axis = 0> ({parts}) }}, "
        "else_branch = e () => (float[2] b) { b = Neg (x) }> }"
    )
    assert ChunkConcat()(model).modified
    x = np.array([1, 2], np.float32)
    assert run(model, c=np.array(True), x=x)[0].tolist() == [1, 2] * 9


def test_bfloat16_is_chunked_though_the_cpu_runs_it_not() -> None:
    parts = ", ".join("x" for _ in range(9))
    text = f"g (bfloat16[2] x) => (bfloat16[18] y) {{ y = Concat <axis = 0> ({parts}) }}"
    model = parsed(text)
    assert ChunkConcat()(model).modified
    assert model.graph.outputs[0].dtype.numpy() == ml_dtypes.bfloat16
    checked(model)


@pytest.mark.parametrize("make", [ChunkConcat, ChunkSplit])
def test_a_limit_below_two_makes_no_tree(make: type) -> None:
    with pytest.raises(
        ValueError, match="one operator may join at most 1 tensors, expected a limit of 2"
    ):
        make(1)
