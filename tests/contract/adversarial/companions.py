"""Builders of models that are not plain generators: cells, post-processing, trajectories."""

__all__ = ["cell_model", "post_process", "trajectory"]

from typing import Any

import numpy as np

from contract.adversarial.case import Draft
from contract.adversarial.drafts import declare
from contract.adversarial.graph_builder import GraphBuilder
from contract.adversarial.scenes import Scene, rows, sh_columns

PER_CELL = 4


def cell_model(
    source: Scene,
    *,
    per_cell: int = PER_CELL,
    visibility: Any = 1.0,
    hide_rows: bool = True,
    count: int | None = None,
    covariance_factor: float = 1.0,
    blend: str = "wsr",
    cells_dtype: str = "float32",
) -> Draft:
    """Return a constant model that is blended by a weighted sum of cells.

    Args:
        source: The scene; its rows are put into cells in their order.
        per_cell: Rows of a cell, by the manifest.
        visibility: Of all cells, or of each.
        hide_rows: Whether rows of hidden cells have opacity 0.
        count: Live rows; all where absent.
        covariance_factor: What the cells' covariances are multiplied by.
        blend: By the manifest.
        cells_dtype: Of the cells.
    """
    graph = GraphBuilder()
    n = source.count // PER_CELL
    packed = rows(source)
    grouped = packed[:, :3].reshape(n, PER_CELL, 3)
    centre = grouped.mean(1)
    spread = np.einsum("cki,ckj->cij", grouped - centre[:, None], grouped - centre[:, None])
    sigma = spread / PER_CELL + 0.01 * np.eye(3)
    upper = covariance_factor * sigma.reshape(n, 9)[:, [0, 1, 2, 4, 5, 8]]
    visible_mask = np.broadcast_to(visibility, (n,)).astype(float)
    cells = np.concatenate([centre, visible_mask[:, None], upper], axis=1)
    color = sh_columns(source, 1)
    live = source.count if count is None else count
    packed[live:], color[live:] = 0, 0
    if hide_rows:
        packed[np.repeat(visible_mask == 0, PER_CELL), 3] = 0
    low, high = packed[:live, :3].min(0), packed[:live, :3].max(0)
    manifest = declare(source.count, low, high, degree=1, semantics="upper-bound")
    manifest["outputs"]["cells"] = {"name": "cells", "per_cell": per_cell, "dtype": cells_dtype}
    manifest["blend"] = blend
    manifest["weighted_sum"] = {"background": 0.15, "depth_range": 12.5}
    graph.output("gaussians", graph.constant(packed), packed.shape)
    graph.output("color", graph.constant(color), color.shape)
    graph.output("num_points", graph.constant([live], "int32"), [1], "int32")
    graph.output("cells", graph.constant(cells, cells_dtype), cells.shape, cells_dtype)
    return Draft(graph.proto, manifest)


def post_process(
    *,
    layout: tuple[Any, ...] = (1, 3, "h", "w"),
    out_layout: tuple[Any, ...] | None = None,
    scale: float = 1.0,
    offset: float = 0.0,
    image_range: tuple[float, float] = (0, 1),
    out_range: tuple[float, float] = (0, 1),
    pool: bool = False,
    strength: bool = True,
    noise: bool = False,
) -> Draft:
    """Return a model that sharpens a picture a little.

    Args:
        layout: Shape of the input.
        out_layout: Shape of the output; that of the input where absent.
        scale: The result is multiplied by it.
        offset: It is added to the result.
        image_range: Black and white of the input, by the manifest.
        out_range: Black and white of the output, by the manifest.
        pool: Whether the result has half the size.
        strength: Whether it has a slider.
        noise: Whether random numbers are added.
    """
    graph = GraphBuilder()
    image = graph.input("image", layout)
    blurred = graph.op(
        "AveragePool", image, kernel_shape=[3, 3], pads=[1, 1, 1, 1], count_include_pad=0
    )
    detail = graph.op("Sub", image, blurred)
    entries: list[dict[str, Any]] = [{"name": "image", "role": "image"}]
    if strength:
        graph.input("strength", [1])
        detail = graph.op("Mul", detail, "strength")
        entries.append(
            {"name": "strength", "role": "control", "shape": [1], "range": [0, 1], "default": 1.0}
        )
    sharp = graph.op("Add", image, detail)
    if noise:
        drawn = graph.op("RandomNormalLike", image, scale=0.05)
        sharp = graph.op("Add", sharp, drawn)
    low, high = (graph.constant(float(v)) for v in (0.0, 1.0))
    result = graph.op("Clip", sharp, low, high)
    if scale != 1.0 or offset:
        result = graph.op("Mul", result, graph.constant(scale))
        result = graph.op("Add", result, graph.constant(offset))
    if pool:
        result = graph.op("AveragePool", result, kernel_shape=[2, 2], strides=[2, 2])
    graph.output("enhanced", result, out_layout or layout)
    manifest = {
        "contract": "1.0",
        "kind": "post-process",
        "name": "sharpen",
        "version": "1.0.0",
        "producer": {"tool": "exporter 1.0", "license": "CC0-1.0"},
        "inputs": entries,
        "image_range": list(image_range),
        "outputs": {
            "image": {
                "name": "enhanced",
                "dtype": "float32",
                "range": list(out_range),
                "color_space": "srgb",
            }
        },
    }
    return Draft(graph.proto, manifest)


def trajectory(
    *,
    state: int = 7,
    representation: str = "position+quaternion-wxyz",
    steps: int = 3,
    declared_steps: int | None = None,
    sigma_columns: int | None = None,
    sigma: float = 0.05,
    semantics: str = "standard-deviation",
    step_seconds: float | None = 0.1,
    normalise: bool = True,
) -> Draft:
    """Return a model that continues a camera path in a straight line.

    Args:
        state: Numbers of a state.
        representation: By the manifest.
        steps: Future states.
        declared_steps: By the manifest; ``steps`` where absent.
        sigma_columns: Of the uncertainty; one for each number of a state where absent.
        sigma: The uncertainty of the first step.
        semantics: Of the uncertainty.
        step_seconds: By the manifest; left out where None.
        normalise: Whether quaternions are normalised.
    """
    graph = GraphBuilder()
    past_poses = graph.input("past", [4, state])
    last, before = graph.gather(past_poses, [3], 0), graph.gather(past_poses, [2], 0)
    speed = graph.op("Sub", last, before)
    ahead = graph.constant(np.arange(1, steps + 1)[:, None])
    future = graph.op("Add", last, graph.op("Mul", speed, ahead))
    if state == 7 and normalise:
        future_position = graph.gather(future, [0, 1, 2], 1)
        turn = graph.gather(future, [3, 4, 5, 6], 1)
        square = graph.op("Mul", turn, turn)
        total = graph.op("ReduceSum", square, graph.constant([1], "int64"), keepdims=1)
        length = graph.op("Sqrt", graph.op("Add", total, graph.constant(1e-12)))
        future = graph.op("Concat", future_position, graph.op("Div", turn, length), axis=1)
    columns = sigma_columns or state
    growth = sigma * np.arange(1, steps + 1)[:, None] * np.ones((1, columns))
    zero = graph.op("Mul", graph.gather(last, [0], 1), graph.constant(0.0))
    graph.output("future", future, [steps, state])
    graph.output("sigma", graph.op("Add", graph.constant(growth), zero), [steps, columns])
    manifest: dict[str, Any] = {
        "contract": "1.0",
        "kind": "trajectory-predictor",
        "name": "straight-on",
        "version": "1.0.0",
        "producer": {"tool": "exporter 1.0", "license": "CC0-1.0"},
        "inputs": [{"name": "past", "role": "camera_history", "shape": [4, state]}],
        "outputs": {
            "future": {
                "name": "future",
                "steps": declared_steps or steps,
                "representation": representation,
            },
            "uncertainty": {"name": "sigma", "semantics": semantics},
        },
    }
    if step_seconds is not None:
        manifest["step_seconds"] = step_seconds
    return Draft(graph.proto, manifest)
