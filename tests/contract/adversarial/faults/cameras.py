"""Cameras that are taken for something else."""

from collections.abc import Callable
from functools import partial

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
    turned_covariance,
)
from contract.adversarial.graph_builder import GraphBuilder
from contract.adversarial.scenes import Array, Scene, rows, scene, sh_columns

FAMILY = "cameras"

CENTRE_WORDS = (
    r"camera.?to.?world|world.?to.?camera|matrix.?order|row.?major|column.?major|transpos",
    r"camera('s)? (centre|center|position).{0,80}(not|wrong|turn|rotat|inverse|−Rᵀ)",
    r"(turn|rotat).{0,60}camera.{0,60}(about|own|centre|colou?r)",
    r"invers",
)
CULLING_WORDS = (
    r"cull|hidden|invisible|nothing (is )?(drawn|visible|seen)|empty|no row|not drawn|frustum",
)
LOCAL = Sentence(
    "conventions.md",
    "Positions, covariances, bounds and cameras of a generator are all given in one frame",
)

Centre = Callable[[GraphBuilder, str], str]


def _colored_by(centre: Centre, kind: str, order: str = "column") -> Draft:
    """A model whose colours follow the direction from a camera centre."""
    source = scene(kind, seed=7)
    graph = GraphBuilder()
    view = graph.input("camera", [4, 4])
    where = graph.constant(source.position)
    color = colors_by_direction(graph, source, directions(graph, where, centre(graph, view)))
    manifest = declare(
        source.count,
        source.position.min(0),
        source.position.max(0),
        space="rgb",
        inputs=CAMERA_INPUTS[:1],
    )
    manifest["space"]["matrix_order"] = order
    return generator(graph, graph.constant(rows(source)), color, manifest)


def _parts(graph: GraphBuilder, view: str, *, row_major: bool = False) -> tuple[str, str]:
    """R and t of a column-major matrix as [3, 3] and [1, 3]; or read as if it were row-major."""
    matrix = view if row_major else graph.op("Transpose", view, perm=[1, 0])
    rotation_rows = graph.gather(matrix, [0, 1, 2], 0)
    return graph.gather(rotation_rows, [0, 1, 2], 1), graph.reshape(
        graph.gather(rotation_rows, [3], 1), 1, 3
    )


def _camera_to_world(graph: GraphBuilder, view: str) -> str:
    return _parts(graph, view)[1]


def _negated_translation(graph: GraphBuilder, view: str) -> str:
    return graph.op("Neg", _parts(graph, view)[1])


def _wrong_turn(graph: GraphBuilder, view: str) -> str:
    turn, offset = _parts(graph, view)  # c = −R t in place of −Rᵀ t
    return graph.op("Neg", graph.op("MatMul", offset, graph.op("Transpose", turn, perm=[1, 0])))


def _read_row_major(graph: GraphBuilder, view: str) -> str:
    turn, offset = _parts(graph, view, row_major=True)
    return graph.op("Neg", graph.op("MatMul", offset, turn))


def _opengl_centre(graph: GraphBuilder, view: str) -> str:
    """c with rows 2 and 3 of R negated and t left alone."""
    turn, offset = _parts(graph, view)
    flipped = graph.op("Mul", turn, graph.constant([[1], [-1], [-1]]))
    return graph.op("Neg", graph.op("MatMul", offset, flipped))


CENTRES: list[tuple[str, str, Centre]] = [
    (
        "camera_to_world",
        "Took the view matrix for camera-to-world, whose last column is the camera's centre.",
        _camera_to_world,
    ),
    (
        "camera_centre_is_minus_t",
        "Computed the camera's centre as −t and forgot the rotation.",
        _negated_translation,
    ),
    (
        "camera_centre_by_r_in_place_of_its_transpose",
        "Computed the camera's centre as −R t in place of −Rᵀ t.",
        _wrong_turn,
    ),
    ("matrix_read_row_major", "Read a column-major matrix as a row-major one.", _read_row_major),
    (
        "rotation_flipped_to_opengl",
        "Negated two rows of the rotation for OpenGL and left the translation alone.",
        _opengl_centre,
    ),
]
for name, mistake, centre in CENTRES:
    for kind in (
        ("surface", "room")
        if name in ("camera_to_world", "matrix_read_row_major")
        else ("surface",)
    ):
        fault(
            f"{name}_{kind}",
            FAMILY,
            mistake,
            *CENTRE_WORDS,
            build=partial(_colored_by, centre, kind),
        )
fault(
    "matrix_order_declared_wrong",
    FAMILY,
    "Reads the column-major matrix as it should and declares row order.",
    *CENTRE_WORDS,
    build=partial(_colored_by, camera_centre, "cloud", "row"),
)


def _viewing_axis() -> Draft:
    """Colours by the camera's forward axis, in place of the direction to each row."""
    source = scene("surface", seed=7)
    graph = GraphBuilder()
    view = graph.input("camera", [4, 4])
    forward = graph.gather(_parts(graph, view)[0], [2], 0)
    spread = graph.op("Expand", forward, graph.constant([source.count, 3], "int64"))
    color = colors_by_direction(graph, source, spread)
    manifest = declare(
        source.count,
        source.position.min(0),
        source.position.max(0),
        space="rgb",
        inputs=CAMERA_INPUTS[:1],
    )
    return generator(graph, graph.constant(rows(source)), color, manifest)


fault(
    "colors_by_viewing_axis",
    FAMILY,
    "Fed the camera's forward axis to the colour network in place of each row's direction.",
    *CENTRE_WORDS,
    build=_viewing_axis,
)


def _unnormalised_direction() -> Draft:
    source = scene("surface", seed=7)
    graph = GraphBuilder()
    view = graph.input("camera", [4, 4])
    ray = graph.op("Sub", graph.constant(source.position), camera_centre(graph, view))
    color = colors_by_direction(graph, source, ray)
    manifest = declare(
        source.count,
        source.position.min(0),
        source.position.max(0),
        space="rgb",
        inputs=CAMERA_INPUTS[:1],
    )
    return generator(graph, graph.constant(rows(source)), color, manifest)


fault(
    "direction_not_normalised",
    FAMILY,
    "Fed the vector from the camera to the colour network without normalising it.",
    r"normalis|normaliz|distance|unit",
    r"(nearer|farther|closer|away|along).{0,60}(ray|colou?r|direction)",
    build=_unnormalised_direction,
)


def _in_camera_space(kind: str, *, covariance_alone: bool) -> Draft:
    source = scene(kind, seed=8)
    graph = GraphBuilder()
    view = graph.input("camera", [4, 4])
    turn, offset = _parts(graph, view)
    where = graph.constant(source.position)
    if not covariance_alone:
        turned = graph.op("MatMul", where, graph.op("Transpose", turn, perm=[1, 0]))
        where = graph.op("Add", turned, offset)
    upper = turned_covariance(graph, graph.reshape(turn, 1, 3, 3), source)
    packed = packed_by_parts(graph, where, graph.constant(source.opacity[:, None]), upper)
    manifest = declare(
        source.count, source.position.min(0), source.position.max(0), inputs=CAMERA_INPUTS[:1]
    )
    return generator(graph, packed, graph.constant(sh_columns(source, 3)), manifest)


for kind in ("surface", "avatar"):
    fault(
        f"rows_in_camera_space_{kind}",
        FAMILY,
        "Emitted positions and covariances in camera space, as the rasteriser wants them.",
        r"camera.?space|local (space|frame)|view.?space|(position|centre)s? .{0,60}(follow|move with|change with|turn with) the (camera|view)",
        build=partial(_in_camera_space, kind, covariance_alone=False),
        sentence=LOCAL,
    )
for kind in ("surface", "hair"):
    fault(
        f"covariance_in_camera_space_{kind}",
        FAMILY,
        "Turned the covariances into camera space and left the positions in local space.",
        r"camera.?space|view.?space|covarianc.{0,80}(camera|view)",
        build=partial(_in_camera_space, kind, covariance_alone=True),
    )


def _clip_space() -> Draft:
    source = scene("surface", seed=8)
    graph = GraphBuilder()
    view, projection = graph.input("camera", [4, 4]), graph.input("proj", [4, 4])
    homogeneous = graph.constant(np.c_[source.position, np.ones(source.count)])
    clip = graph.op("MatMul", graph.op("MatMul", homogeneous, view), projection)
    w = graph.op("Add", graph.gather(clip, [3], 1), graph.constant(1e-6))
    device = graph.op("Div", graph.gather(clip, [0, 1, 2], 1), w)
    parts = rows(source)
    packed = packed_by_parts(
        graph, device, graph.constant(parts[:, 3:4]), graph.constant(parts[:, 4:])
    )
    manifest = declare(
        source.count, source.position.min(0), source.position.max(0), inputs=CAMERA_INPUTS
    )
    return generator(graph, packed, graph.constant(sh_columns(source, 3)), manifest)


fault(
    "positions_in_clip_space",
    FAMILY,
    "Emitted positions after the projection.",
    r"clip.?space|camera.?space|view.?space|local (space|frame)|(position|centre)s? .{0,60}(follow|move with|change with|turn with) the (camera|view)",
    build=_clip_space,
    sentence=LOCAL,
)

Visible = Callable[[GraphBuilder, Array, str, str], str]


def _culled(visible: Visible, kind: str, *, projects: bool) -> Draft:
    """A model that sets the opacity of rows to zero that it thinks are not seen."""
    source = scene(kind, seed=9)
    graph = GraphBuilder()
    view = graph.input("camera", [4, 4])
    projection = graph.input("proj", [4, 4]) if projects else ""
    visible_mask = visible(graph, source.position, view, projection)
    opacity = graph.op("Mul", graph.constant(source.opacity[:, None]), visible_mask)
    parts = rows(source)
    packed = packed_by_parts(
        graph, graph.constant(parts[:, :3]), opacity, graph.constant(parts[:, 4:])
    )
    manifest = declare(
        source.count,
        source.position.min(0),
        source.position.max(0),
        inputs=CAMERA_INPUTS if projects else CAMERA_INPUTS[:1],
        semantics="upper-bound",
    )
    return generator(graph, packed, graph.constant(sh_columns(source, 3)), manifest)


def _backwards(graph: GraphBuilder, positions: Array, view: str, projection: str) -> str:
    homogeneous = graph.constant(np.c_[positions, np.ones(len(positions))])
    depth = graph.gather(graph.op("MatMul", homogeneous, view), [2], 1)
    return graph.cast(graph.op("Less", depth, graph.constant(-0.01)), "float32")


def _wrong_depth_row(graph: GraphBuilder, positions: Array, view: str, projection: str) -> str:
    homogeneous = graph.constant(np.c_[positions, np.ones(len(positions))])
    transposed = graph.op("Transpose", view, perm=[1, 0])
    depth = graph.gather(graph.op("MatMul", homogeneous, transposed), [2], 1)
    return graph.cast(graph.op("Greater", depth, graph.constant(0.2)), "float32")


def _narrow(graph: GraphBuilder, positions: Array, view: str, projection: str) -> str:
    return inside_frustum(graph, positions, view, projection, 0.4)


def _unprojected_order(graph: GraphBuilder, positions: Array, view: str, projection: str) -> str:
    swapped = graph.op("Transpose", projection, perm=[1, 0])
    return inside_frustum(graph, positions, view, swapped)


CULLERS: list[tuple[str, str, Visible, tuple[str, ...]]] = [
    (
        "culled_by_minus_z",
        "Culls as if the camera looked along −z, so that all that is in front is gone.",
        _backwards,
        (r"[−-] ?z\b|forward|opengl|looks? along|\+z", *CULLING_WORDS),
    ),
    (
        "culled_by_transposed_view",
        "Culls by the depth that the transposed view matrix gives.",
        _wrong_depth_row,
        (r"transpos|matrix.?order|row.?major|column.?major", *CULLING_WORDS),
    ),
    (
        "culled_too_narrowly",
        "Culls at half of the clip space, because the focal length was taken for a width.",
        _narrow,
        CULLING_WORDS,
    ),
    (
        "culled_by_transposed_projection",
        "Culls with the transposed projection.",
        _unprojected_order,
        (r"transpos|matrix.?order|row.?major|column.?major", *CULLING_WORDS),
    ),
]
for name, mistake, visible, cause in CULLERS:
    for kind in ("surface", "room") if name == "culled_by_minus_z" else ("surface",):
        fault(
            f"{name}_{kind}",
            FAMILY,
            mistake,
            *cause,
            build=partial(
                _culled, visible, kind, projects=visible in (_narrow, _unprojected_order)
            ),
        )


def _moved_scene(change: Callable[[Array, Scene], None], kind: str) -> Draft:
    from contract.adversarial.drafts import static

    source = scene(kind, seed=10)
    packed = rows(source)
    change(packed, source)
    bounds = (packed[:, :3].min(0), packed[:, :3].max(0))
    return static(source, packed=packed, bounds=bounds)


def _positions_in_millimetres(packed: Array, source: Scene) -> None:
    packed[:, :3] *= 1000


def _positions_normalised(packed: Array, source: Scene) -> None:
    packed[:, :3] /= 40 * np.abs(source.position).max()


def _linear_scale(packed: Array, source: Scene) -> None:
    packed[:, :3] *= 100
    packed[:, 4:] *= 100


def _flipped_y(packed: Array, source: Scene) -> None:
    packed[:, 1] *= -1


def _turned_positions(packed: Array, source: Scene) -> None:
    packed[:, :3] = packed[:, :3] @ np.array([[1, 0, 0], [0, 0, 1.0], [0, -1, 0]])


NEAR = r"(small|tiny|large|big|size|spread|extent|standard deviation|scale|σ).{0,80}(neighbou?r|spacing|apart|scene|bounds|diagonal)"
TILT = r"(thin|flat|normal|orient|turned|mirror|flip|ax[ei]s).{0,80}(surface|plane|neighbou?r|position|centre|normal)"
MOVES: list[tuple[str, str, Callable[[Array, Scene], None], str]] = [
    (
        "positions_in_millimetres",
        "Converted positions from metres to millimetres and left the scales in metres.",
        _positions_in_millimetres,
        NEAR,
    ),
    (
        "positions_normalised_alone",
        "Normalised the positions to a small cube and left the scales as they were.",
        _positions_normalised,
        NEAR,
    ),
    (
        "covariance_scaled_once",
        "Scaled the scene by s and the covariances by s in place of s².",
        _linear_scale,
        NEAR,
    ),
    (
        "y_flipped_in_positions_alone",
        "Flipped y for another convention in positions and not in covariances.",
        _flipped_y,
        TILT,
    ),
    (
        "positions_turned_to_z_up_alone",
        "Turned positions from y-up to z-up and forgot the covariances.",
        _turned_positions,
        TILT,
    ),
]
for name, mistake, change, words in MOVES:
    for kind in ("surface", "avatar") if "alone" in name else ("surface", "cloud"):
        fault(f"{name}_{kind}", FAMILY, mistake, words, build=partial(_moved_scene, change, kind))
