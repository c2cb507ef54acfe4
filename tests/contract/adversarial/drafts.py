"""Shared builders: the manifest of a generator, and models of constant rows."""

__all__ = ["declare", "generator", "static"]

from typing import Any

import numpy as np

from contract.adversarial.case import Draft
from contract.adversarial.graph_builder import GraphBuilder
from contract.adversarial.scenes import Scene, rows, sh_columns


def declare(
    capacity: int,
    low: Any,
    high: Any,
    *,
    space: str = "sh",
    degree: int = 3,
    dtype: str = "float32",
    inputs: list[dict[str, Any]] | None = None,
    name: str = "scene",
    semantics: str = "exact",
) -> dict[str, Any]:
    """Return a complete manifest of a generator whose outputs have the usual names.

    Args:
        capacity: Rows of the outputs.
        low: Lower corner of the bounds.
        high: Upper corner of the bounds.
        space: ``sh`` or ``rgb``.
        degree: Of the harmonics.
        dtype: Of the outputs.
        inputs: Entries of ``inputs``.
        name: Of the model.
        semantics: Of the count.
    """
    appearance = {"name": "color", "space": space, "color_space": "srgb"}
    if space == "sh":
        appearance["degree"] = degree  # type: ignore[assignment]
    return {
        "contract": "1.0",
        "kind": "gaussian-generator",
        "name": name,
        "version": "1.0.0",
        "producer": {"tool": "exporter 1.0", "license": "CC0-1.0"},
        "space": {"handedness": "right", "up": "-y", "unit": "metre", "matrix_order": "column"},
        "bounds": {"min": [float(v) for v in low], "max": [float(v) for v in high]},
        "inputs": inputs or [],
        "outputs": {
            "gaussians": {
                "name": "gaussians",
                "layout": "packed10",
                "dtype": dtype,
                "capacity": capacity,
            },
            "appearance": appearance,
            "count": {"name": "num_points", "semantics": semantics},
        },
        "antialias": "classic",
        "blend": "alpha",
    }


def generator(
    graph: GraphBuilder,
    gaussians: str,
    color: str,
    manifest: dict[str, Any],
    *,
    channels: int | None = None,
    count: str | None = None,
) -> Draft:
    """Finish a graph: name its outputs as the manifest does.

    Args:
        graph: The graph so far.
        gaussians: The value that holds the rows.
        color: The value that holds the appearance.
        manifest: What is declared.
        channels: Of the appearance; those that the manifest implies where absent.
        count: The value that holds the count; the capacity where absent.
    """
    outputs = manifest["outputs"]
    capacity, dtype = outputs["gaussians"]["capacity"], outputs["gaussians"]["dtype"]
    appearance = outputs["appearance"]
    if channels is None:
        channels = 3 * (appearance["degree"] + 1) ** 2 if appearance["space"] == "sh" else 3
        if appearance["space"] == "rgb" and dtype == "float16":
            channels = 4
    graph.output("gaussians", gaussians, [capacity, 10], dtype)
    graph.output("color", color, [capacity, channels], dtype)
    count = count or graph.constant([capacity], "int32")
    graph.output("num_points", count, [1], "int32")
    return Draft(graph.proto, manifest)


def static(
    source: Scene,
    *,
    packed: np.ndarray | None = None,
    color: np.ndarray | None = None,
    space: str = "sh",
    degree: int = 3,
    dtype: str = "float32",
    bounds: tuple[Any, Any] | None = None,
    count: int | None = None,
) -> Draft:
    """Return a model without inputs whose outputs are constants.

    Args:
        source: The scene.
        packed: Rows in place of the scene's own.
        color: Appearance in place of the scene's own.
        space: ``sh`` or ``rgb``.
        degree: Of the harmonics.
        dtype: Of the outputs.
        bounds: Corners in place of the scene's own.
        count: Live rows; all where absent.
    """
    graph = GraphBuilder()
    if packed is None:
        packed = rows(source)
    if color is None:
        color = sh_columns(source, degree) if space == "sh" else source.rgb
        if space == "rgb" and dtype == "float16":
            color = np.concatenate([color, np.ones((len(color), 1))], axis=1)
    stored = source.position.astype(dtype).astype(float)
    low, high = bounds or (stored.min(0), stored.max(0))
    manifest = declare(len(packed), low, high, space=space, degree=degree, dtype=dtype)
    graph.output("gaussians", graph.constant(packed, dtype), packed.shape, dtype)
    graph.output("color", graph.constant(color, dtype), color.shape, dtype)
    live = graph.constant([len(packed) if count is None else count], "int32")
    graph.output("num_points", live, [1], "int32")
    return Draft(graph.proto, manifest)
