"""Models that go wrong for some cameras alone: far, close, behind, or of another size."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from contract.adversarial.case import Draft, Sentence, fault
from contract.adversarial.drafts import declare, generator
from contract.adversarial.dynamic import (
    CAMERA_INPUTS,
    camera_centre,
    colors_by_direction,
    directions,
    inside_frustum,
    packed_by_parts,
)
from contract.adversarial.graph_builder import GraphBuilder
from contract.adversarial.scenes import Array, Scene, rows, scene, sh_columns

FAMILY = "cameras"
N = 400
PROBES = Sentence("levels.md", "At these moments outputs must be finite")
RANGES = Sentence("levels.md", "and what rules say of single runs must hold")

Parts = tuple[str, str, str]
PartsOf = Callable[[GraphBuilder, Scene, Array, str, str], Parts]


def _seen(kind: str, parts: PartsOf, *, factor: float = 1.0, projects: bool = False) -> Draft:
    """A model of a camera; ``parts`` adds its opacity, its RGB and its row order, or none."""
    source = scene(kind, seed=34, n=N)
    packed = rows(source)
    packed[:, :3] *= factor
    packed[:, 4:] *= factor**2
    graph = GraphBuilder()
    view = graph.input("camera", [4, 4])
    projection = graph.input("proj", [4, 4]) if projects else ""
    opacity, color, order = parts(graph, source, packed[:, :3], view, projection)
    opacity = opacity or graph.constant(packed[:, 3:4])
    color = color or graph.constant(source.rgb)
    whole = packed_by_parts(
        graph, graph.constant(packed[:, :3]), opacity, graph.constant(packed[:, 4:])
    )
    if order:
        whole = graph.op("Gather", whole, order, axis=0)
    manifest = declare(
        source.count,
        packed[:, :3].min(0),
        packed[:, :3].max(0),
        space="rgb",
        inputs=CAMERA_INPUTS if projects else CAMERA_INPUTS[:1],
        semantics="upper-bound",
    )
    return generator(graph, whole, color, manifest)


def _squared_distance(
    graph: GraphBuilder, positions: Array, view: str, dtype: str = "float32"
) -> str:
    ray = graph.op("Sub", graph.constant(positions), camera_centre(graph, view))
    if dtype != "float32":
        ray = graph.cast(ray, dtype)
    square = graph.op("Mul", ray, ray)
    return graph.op("ReduceSum", square, graph.constant([1], "int64"), keepdims=1)


def _depth(graph: GraphBuilder, positions: Array, view: str) -> str:
    homogeneous = graph.constant(np.c_[positions, np.ones(N)])
    return graph.gather(graph.op("MatMul", homogeneous, view), [2], 1)


def _half_distance(
    graph: GraphBuilder, source: Scene, positions: Array, view: str, projection: str
) -> Parts:
    """Directions in float16, whose squares overflow beyond 256 units."""
    ray = graph.op("Sub", graph.constant(positions), camera_centre(graph, view))
    square = _squared_distance(graph, positions, view, "float16")
    length = graph.op("Sqrt", square)
    unit = graph.cast(graph.op("Div", graph.cast(ray, "float16"), length), "float32")
    infinite = graph.cast(graph.op("Sub", length, length), "float32")  # inf − inf is NaN
    return "", colors_by_direction(graph, source, graph.op("Add", unit, infinite)), ""


def _direction_without_epsilon(
    graph: GraphBuilder, source: Scene, positions: Array, view: str, projection: str
) -> Parts:
    ray = graph.op("Sub", graph.constant(positions), camera_centre(graph, view))
    unit = graph.op("Div", ray, graph.op("Sqrt", _squared_distance(graph, positions, view)))
    return "", colors_by_direction(graph, source, unit), ""


def _logarithm_of_depth(
    graph: GraphBuilder, source: Scene, positions: Array, view: str, projection: str
) -> Parts:
    depth = graph.op("Add", _depth(graph, positions, view), graph.constant(1e-12))
    shift = graph.op("Mul", graph.op("Log", depth), graph.constant(np.full((1, 3), 0.2)))
    return "", graph.op("Sigmoid", shift), ""


def _opacity_by_distance(
    graph: GraphBuilder, source: Scene, positions: Array, view: str, projection: str
) -> Parts:
    square = graph.op("Add", _squared_distance(graph, positions, view), graph.constant(0.5))
    inverse_square_distance = graph.op("Div", graph.constant(4.0), square)
    factor = graph.op(
        "Add", graph.constant(0.9), graph.op("Mul", inverse_square_distance, graph.constant(0.4))
    )
    return graph.op("Mul", graph.constant(source.opacity[:, None]), factor), "", ""


def _near_alone(limit: float) -> PartsOf:
    def parts(
        graph: GraphBuilder, source: Scene, positions: Array, view: str, projection: str
    ) -> Parts:
        near = graph.op("Less", _squared_distance(graph, positions, view), graph.constant(limit**2))
        visible_mask = graph.cast(near, "float32")
        return graph.op("Mul", graph.constant(source.opacity[:, None]), visible_mask), "", ""

    return parts


def _far_plane_in_front(
    graph: GraphBuilder, source: Scene, positions: Array, view: str, projection: str
) -> Parts:
    """The near plane stands at 50 units, and the scene is a few units large."""
    visible_mask = graph.cast(
        graph.op("Greater", _depth(graph, positions, view), graph.constant(50.0)), "float32"
    )
    return graph.op("Mul", graph.constant(source.opacity[:, None]), visible_mask), "", ""


def _signed_frustum(
    graph: GraphBuilder, source: Scene, positions: Array, view: str, projection: str
) -> Parts:
    """Only one side of clip space is tested: 0 ≤ x ≤ w in place of |x| ≤ w."""
    homogeneous = graph.constant(np.c_[positions, np.ones(N)])
    clip = graph.op("MatMul", graph.op("MatMul", homogeneous, view), projection)
    right = graph.op("GreaterOrEqual", graph.gather(clip, [0], 1), graph.constant(0.0))
    inside = graph.cast(right, "float32")
    wide_frustum = inside_frustum(graph, positions, view, projection)
    visible_mask = graph.op("Mul", inside, wide_frustum)
    return graph.op("Mul", graph.constant(source.opacity[:, None]), visible_mask), "", ""


def _rows_sorted_alone(
    graph: GraphBuilder, source: Scene, positions: Array, view: str, projection: str
) -> Parts:
    depth = graph.reshape(_depth(graph, positions, view), N)
    _, order = graph.node(
        "TopK", [depth, graph.constant([N], "int64")], ["sorted", "order"], largest=0
    ).output
    return "", "", order


DECIDABLE: list[tuple[str, str, str, Any, float, tuple[str, ...]]] = [
    (
        "distance_overflows_in_half",
        "Computed the distance to the camera in float16, where it overflows far away.",
        "surface",
        _half_distance,
        20.0,
        (r"finite|\bnan\b|overflow",),
    ),
    (
        "camera_in_a_gaussian_is_nan",
        "Divided the direction by its length, which is 0 for a camera in a Gaussian's centre.",
        "surface",
        _direction_without_epsilon,
        1.0,
        (r"finite|\bnan\b",),
    ),
    (
        "logarithm_of_a_negative_depth",
        "Took the logarithm of the depth, which is negative behind the camera.",
        "room",
        _logarithm_of_depth,
        1.0,
        (r"finite|\bnan\b",),
    ),
    (
        "opacity_above_one_nearby",
        "Compensated the opacity by distance without a clamp.",
        "cloud",
        _opacity_by_distance,
        1.0,
        (r"opacit",),
    ),
]
for name, mistake, kind, parts, factor, cause in DECIDABLE:
    fault(
        name,
        FAMILY,
        mistake,
        *cause,
        build=partial(_seen, kind, parts, factor=factor),
        sentence=RANGES if "opacity" in name else PROBES,
    )

CULLING = (
    r"cull|hidden|invisible|nothing (is )?(drawn|visible|seen)|empty|no row|not drawn|frustum|transparent|opacit",
)
HEURISTIC: list[tuple[str, str, str, Any, tuple[str, ...]]] = [
    (
        "culled_beyond_a_unit",
        "Culls by a far plane of one unit, as if the scene were normalised.",
        "room",
        _near_alone(1.0),
        CULLING,
    ),
    (
        "near_plane_of_fifty_units",
        "Culls by a near plane of fifty units, a millimetre scene's.",
        "surface",
        _far_plane_in_front,
        CULLING,
    ),
    (
        "culled_on_one_side",
        "Tests one side of clip space alone, so that the left half of the picture is empty.",
        "surface",
        _signed_frustum,
        CULLING,
    ),
    (
        "rows_sorted_without_colors",
        "Sorts the rows by depth in the graph and forgets the colours.",
        "surface",
        _rows_sorted_alone,
        (r"colou?r.{0,120}(row|order|Gaussian|differ|change)|row.{0,60}colou?r",),
    ),
    (
        "rows_sorted_without_colors",
        "Sorts the rows by depth in the graph and forgets the colours.",
        "avatar",
        _rows_sorted_alone,
        (r"colou?r.{0,120}(row|order|Gaussian|differ|change)|row.{0,60}colou?r",),
    ),
]
for name, mistake, kind, parts, cause in HEURISTIC:
    projects = name == "culled_on_one_side"
    build = partial(_seen, kind, parts, projects=projects)
    fault(f"{name}_{kind}", FAMILY, mistake, *cause, build=build)


def _transposed_directions() -> Draft:
    """Directions that are turned into the camera's frame, which the network never saw."""
    source = scene("surface", seed=34, n=N)
    graph = GraphBuilder()
    view = graph.input("camera", [4, 4])
    unit = directions(graph, graph.constant(source.position), camera_centre(graph, view))
    turn = graph.gather(graph.gather(view, [0, 1, 2], 0), [0, 1, 2], 1)
    color = colors_by_direction(graph, source, graph.op("MatMul", unit, turn))
    low, high = source.position.min(0), source.position.max(0)
    manifest = declare(N, low, high, space="rgb", inputs=CAMERA_INPUTS[:1])
    return generator(graph, graph.constant(rows(source)), color, manifest)


fault(
    "directions_in_camera_space",
    FAMILY,
    "Turned the directions into camera space before the colour network.",
    r"colou?rs? .{0,60}camera (turns|rotates) about its own centre|camera.?space",
    build=_transposed_directions,
)


def _covariance_of_the_screen() -> Draft:
    """Sizes that follow the distance, as if they were pixels."""
    source = scene("surface", seed=34, n=N)
    graph = GraphBuilder()
    view = graph.input("camera", [4, 4])
    packed = rows(source)
    factor = graph.op("Mul", _squared_distance(graph, packed[:, :3], view), graph.constant(0.02))
    upper = graph.op("Mul", graph.constant(packed[:, 4:]), factor)
    whole = packed_by_parts(
        graph, graph.constant(packed[:, :3]), graph.constant(packed[:, 3:4]), upper
    )
    low, high = source.position.min(0), source.position.max(0)
    manifest = declare(N, low, high, inputs=CAMERA_INPUTS[:1])
    return generator(graph, whole, graph.constant(sh_columns(source, 3)), manifest)


fault(
    "sizes_follow_the_distance",
    FAMILY,
    "Scaled the Gaussians by their distance to the camera, to keep their size on the screen.",
    r"covarianc.{0,80}(camera|view)|size.{0,80}(camera|view|distance|neighbou?r|bounds)",
    build=_covariance_of_the_screen,
)
