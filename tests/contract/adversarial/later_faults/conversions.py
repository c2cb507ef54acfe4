"""Numbers converted once too often or too rarely, and files that say it in another form."""

import base64
import hashlib
import json
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from contract.adversarial.avatars import avatar_model, skinned
from contract.adversarial.case import Draft, Sentence, fault
from contract.adversarial.companions import post_process
from contract.adversarial.drafts import declare, generator, static
from contract.adversarial.dynamic import packed_by_parts
from contract.adversarial.graph_builder import GraphBuilder
from contract.adversarial.scenes import C0, Scene, rows, scene, sh_columns, upper_triangle

FAMILY = "conversions"
N = 400
DOCUMENT = Sentence("manifest.md", "The manifest is a JSON document (RFC 8259)")
DEGREE = Sentence("layout.md", "C follows from `space` and `degree`.")
ROW = Sentence("layout.md", "| `gaussians` | float32 or float16 | [N, 10] |")
INSIDE = Sentence(
    "manifest.md",
    "An axis-aligned box of all Gaussian centres for all inputs, checked with test inputs.",
)
INCLUDED = Sentence("manifest.md", "Smallest and largest meaningful value, both included.")


def _colored(kind: str, convert: Callable[[Scene], Any]) -> Draft:
    source = scene(kind, seed=41, n=N)
    return static(source, color=convert(source), space="rgb")


def _spread(kind: str, convert: Callable[[Scene], Any]) -> Draft:
    source = scene(kind, seed=42, n=N)
    packed = rows(source)
    packed[:, 4:] = convert(source)
    return static(source, packed=packed)


def _on_the_screen(source: Scene) -> np.ndarray:
    upper = 400.0 * upper_triangle(source.scale, source.rotation)
    upper[:, [2, 4, 5]] = 0
    return upper


def _blurred(source: Scene) -> np.ndarray:
    return upper_triangle(source.scale, source.rotation) + np.array([0.3, 0, 0, 0.3, 0, 0.3])


COLORS: list[tuple[str, str, Callable[[Scene], Any], str]] = [
    (
        "rgb_squashed_twice",
        "Applied the sigmoid to the output of a network that ends with one.",
        lambda source: 1 / (1 + np.exp(-source.rgb)),
        r"sigmoid.{0,40}twice",
    ),
    (
        "rgb_divided_twice",
        "Divided colours by 255 that were between 0 and 1 already.",
        lambda source: source.rgb / 255,
        r"255",
    ),
    (
        "rgb_without_the_half",
        "Evaluated the constant term and clamped it without adding 0.5.",
        lambda source: np.clip(C0 * source.sh[:, 0], 0, 1),
        r"0\.5|half",
    ),
]
for name, mistake, convert, words in COLORS:
    for kind in ("surface", "room"):
        build = partial(_colored, kind, convert)
        fault(f"{name}_{kind}", FAMILY, mistake, words, build=build)
SIZE = r"(size|standard deviation|variance|large).{0,80}(neighbou?r|blur|bounds|diagonal|scene)"
SIZES: list[tuple[str, str, Callable[[Scene], Any]]] = [
    (
        "covariance_of_the_screen",
        "Kept the 2D covariance in pixels and filled its third axis with zeros.",
        _on_the_screen,
    ),
    (
        "blur_of_the_screen_in_the_world",
        "Copied the 0.3 that the rasteriser adds in pixels into the covariance of the scene.",
        _blurred,
    ),
]
for name, mistake, spread in SIZES:
    for kind in ("surface", "hair"):
        fault(f"{name}_{kind}", FAMILY, mistake, SIZE, build=partial(_spread, kind, spread))


def _twice(kind: str) -> Draft:
    source = scene(kind, seed=43)
    packed, color = (np.tile(part, (2, 1)) for part in (rows(source), sh_columns(source, 3)))
    return static(source, packed=packed, color=color)


for kind in ("surface", "cloud"):
    fault(
        f"every_row_twice_{kind}",
        FAMILY,
        "Concatenated a checkpoint with itself when two parts were merged.",
        r"equal another|twice|copies|duplicate",
        build=partial(_twice, kind),
    )


def _written(text: Callable[[dict[str, Any]], str]) -> Draft:
    draft = static(scene("surface"))
    assert isinstance(draft.manifest, dict)
    return Draft(draft.proto, text(draft.manifest))


TEXTS: list[tuple[str, str, Callable[[dict[str, Any]], str], str]] = [
    (
        "manifest_in_a_list",
        "Wrote a list of manifests, for several models in one file.",
        lambda manifest: json.dumps([manifest]),
        r"JSON object",
    ),
    (
        "manifest_in_base64",
        "Encoded the manifest in base64, as the bucket's metadata wants it.",
        lambda manifest: base64.b64encode(json.dumps(manifest).encode()).decode(),
        r"JSON document",
    ),
    (
        "manifest_inside_another_object",
        "Wrote all metadata as one object, the manifest under its key.",
        lambda manifest: json.dumps({"gsgen.manifest": manifest}),
        r"contract|version|unknown|gsgen\.manifest",
    ),
    (
        "bounds_are_infinite",
        "Declared infinite bounds, since the scene has a sky.",
        lambda manifest: json.dumps(
            manifest | {"bounds": {"min": [-np.inf] * 3, "max": [np.inf] * 3}}
        ),
        r"finite|Infinity|bounds",
    ),
]
for name, mistake, text, words in TEXTS:
    fault(name, FAMILY, mistake, words, build=partial(_written, text), sentence=DOCUMENT)


def _with_alpha() -> Draft:
    source = scene("surface")
    degree_one_sh = np.concatenate([source.sh[:, :4], np.zeros((source.count, 4, 1))], axis=2)
    return static(source, color=degree_one_sh.reshape(source.count, 16), degree=1)


def _with_a_fourth_degree() -> Draft:
    source = scene("surface")
    color = np.concatenate([sh_columns(source, 3), np.zeros((source.count, 27))], axis=1)
    return static(source, color=color, degree=4)


def _with_a_floater() -> Draft:
    source = scene("surface", n=N)
    packed = rows(source)
    packed[7, :3] = 40, 3, 1
    return static(source, packed=packed, bounds=(source.position.min(0), source.position.max(0)))


def _with_names_exchanged() -> Draft:
    draft = static(scene("surface"))
    assert isinstance(draft.manifest, dict)
    outputs = draft.manifest["outputs"]
    outputs["gaussians"]["name"], outputs["appearance"]["name"] = "color", "gaussians"
    return draft


def _with_a_jpeg() -> Draft:
    draft = static(scene("surface"))
    assert isinstance(draft.manifest, dict)
    content = b"\xff\xd8\xff\xe0" + bytes(600)
    image = {
        "path": "front.jpg",
        "sha256": hashlib.sha256(content).hexdigest(),
        "inputs": "no inputs",
        "view": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4]],
        "focal": [100, 100],
        "center": [50, 50],
    }
    declared = {"reference_images": [image]}
    return Draft(draft.proto, draft.manifest | declared, {"front.jpg": content})


def _turned_in_degrees() -> Draft:
    source = scene("avatar")
    entry = {
        "name": "pose",
        "role": "pose",
        "shape": [4, 3],
        "convention": "axis-angle",
        "range": [-180, 180],
        "default": "zeros",
    }
    graph = GraphBuilder()
    radians = graph.op("Mul", graph.input("pose", [4, 3]), graph.constant(np.pi / 180))
    return avatar_model(graph, source, skinned(graph, source, radians), [entry], room=0.1)


def _one_embedding_too_few() -> Draft:
    source = scene("surface", seed=44)
    entry = {"name": "who", "role": "appearance_id", "range": [0, 10], "default": 0}
    graph = GraphBuilder()
    table = graph.constant(np.random.default_rng(0).normal(0, 0.05, (10, 3)))
    shift = graph.op("Gather", table, graph.input("who", [1], "int32"), axis=0)
    where = graph.op("Add", graph.constant(source.position), shift)
    packed = rows(source)
    row = packed_by_parts(graph, where, *map(graph.constant, (packed[:, 3:4], packed[:, 4:])))
    low, high = source.position.min(0) - 0.3, source.position.max(0) + 0.3
    manifest = declare(source.count, low, high, inputs=[entry])
    return generator(graph, row, graph.constant(sh_columns(source, 3)), manifest)


def _enlarged() -> Draft:
    graph = GraphBuilder()
    image = graph.input("image", (1, 3, "h", "w"))
    larger = graph.op("Resize", image, "", graph.constant([1, 1, 2, 2]), mode="nearest")
    graph.output("enhanced", larger, (1, 3, "h2", "w2"))
    manifest = post_process().manifest
    assert isinstance(manifest, dict)
    return Draft(graph.proto, manifest | {"inputs": manifest["inputs"][:1]})


FILES: list[tuple[str, str, Callable[[], Draft], Sentence, str]] = [
    ("harmonics_with_alpha", "Kept an alpha in each coefficient.", _with_alpha, DEGREE, r"16"),
    (
        "harmonics_of_degree_4",
        "Exported degree 4, which the training code can learn.",
        _with_a_fourth_degree,
        DEGREE,
        r"degree.{0,40}4|\b75\b|maximum 3",
    ),
    ("bounds_without_a_floater", "Measured without outliers.", _with_a_floater, INSIDE, r"bounds"),
    (
        "outputs_named_the_wrong_way_round",
        "Exchanged the names of rows and colours in the manifest.",
        _with_names_exchanged,
        ROW,
        r"\b10\b|48",
    ),
    (
        "reference_picture_is_a_jpeg",
        "Saved the reference picture as a JPEG.",
        _with_a_jpeg,
        Sentence("manifest.md", "A PNG in the model's folder or below it."),
        r"PNG",
    ),
    (
        "pose_converted_from_degrees",
        "Takes degrees and converts them inside the model.",
        _turned_in_degrees,
        Sentence("roles.md", "radians"),
        r"degrees.{0,40}radians",
    ),
    (
        "one_embedding_too_few",
        "Declared ids up to 10 for ten embeddings.",
        _one_embedding_too_few,
        INCLUDED,
        r"who=10|out of",
    ),
    (
        "picture_twice_the_size",
        "Exported a network of super-resolution as a filter.",
        _enlarged,
        Sentence("manifest.md", "height and width must be `scale` times those of the input"),
        r"size of the input",
    ),
]
for name, mistake, build_file, sentence, words in FILES:
    fault(name, FAMILY, mistake, words, build=build_file, sentence=sentence)
