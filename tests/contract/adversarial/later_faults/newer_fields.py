"""Optional fields that are wrong, or do not fit the model."""

from collections.abc import Callable
from functools import partial
from typing import Any

from contract.adversarial.case import Draft, Sentence, fault
from contract.adversarial.drafts import declare, generator, static
from contract.adversarial.dynamic import packed_by_parts
from contract.adversarial.graph_builder import GraphBuilder
from contract.adversarial.scenes import Array, rows, scene, sh_columns

FAMILY = "manifest"

Manifest = dict[str, Any]


def _still(edit: Callable[[Manifest], Any]) -> Draft:
    draft = static(scene("surface", seed=37))
    assert isinstance(draft.manifest, dict)
    edit(draft.manifest)
    return draft


def _driven(
    entry: Manifest,
    shape: tuple[int, ...],
    edit: Callable[[Manifest], Any] = lambda _: None,
    dtype: str = "float32",
) -> Draft:
    """A surface that an input of any shape moves by the mean of its numbers."""
    source = scene("surface", seed=37)
    graph = GraphBuilder()
    graph.input(entry["name"], shape, dtype)
    value = graph.cast(entry["name"], "float32")
    mean = graph.reshape(graph.op("ReduceMean", value, keepdims=0), 1)
    swing = graph.op("Mul", graph.op("Sin", mean), graph.constant([[0.0, 0.2, 0.0]]))
    where = graph.op("Add", swing, graph.constant(source.position))
    packed: Array = rows(source)
    whole = packed_by_parts(
        graph, where, graph.constant(packed[:, 3:4]), graph.constant(packed[:, 4:])
    )
    low, high = source.position.min(0) - 0.2, source.position.max(0) + 0.2
    manifest = declare(source.count, low, high, inputs=[entry])
    edit(manifest)
    return generator(graph, whole, graph.constant(sh_columns(source, 3)), manifest)


def _origin(*numbers: float) -> Callable[[Manifest], Any]:
    return lambda manifest: manifest["space"].update(origin=list(numbers))


def _space(**fields: Any) -> Callable[[Manifest], Any]:
    return lambda manifest: manifest["space"].update(fields)


def _set(**fields: Any) -> Callable[[Manifest], Any]:
    return lambda manifest: manifest.update(fields)


EXTENSION = Sentence("extensions.md", "`extensions_required`")
ORIGIN = Sentence("manifest.md", "| `origin` | [number, number, number] | – |")
STILL: list[tuple[str, str, Callable[[Manifest], Any], Sentence, str]] = [
    (
        "required_extension_not_used",
        "Requires an extension and does not list it as used.",
        _set(extensions_required=["x-studio-lights"]),
        EXTENSION,
        r"extension",
    ),
    (
        "extension_with_capitals",
        "Wrote an extension's name with capital letters.",
        _set(extensions_used=["X-Studio"]),
        Sentence("manifest.md", "| `extensions_used` | array of string"),
        r"extension|x-",
    ),
    (
        "origin_of_two_numbers",
        "Wrote easting and northing as the origin and no height.",
        _origin(432000.0, 5420000.0),
        ORIGIN,
        r"origin",
    ),
    (
        "origin_is_text",
        "Wrote the origin as text, as a GIS prints it.",
        _space(origin="432000, 5420000, 350"),
        ORIGIN,
        r"origin",
    ),
    (
        "metres_per_unit_of_zero",
        "Left the metres of a unit at zero.",
        _space(unit="arbitrary", metres_per_unit=0),
        Sentence("manifest.md", "| `metres_per_unit` | number (> 0) | – |"),
        r"metres_per_unit|above 0|> ?0",
    ),
    (
        "metre_of_a_centimetre",
        "Declares metres and a hundredth of a metre for each unit.",
        _space(metres_per_unit=0.01),
        Sentence("manifest.md", "`unit` `metre` means that `metres_per_unit` is 1"),
        r"metre",
    ),
    (
        "cost_negative",
        "Wrote the cost of a run that failed as −1.",
        _set(cost=[{"device": "RTX 4090", "milliseconds": -1}]),
        Sentence("manifest.md", "| `milliseconds` | number (≥ 0) | – |"),
        r"cost|milliseconds",
    ),
    (
        "cost_is_a_number",
        "Wrote the cost as a number of milliseconds.",
        _set(cost=3.5),
        Sentence("manifest.md", "| `cost` | array of object"),
        r"cost",
    ),
    (
        "profile_that_nobody_defined",
        "Wrote the name of a provider as the operator profile.",
        _set(operator_profile="webgpu"),
        Sentence("manifest.md", "`operator_profile` names a set of operators"),
        r"profile",
    ),
    (
        "external_data_of_another_file",
        "Lists the digest of a weights file that the model does not have.",
        _set(external_data=[{"path": "weights.bin", "sha256": "0" * 64}]),
        Sentence("manifest.md", "The digest is that of the whole file"),
        r"weights\.bin|external",
    ),
]
for name, mistake, edit, sentence, cause in STILL:
    fault(
        name, FAMILY, mistake, cause, build=partial(_still, edit), sentence=sentence, level="values"
    )

JOINTS = [
    {"name": "hips"},
    {"name": "chest", "parent": "hips"},
    {"name": "left", "parent": "chest"},
    {"name": "right", "parent": "chest"},
]
POSE: Manifest = {
    "name": "pose",
    "role": "pose",
    "shape": [4, 3],
    "convention": "axis-angle",
    "range": [-1, 1],
    "default": "zeros",
}
PARENTS = Sentence("manifest.md", "one entry for each row and parents before children")
SOUND = Sentence("manifest.md", "`rate`, `window` and `hop` describe the sound")
SHAPES = Sentence("roles.md", "one of")
MEL: Manifest = {"name": "sound", "role": "audio", "convention": "mel", "shape": [16, 8]}
SAMPLES: Manifest = {"name": "sound", "role": "audio", "convention": "samples", "shape": [256]}
FACE: Manifest = {
    "name": "face",
    "role": "expression",
    "range": [0, 1],
    "default": "zeros",
    "convention": "arkit-52",
}
DRIVEN: list[tuple[str, str, Manifest, tuple[int, ...], Sentence, str]] = [
    (
        "joint_before_its_parent",
        "Listed the joints by name, so that a child stands before its parent.",
        POSE | {"joints": sorted(JOINTS, key=lambda joint: joint["name"])},
        (4, 3),
        PARENTS,
        r"parent|joint",
    ),
    (
        "joint_of_the_tracker_missing",
        "Listed three joints of four.",
        POSE | {"joints": JOINTS[:3]},
        (4, 3),
        PARENTS,
        r"joint",
    ),
    (
        "joint_named_twice",
        "Named two joints alike.",
        POSE | {"joints": [*JOINTS[:3], {"name": "left", "parent": "chest"}]},
        (4, 3),
        PARENTS,
        r"joint|twice|left",
    ),
    (
        "parent_by_number",
        "Wrote the parents as numbers, as SMPL's kintree has them.",
        POSE | {"joints": [{"name": "hips"}, *({**j, "parent": 0} for j in JOINTS[1:])]},
        (4, 3),
        Sentence("manifest.md", "| `parent` | string | – |"),
        r"parent|joint",
    ),
    (
        "joints_on_a_slider",
        "Listed joints on an input that is no pose.",
        {
            "name": "face",
            "role": "expression",
            "shape": [4],
            "range": [0, 1],
            "default": "zeros",
            "joints": JOINTS,
        },
        (4,),
        Sentence("manifest.md", "`joints` describes the skeleton behind a `pose`"),
        r"joint",
    ),
    ("sound_without_rate", "Forgot the sample rate.", SAMPLES, (256,), SOUND, r"\brate\b"),
    (
        "mel_without_hop",
        "Declares a mel spectrogram and no window or hop.",
        MEL | {"rate": 16000},
        (16, 8),
        SOUND,
        r"window|hop",
    ),
    (
        "rate_on_a_slider",
        "Declares the sample rate on the expression that the sound drives.",
        {
            "name": "face",
            "role": "expression",
            "shape": [4],
            "range": [0, 1],
            "default": "zeros",
            "rate": 16000,
        },
        (4,),
        SOUND,
        r"\brate\b|audio",
    ),
    (
        "fifty_one_blend_shapes",
        "Dropped tongueOut, so that 51 blend shapes are declared as ARKit's 52.",
        FACE | {"shape": [51]},
        (51,),
        Sentence("roles.md", "`arkit-52`"),
        r"52|arkit|convention",
    ),
    (
        "mano_of_sixteen_and_a_wrist",
        "Declares MANO's convention for a hand of 21 tracked points.",
        POSE | {"shape": [21, 3], "convention": "mano"},
        (21, 3),
        Sentence("roles.md", "`mano`"),
        r"mano|convention|16",
    ),
    (
        "flame_of_smpl",
        "Declares FLAME's convention for the 24 joints of SMPL.",
        POSE | {"shape": [24, 3], "convention": "flame"},
        (24, 3),
        Sentence("roles.md", "`flame`"),
        r"flame|convention|\b5\b",
    ),
]
for name, mistake, entry, shape, sentence, cause in DRIVEN:
    fault(
        name,
        FAMILY,
        mistake,
        cause,
        build=partial(_driven, entry, shape),
        sentence=sentence,
        level="values",
    )
fault(
    "dependence_denied_by_name",
    FAMILY,
    "Denies by its name that an input matters, a leftover of an ablation.",
    r"depend",
    build=partial(
        _driven, POSE, (4, 3), lambda manifest: manifest.update(depends_on={"pose": False})
    ),
    sentence=Sentence("manifest.md", "Input or role → does any output change with it"),
)
fault(
    "blend_shapes_in_percent",
    FAMILY,
    "Declares ARKit's blend weights from 0 to 100.",
    r"0, 1|percent|range",
    build=partial(_driven, FACE | {"shape": [52], "range": [0, 100]}, (52,)),
)
