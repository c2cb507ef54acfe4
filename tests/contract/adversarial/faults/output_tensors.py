"""Outputs and counts whose shape, dtype or value is not what the contract asks for."""

from functools import partial
from typing import Any

import numpy as np

from contract.adversarial.case import Draft, Sentence, fault
from contract.adversarial.drafts import declare, generator, static
from contract.adversarial.dynamic import CAMERA_INPUTS, inside_frustum
from contract.adversarial.graph_builder import GraphBuilder
from contract.adversarial.scenes import rows, scene, sh_columns

FAMILY = "graph"

STATIC = Sentence("layout.md", "N and C are static, positive numbers in the graph.")
COUNT = Sentence("layout.md", "| `count` | int32 | [1] | how many rows are live |")
COUNT_RANGE = Sentence("layout.md", "`count` holds one number between 0 and N")
INERT = Sentence("layout.md", "Rows **at and behind** the count are **inert**: opacity exactly 0")
EXACT = Sentence("manifest.md", "`exact`: every row before it is drawn.")
DTYPE = Sentence("layout.md", "| `gaussians` | float32 or float16 | [N, 10] |")
OPSET = Sentence("targets.md", "| `core` | 1.0 | 13 to 26 | up to 13 | `ai.onnx` |")


def _outputs(
    *,
    shape: tuple[Any, ...] | None = (64, 10),
    dtype: str = "float32",
    color_shape: tuple[Any, ...] = (64, 48),
    count: object = 64,
    count_dtype: str = "int32",
    count_shape: tuple[Any, ...] = (1,),
    count_value_shape: tuple[int, ...] | None = None,
    opset: int = 18,
    ir_version: int = 9,
    without: str = "",
) -> Draft:
    """A static model whose outputs are declared otherwise than usual."""
    source = scene("surface", seed=30)
    graph = GraphBuilder(opset=opset, ir_version=ir_version)
    manifest = declare(64, source.position.min(0), source.position.max(0))
    graph.output("gaussians", graph.constant(rows(source), dtype), shape, dtype)
    graph.output("color", graph.constant(sh_columns(source, 3)), color_shape)
    shape_of_count = count_shape if count_value_shape is None else count_value_shape
    live = graph.constant(np.full(shape_of_count, count), count_dtype)
    graph.output("num_points", live, count_shape, count_dtype)
    if without:
        retained = [output for output in graph.proto.graph.output if output.name != without]
        del graph.proto.graph.output[:]
        graph.proto.graph.output.extend(retained)
    return Draft(graph.proto, manifest)


VARIANTS: list[tuple[str, str, dict[str, Any], Sentence, str]] = [
    (
        "rows_symbolic",
        "Exported with dynamic_shapes, so N is a symbol.",
        {"shape": ("n", 10)},
        STATIC,
        r"dynamic|static|symbol|fixed|open",
    ),
    (
        "columns_symbolic",
        "Exported both axes as dynamic.",
        {"shape": ("n", "c")},
        STATIC,
        r"dynamic|static|symbol|fixed|open",
    ),
    (
        "color_rows_symbolic",
        "Exported the rows of the appearance as dynamic.",
        {"color_shape": ("n", 48)},
        STATIC,
        r"dynamic|static|symbol|fixed|open",
    ),
    (
        "rows_are_double",
        "numpy's float64 went into the rows.",
        {"dtype": "float64"},
        DTYPE,
        r"float64|double|float32|dtype",
    ),
    (
        "rows_are_bfloat16",
        "Stored rows as bfloat16, as the checkpoint has them.",
        {"dtype": "bfloat16"},
        DTYPE,
        r"bfloat16|float32|dtype",
    ),
    (
        "count_is_int64",
        "torch.tensor(n) became int64.",
        {"count_dtype": "int64"},
        COUNT,
        r"int64|int32|dtype",
    ),
    (
        "count_is_float",
        "The count is the sum of a mask, a float.",
        {"count_dtype": "float32"},
        COUNT,
        r"float32|int32|dtype",
    ),
    (
        "count_is_scalar",
        "Exported the count without an axis.",
        {"count_shape": ()},
        COUNT,
        r"shape|rank|scalar|\[1\]|axes",
    ),
    (
        "count_is_a_matrix",
        "Exported the count as [1, 1].",
        {"count_shape": (1, 1)},
        COUNT,
        r"shape|rank|\[1\]|axes",
    ),
    (
        "count_of_each_row",
        "Exported a mask of rows as the count.",
        {"count_shape": (64,), "count": 1},
        COUNT,
        r"shape|\[64\]|\[1\]|one",
    ),
    (
        "count_in_words",
        "Counted words in place of rows.",
        {"count": 640},
        COUNT_RANGE,
        r"count|640|capacity",
    ),
    (
        "count_of_the_unpruned_model",
        "The count is that of the model before it was pruned.",
        {"count": 4096},
        COUNT_RANGE,
        r"count|4096|capacity",
    ),
    (
        "count_negative",
        "Initialised the count with −1.",
        {"count": -1},
        COUNT_RANGE,
        r"count|negative|-1|−1",
    ),
    (
        "count_is_the_last_index",
        "Wrote the last row's number in place of the count.",
        {"count": 63},
        INERT,
        r"behind|inert|count|padding",
    ),
    (
        "count_of_zero",
        "Left the count at zero, so nothing is ever drawn.",
        {"count": 0},
        INERT,
        r"count (is |of )?0|count (is )?zero|empty|nothing (is )?drawn|no live",
    ),
    (
        "count_not_exported",
        "Dropped the count when the graph was cut.",
        {"without": "num_points"},
        Sentence("layout.md", "A generator has three outputs"),
        r"count|num_points",
    ),
    (
        "appearance_not_exported",
        "Dropped the appearance when the graph was cut.",
        {"without": "color"},
        Sentence("layout.md", "A generator has three outputs"),
        r"appearance|color",
    ),
    (
        "operator_set_11",
        "Exported with an operator set of 2019.",
        {"opset": 11, "ir_version": 6},
        OPSET,
        r"opset|operator set",
    ),
    (
        "fewer_colors_than_rows",
        "Exported the appearance of another pruning step.",
        {"color_shape": (32, 48)},
        Sentence("layout.md", "Row i of `appearance` belongs to row i of `gaussians`."),
        r"rows|\b32\b|\b64\b|shape",
    ),
]
for name, mistake, options, sentence, cause in VARIANTS:
    fault(name, FAMILY, mistake, cause, build=partial(_outputs, **options), sentence=sentence)
fault(
    "rows_without_a_shape",
    FAMILY,
    "Exported the rows without a shape.",
    r"shape|static|unknown|open",
    build=partial(_outputs, shape=None),
    sentence=STATIC,
    checker=False,
)


def _shape_lies() -> Draft:
    """Rows that a graph makes of its time are 64 by the graph's word, and 48 when it runs."""
    source = scene("surface", seed=30)
    graph = GraphBuilder()
    time = graph.input("time", [1])
    scaled = graph.op("Mul", time, graph.constant(0.0))
    length = graph.op("Add", graph.cast(scaled, "int64"), graph.constant([48], "int64"))
    start, axis = graph.constant([0], "int64"), graph.constant([0], "int64")
    packed = graph.op("Slice", graph.constant(rows(source)), start, length, axis)
    color = graph.op("Slice", graph.constant(sh_columns(source, 3)), start, length, axis)
    entry = {"name": "time", "role": "time", "range": [0, 1], "default": 0.0}
    low, high = source.position.min(0), source.position.max(0)
    return generator(graph, packed, color, declare(64, low, high, inputs=[entry]))


fault(
    "shape_is_not_what_the_graph_says",
    FAMILY,
    "Wrote the shape of the outputs by hand, and the model gives another one.",
    r"\bshapes?\b",
    build=_shape_lies,
    sentence=Sentence("manifest.md", "`capacity` and `dtype` equal those of the graph."),
)


def _compacted(mistake: str) -> Draft:
    """Rows outside the frustum are dropped; the count and the rest go wrong in one way or other."""
    source = scene("surface", seed=31)
    graph = GraphBuilder()
    view, projection = graph.input("camera", [4, 4]), graph.input("proj", [4, 4])
    visible_mask = inside_frustum(graph, source.position, view, projection, 0.35)
    total = graph.cast(
        graph.op("ReduceSum", visible_mask, graph.constant([0, 1], "int64"), keepdims=0), "int32"
    )
    live = graph.reshape(total, 1)
    packed, color = graph.constant(rows(source)), graph.constant(sh_columns(source, 3))
    if mistake != "not compacted":
        rank = graph.reshape(visible_mask, 64)
        _, order = _top_k(graph, rank)
        packed = graph.op("Gather", packed, order, axis=0)
        color = graph.op("Gather", color, order, axis=0)
        ranked = graph.op("Gather", visible_mask, order, axis=0)
        columns = graph.constant(np.eye(10)[3][None])
        if mistake != "padding kept":
            hidden = graph.op("Sub", graph.constant(1.0), ranked)
            factor = graph.op("Sub", graph.constant(1.0), graph.op("Mul", hidden, columns))
            packed = graph.op("Mul", packed, factor)
    if mistake == "one too few":
        live = graph.op(
            "Max", graph.op("Sub", live, graph.constant([1], "int32")), graph.constant([0], "int32")
        )
    elif mistake == "capacity":
        live = graph.constant([64], "int32")
    elif mistake == "tripled":
        live = graph.op("Mul", live, graph.constant([3], "int32"))
    low, high = source.position.min(0), source.position.max(0)
    manifest = declare(64, low, high, inputs=CAMERA_INPUTS)
    return generator(graph, packed, color, manifest, count=live)


def _top_k(graph: GraphBuilder, rank: str) -> tuple[str, str]:
    values, order = graph.op("Identity", rank), graph.op("Identity", rank)
    graph.proto.graph.node.pop()
    graph.proto.graph.node.pop()
    graph.node("TopK", [rank, graph.constant([64], "int64")], [values, order])
    return values, order


COMPACTED = r"behind|inert|count|padding|exact"
COMPACTIONS = [
    (
        "not compacted",
        "The count is the number of visible rows, which were never moved to the front.",
        INERT,
        r"front|compact|live rows first|scatter|in order|sort",
    ),
    (
        "padding kept",
        "Sorted visible rows to the front and left the opacity of the others.",
        INERT,
        COMPACTED,
    ),
    ("one too few", "Off by one: the count is the number of the last live row.", INERT, COMPACTED),
    (
        "capacity",
        "The count is always the capacity, although hidden rows are declared not to be there.",
        EXACT,
        COMPACTED,
    ),
    ("tripled", "Counted each visible row once for every coordinate.", COUNT_RANGE, COMPACTED),
]
for mistake_name, mistake, sentence, cause in COMPACTIONS:
    fault(
        f"compaction_{mistake_name.replace(' ', '_')}",
        FAMILY,
        mistake,
        cause,
        build=partial(_compacted, mistake_name),
        sentence=sentence,
    )


def _empty() -> Draft:
    source = scene("surface", seed=36)
    return static(source, packed=0 * rows(source), color=0 * sh_columns(source, 3), count=0)


fault(
    "nothing_but_zeros",
    FAMILY,
    "Exported before the checkpoint was loaded: the count is zero and so is everything else.",
    r"empty|nothing|no row|no gaussian|never",
    build=_empty,
)
