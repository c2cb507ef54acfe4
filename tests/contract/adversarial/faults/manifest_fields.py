"""Manifests whose fields say something else than the model, or nothing that is allowed."""

from collections.abc import Callable
from functools import partial
from typing import Any

from contract.adversarial.case import Draft, Sentence, fault
from contract.adversarial.drafts import declare, generator, static
from contract.adversarial.dynamic import (
    CAMERA_INPUTS,
    camera_centre,
    colors_by_direction,
    directions,
)
from contract.adversarial.graph_builder import GraphBuilder
from contract.adversarial.scenes import rows, scene

FAMILY = "manifest"

Manifest = dict[str, Any]

NO_NULL = Sentence("manifest.md", "A field is left out, never `null`.")
UNKNOWN = Sentence("manifest.md", "Any other unknown field is an error")
SAME = Sentence("manifest.md", "`capacity` and `dtype` equal those of the graph.")
BY_NAME = Sentence("index.md", "Names are compared byte by byte.")
EVERY_INPUT = Sentence("index.md", "Every input of the graph must have a role.")
CORNERS = Sentence("manifest.md", "Every corner of `min` is at most that of `max`.")
HOLDS = Sentence(
    "manifest.md",
    "An axis-aligned box of all Gaussian centres for all inputs, checked with test inputs.",
)
VERSION = Sentence("manifest.md", '`contract` is `"major.minor"`, a string')


def _scene(kind: str = "surface") -> Draft:
    return static(scene(kind, seed=20))


def _lit(kind: str = "surface") -> Draft:
    """A model whose colours follow the camera."""
    source = scene(kind, seed=20)
    graph = GraphBuilder()
    view = graph.input("camera", [4, 4])
    where = graph.constant(source.position)
    direction = directions(graph, where, camera_centre(graph, view))
    color = colors_by_direction(graph, source, direction)
    low, high = source.position.min(0), source.position.max(0)
    manifest = declare(source.count, low, high, space="rgb", inputs=[dict(CAMERA_INPUTS[0])])
    return generator(graph, graph.constant(rows(source)), color, manifest)


def _edited(edit: Callable[[Manifest], Any], *, lit: bool = False) -> Draft:
    draft = _lit() if lit else _scene()
    assert isinstance(draft.manifest, dict)
    edit(draft.manifest)
    return draft


def _outputs(field: str, **values: Any) -> Callable[[Manifest], None]:
    return lambda manifest: manifest["outputs"][field].update(values)


def _set(**values: Any) -> Callable[[Manifest], None]:
    return lambda manifest: manifest.update(values)


def _drop(field: str) -> Callable[[Manifest], Any]:
    return lambda manifest: manifest.pop(field)


def _scaled_bounds(factor: float) -> Callable[[Manifest], None]:
    def edit(manifest: Manifest) -> None:
        for corner in ("min", "max"):
            manifest["bounds"][corner] = [v * factor for v in manifest["bounds"][corner]]

    return edit


def _swap_corners(manifest: Manifest) -> None:
    bounds = manifest["bounds"]
    bounds["min"], bounds["max"] = bounds["max"], bounds["min"]


def _point_bounds(manifest: Manifest) -> None:
    manifest["bounds"]["max"] = manifest["bounds"]["min"]


def _y_up_bounds(manifest: Manifest) -> None:
    low, high = manifest["bounds"]["min"], manifest["bounds"]["max"]
    manifest["bounds"] = {
        "min": [low[0], -high[1] - 0.6, low[2]],
        "max": [high[0], -low[1] - 0.6, high[2]],
    }


FIELD = r"unknown|not allowed|additional|misspel|did you mean|no such field|no field"
BOX = r"centres within|outside|beyond the bounds|bounds.{0,40}(point|degenerate|empty|unit)|measure bounds"
PICTURE = {
    "sha256": "0" * 64,
    "inputs": "no inputs",
    "view": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4]],
    "focal": [100, 100],
    "center": [50, 50],
}
EDITS: list[tuple[str, str, Callable[[Manifest], Any], Sentence, str]] = [
    (
        "kind_missing",
        "Forgot `kind`.",
        _drop("kind"),
        Sentence("manifest.md", '| `kind` | `"gaussian-generator"` | required |'),
        r"\bkind\b",
    ),
    (
        "kind_misspelled",
        "Wrote the kind as `generator`.",
        _set(kind="generator"),
        Sentence("manifest.md", '| `kind` | `"gaussian-generator"` | required |'),
        r"\bkind\b",
    ),
    (
        "contract_is_a_number",
        "Wrote the version as a number.",
        _set(contract=1.1),
        VERSION,
        r"contract|version",
    ),
    (
        "contract_of_another_major",
        "Declares version 2.0.",
        _set(contract="2.0"),
        Sentence("manifest.md", "| another major | refuses it"),
        r"major|version|2\.0",
    ),
    (
        "name_missing",
        "Forgot the name.",
        _drop("name"),
        Sentence("manifest.md", "| `name` | string (not empty) | required |"),
        r"\bname\b",
    ),
    (
        "capacity_stale",
        "Pruned the model and left the capacity.",
        _outputs("gaussians", capacity=4096),
        SAME,
        r"capacity|rows",
    ),
    (
        "dtype_declared_half",
        "Declares float16 and stores float32.",
        _outputs("gaussians", dtype="float16"),
        SAME,
        r"dtype|float16|float32",
    ),
    (
        "degree_declared_too_low",
        "Declares degree 1 and stores 48 channels.",
        _outputs("appearance", degree=1),
        Sentence("layout.md", "C follows from `space` and `degree`."),
        r"degree|channels",
    ),
    (
        "degree_missing",
        "Declares harmonics without a degree.",
        lambda m: m["outputs"]["appearance"].pop("degree"),
        Sentence("manifest.md", "`degree` is required for `sh`"),
        r"degree",
    ),
    (
        "space_declared_rgb",
        "Declares RGB and stores harmonics.",
        lambda m: m["outputs"].update(appearance={"name": "color", "space": "rgb"}),
        Sentence("layout.md", "C follows from `space` and `degree`."),
        r"rgb|channels|\b48\b",
    ),
    (
        "color_space_misspelled",
        "Wrote the colour space as `sRGB`.",
        _outputs("appearance", color_space="sRGB"),
        Sentence("manifest.md", '| `color_space` | one of `"srgb"`, `"linear"` |'),
        r"color_space|srgb",
    ),
    (
        "output_name_in_capitals",
        "Wrote an output's name with a capital letter.",
        _outputs("gaussians", name="Gaussians"),
        BY_NAME,
        r"Gaussians.{0,80}(no|not|output|graph)|no output",
    ),
    (
        "output_of_another_export",
        "Declares the output's name of an older export.",
        _outputs("count", name="n_gaussians"),
        BY_NAME,
        r"n_gaussians|no output",
    ),
    (
        "outputs_are_one_tensor",
        "Declares one tensor as rows and as appearance.",
        _outputs("appearance", name="gaussians"),
        Sentence("manifest.md", "No two of them are the same tensor."),
        r"same|twice|two|both",
    ),
    (
        "count_missing",
        "Forgot to declare the count.",
        lambda m: m["outputs"].pop("count"),
        Sentence("manifest.md", "A conforming generator has the first three"),
        r"count",
    ),
    (
        "appearance_missing",
        "Forgot to declare the appearance.",
        lambda m: m["outputs"].pop("appearance"),
        Sentence("manifest.md", "A conforming generator has the first three"),
        r"appearance",
    ),
    (
        "layout_of_another_viewer",
        "Declares a layout of its own.",
        _outputs("gaussians", layout="packed14"),
        Sentence("manifest.md", '| `layout` | `"packed10"` |'),
        r"layout|packed10",
    ),
    ("bounds_swapped", "Swapped min and max.", _swap_corners, CORNERS, r"bounds|min.{0,30}max"),
    (
        "bounds_in_centimetres",
        "Declares the bounds in other units than the positions.",
        _scaled_bounds(0.01),
        HOLDS,
        BOX,
    ),
    ("bounds_are_a_point", "Left the bounds at one corner.", _point_bounds, HOLDS, BOX),
    (
        "bounds_of_y_up_scene",
        "Declares the bounds of the scene before its y axis was flipped.",
        _y_up_bounds,
        HOLDS,
        BOX,
    ),
    (
        "bounds_of_two_numbers",
        "Declares the bounds as two numbers.",
        _set(bounds={"min": -1, "max": 1}),
        Sentence("manifest.md", "| `min` | [number, number, number] | required |"),
        r"bounds",
    ),
    (
        "bounds_as_centre_and_size",
        "Declares the bounds as centre and size.",
        _set(bounds={"center": [0, 0, 0], "size": [2, 2, 2]}),
        UNKNOWN,
        r"bounds|center|size",
    ),
    (
        "bounds_are_null",
        "Wrote null for bounds that were not measured.",
        _set(bounds=None),
        NO_NULL,
        r"bounds|null",
    ),
    (
        "field_misspelled",
        "Wrote `anti_alias` for `antialias`.",
        _set(anti_alias="mip"),
        UNKNOWN,
        FIELD + r"|anti_alias",
    ),
    (
        "field_in_british",
        "Wrote `colour_space` for `color_space`.",
        _outputs("appearance", colour_space="srgb"),
        UNKNOWN,
        FIELD + r"|colour_space",
    ),
    (
        "studio_field_without_prefix",
        "Added a field of the studio without `x-`.",
        _set(studio={"take": 7}),
        Sentence(
            "manifest.md", "Any object of the manifest may have fields whose names start with `x-`."
        ),
        FIELD + r"|studio",
    ),
    (
        "handedness_left",
        "Declares a left-handed space, as Unity has it.",
        lambda m: m["space"].update(handedness="left"),
        Sentence("conventions.md", "Space is right-handed."),
        r"handed|left|right",
    ),
    (
        "up_without_sign",
        "Wrote the upward axis as `y`.",
        lambda m: m["space"].update(up="y"),
        Sentence("manifest.md", '| `up` | one of `"+x"`'),
        r"\bup\b",
    ),
    (
        "matrix_order_spelled_out",
        "Wrote the memory order as `column-major`.",
        lambda m: m["space"].update(matrix_order="column-major"),
        Sentence("manifest.md", '| `matrix_order` | one of `"column"`, `"row"` |'),
        r"matrix_order|column",
    ),
    (
        "producer_without_tool",
        "Names a licence and no tool.",
        _set(producer={"license": "MIT"}),
        Sentence("manifest.md", "| `tool` | string | required |"),
        r"tool|producer",
    ),
    (
        "digest_in_capitals",
        "Wrote the digest in capital letters.",
        lambda m: m["producer"].update(weights_sha256="AB" * 32),
        Sentence("manifest.md", "| `weights_sha256` | string (`^[0-9a-f]{64}$`) |"),
        r"sha256|digest|hex",
    ),
    (
        "tolerance_negative",
        "Wrote a negative tolerance.",
        _set(tolerances={"opacity": -1}),
        Sentence("manifest.md", "| `opacity` | number (≥ 0) | `0.002` | Absolute. |"),
        r"tolerance|opacity",
    ),
    (
        "depends_on_is_a_list",
        "Wrote `depends_on` as a list of roles.",
        _set(depends_on=["view"]),
        Sentence("manifest.md", "| `depends_on` | object of boolean |"),
        r"depends_on",
    ),
    (
        "depends_on_an_unknown_role",
        "Names an input in place of a role in `depends_on`.",
        _set(depends_on={"camera_matrix": False}),
        Sentence(
            "manifest.md",
            "`depends_on` has inputs and roles as keys and takes no extension fields.",
        ),
        r"depends_on|role|camera_matrix",
    ),
    (
        "blend_without_cells",
        "Declares a weighted sum and has no cells.",
        _set(blend="wsr"),
        Sentence("cells.md", "each of which requires the others"),
        r"cells|weighted_sum",
    ),
    (
        "reference_image_missing",
        "Declares a reference image that does not lie beside the model.",
        _set(reference_images=[{**PICTURE, "path": "front.png"}]),
        Sentence("manifest.md", "A PNG in the model's folder or below it."),
        r"front\.png|reference|picture|image",
    ),
    (
        "reference_image_outside_the_folder",
        "Declares a reference image by a path that leaves the folder.",
        _set(reference_images=[{**PICTURE, "path": "../../front.png"}]),
        Sentence("manifest.md", "The path is relative to the model's folder and does not leave it"),
        r"front\.png|folder|outside|leave",
    ),
]
for name, mistake, edit, sentence, cause_words in EDITS:
    fault(
        name,
        FAMILY,
        mistake,
        cause_words,
        build=partial(_edited, edit),
        sentence=sentence,
        level="behaviour" if name.startswith("bounds") else "static",
    )


def _first_input(**values: Any) -> Callable[[Manifest], None]:
    return lambda manifest: manifest["inputs"][0].update(values)


INPUT_EDITS: list[tuple[str, str, Callable[[Manifest], Any], Sentence, str]] = [
    (
        "input_not_declared",
        "Forgot to declare the camera.",
        _set(inputs=[]),
        EVERY_INPUT,
        r"role|declar|camera",
    ),
    (
        "input_name_misspelled",
        "Misspelled the name of the camera.",
        _first_input(name="camara"),
        BY_NAME,
        r"camara|camera",
    ),
    (
        "input_of_another_export",
        "Declares a time that the graph no longer has.",
        lambda m: m["inputs"].append(
            {"name": "time", "role": "time", "range": [0, 1], "default": 0}
        ),
        Sentence("manifest.md", "One entry for each input of the graph."),
        r"time",
    ),
    (
        "role_unknown",
        "Wrote the role as `camera`.",
        _first_input(role="camera"),
        Sentence("manifest.md", "| `role` | a [role](roles.md) | required |"),
        r"role",
    ),
    (
        "input_declared_twice",
        "Declares the camera twice.",
        lambda m: m["inputs"].append(dict(m["inputs"][0])),
        Sentence("roles.md", "Every input of the graph has exactly one role"),
        r"twice|two|same|repeat|once",
    ),
    (
        "shape_declared_wrong",
        "Declares the view as [3, 4].",
        _first_input(shape=[3, 4]),
        Sentence(
            "manifest.md", "If both the manifest and the graph give a shape, they must be equal."
        ),
        r"shape",
    ),
    (
        "default_of_nine_numbers",
        "Gives nine numbers as the default of a 4×4 matrix.",
        _first_input(default=[1, 0, 0, 0, 1, 0, 0, 0, 1]),
        Sentence("manifest.md", "its numbers, row-major; as many as the input has elements"),
        r"default",
    ),
    (
        "default_is_a_word",
        "Wrote the default as `eye`.",
        _first_input(default="eye"),
        Sentence(
            "manifest.md",
            '| `default` | number or one of `"zeros"`, `"identity"` or array of number |',
        ),
        r"default",
    ),
    (
        "convention_of_another_role",
        "Declares a pose's convention on the camera.",
        _first_input(convention="smpl-axis-angle"),
        Sentence("manifest.md", "Which of the role's conventions it follows."),
        r"convention",
    ),
    (
        "depends_on_view_denied",
        "Declares that nothing depends on the view.",
        _set(depends_on={"view": False}),
        Sentence(
            "manifest.md",
            "A key that maps to `false` promises that no output changes with that input",
        ),
        r"depends_on|depend",
    ),
]
for name, mistake, edit, sentence, cause_words in INPUT_EDITS:
    fault(
        name,
        FAMILY,
        mistake,
        cause_words,
        build=partial(_edited, edit, lit=True),
        sentence=sentence,
        level="behaviour" if name.startswith("depends") else "static",
    )
fault(
    "test_vector_of_an_older_model",
    FAMILY,
    "Kept the digest of a model that was trained further since.",
    r"vector|digest|sha256",
    build=partial(
        _edited, _set(test_vectors=[{"inputs": "no inputs", "expected_sha256": "0" * 64}])
    ),
)
