"""Right models of more rows, whose Gaussians overlap, and models that sort rows and colours."""

from functools import partial

import numpy as np

from contract.adversarial.case import Draft, right_model
from contract.adversarial.drafts import declare, generator, static
from contract.adversarial.dynamic import CAMERA_INPUTS
from contract.adversarial.graph_builder import GraphBuilder
from contract.adversarial.scenes import KINDS, rows, scene, sh_columns

TOOL = "raw protos"


def _dense(kind: str, statistics: str, count: int, degree: int) -> Draft:
    return static(scene(kind, statistics, seed=41, n=count), degree=degree)


for count, degree, statistics in ((400, 3, "trained"), (1500, 2, "synthetic")):
    for kind in KINDS:
        right_model(
            f"dense_{kind}_{count}",
            TOOL,
            kind,
            statistics,
            build=partial(_dense, kind, statistics, count, degree),
        )


def _sorted_by_depth(kind: str) -> Draft:
    """Rows and colours in the order of their depth, as a viewer without a sort needs them."""
    source = scene(kind, seed=42, n=400)
    graph = GraphBuilder()
    view = graph.input("camera", [4, 4])
    homogeneous = graph.constant(np.c_[source.position, np.ones(source.count)])
    depth = graph.gather(graph.op("MatMul", homogeneous, view), [2], 1)
    count = graph.constant([source.count], "int64")
    outputs = ["sorted", "order"]
    graph.node("TopK", [graph.reshape(depth, source.count), count], outputs, largest=0)
    packed = graph.op("Gather", graph.constant(rows(source)), "order", axis=0)
    color = graph.op("Gather", graph.constant(sh_columns(source, 1)), "order", axis=0)
    low, high = source.position.min(0), source.position.max(0)
    manifest = declare(source.count, low, high, degree=1, inputs=CAMERA_INPUTS[:1])
    return generator(graph, packed, color, manifest)


for kind in ("surface", "avatar"):
    right_model(
        f"sorted_by_depth_{kind}", TOOL, kind, "trained", build=partial(_sorted_by_depth, kind)
    )
