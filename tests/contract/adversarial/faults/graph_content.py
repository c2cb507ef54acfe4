"""Operators, inputs and weights inside the graph that the contract does not allow."""

from functools import partial
from typing import Any

from onnx import TensorProto, ValueInfoProto

from contract.adversarial.case import Draft, Sentence, fault
from contract.adversarial.drafts import declare, generator, static
from contract.adversarial.dynamic import CAMERA_INPUTS, inside_frustum, packed_by_parts
from contract.adversarial.graph_builder import GraphBuilder
from contract.adversarial.scenes import rows, scene, sh_columns

FAMILY = "graph"

EVERY_INPUT = Sentence("index.md", "Every input of the graph must have a role.")
DOMAINS = Sentence("targets.md", "other domains only where the table lists them")
FOLDER = Sentence(
    "index.md",
    "Weights may lie in external data files, if these are in the model's folder or below it.",
)
CAPTURE = Sentence(
    "manifest.md",
    "`static_shapes` promises that no tensor inside the model changes its shape between runs",
)


def _data_dependent() -> Draft:
    """Visible rows by NonZero: tensors inside change their size with the camera."""
    source = scene("surface", seed=31)
    graph = GraphBuilder()
    view, projection = graph.input("camera", [4, 4]), graph.input("proj", [4, 4])
    visible_mask = graph.reshape(inside_frustum(graph, source.position, view, projection, 0.35), 64)
    index = graph.reshape(graph.op("NonZero", visible_mask), -1)
    gathered = graph.op("Gather", graph.constant(rows(source)), index, axis=0)
    live = graph.op("Shape", index)
    missing = graph.op("Sub", graph.constant([64], "int64"), live)
    zero = graph.constant([0], "int64")
    pads = graph.op("Concat", zero, zero, missing, zero, axis=0)
    packed = graph.op("Pad", gathered, pads)
    color = graph.op(
        "Pad", graph.op("Gather", graph.constant(sh_columns(source, 3)), index, axis=0), pads
    )
    low, high = source.position.min(0), source.position.max(0)
    manifest = declare(64, low, high, inputs=CAMERA_INPUTS)
    manifest["capture"] = {"static_shapes": True}
    return generator(graph, packed, color, manifest, count=graph.cast(live, "int32"))


for target in ("core", "webgpu"):
    fault(
        f"visible_rows_by_nonzero_{target}",
        FAMILY,
        "Selects visible rows with NonZero, so shapes inside the model change.",
        r"nonzero|static_shapes|shape.{0,60}(data|run|change|depend|dynamic)|dynamic",
        build=_data_dependent,
        sentence=CAPTURE,
        target=target,
    )


def _foreign_operator() -> Draft:
    source = scene("surface", seed=32)
    graph = GraphBuilder()
    graph.import_domain("com.microsoft", 1)
    color = graph.op("Gelu", graph.constant(sh_columns(source, 3)), domain="com.microsoft")
    manifest = declare(64, source.position.min(0), source.position.max(0))
    return generator(graph, graph.constant(rows(source)), color, manifest)


def _unknown_operator() -> Draft:
    source = scene("surface", seed=32)
    graph = GraphBuilder()
    graph.import_domain("diff_gaussian_rasterization", 1)
    color = graph.op(
        "ComputeColorFromSH",
        graph.constant(sh_columns(source, 3)),
        domain="diff_gaussian_rasterization",
    )
    manifest = declare(64, source.position.min(0), source.position.max(0))
    return generator(graph, graph.constant(rows(source)), color, manifest)


def _float16_builtin(kind: str) -> Draft:
    """An operator that does not exist in the declared operator set."""
    source = scene("surface", seed=32)
    graph = GraphBuilder(opset=17)
    color = graph.op(kind, graph.constant(sh_columns(source, 3)))
    manifest = declare(64, source.position.min(0), source.position.max(0))
    return generator(graph, graph.constant(rows(source)), color, manifest)


fault(
    "operator_of_another_domain",
    FAMILY,
    "An optimiser fused operators into a domain of its own.",
    r"domain|com\.microsoft",
    build=_foreign_operator,
    sentence=DOMAINS,
)
fault(
    "operator_that_nobody_has",
    FAMILY,
    "Exported a CUDA extension as a custom operator.",
    r"domain|custom|operator|diff_gaussian",
    build=_unknown_operator,
    sentence=DOMAINS,
    loads=False,
)
fault(
    "operator_newer_than_its_set",
    FAMILY,
    "Declared operator set 17 and used Gelu of operator set 20.",
    r"gelu|opset|operator",
    build=partial(_float16_builtin, "Gelu"),
    sentence=Sentence("index.md", "A generator is one ONNX file (a serialised `ModelProto`)."),
    checker=False,
    loads=False,
)


def _extra_input(name: str, dtype: str) -> Draft:
    draft = static(scene("surface", seed=33))
    info = ValueInfoProto(name=name)
    info.type.tensor_type.elem_type = TensorProto.BOOL if dtype == "bool" else TensorProto.FLOAT
    info.type.tensor_type.shape.dim.add().dim_value = 1
    draft.proto.graph.input.append(info)
    return draft


for name, dtype, mistake in (
    ("training", "bool", "Exported the module's `training` flag as an input."),
    ("background", "float32", "Exported the background colour of the rasteriser as an input."),
):
    fault(
        f"input_{name}_without_role",
        FAMILY,
        mistake,
        r"role|declar|" + name,
        build=partial(_extra_input, name, dtype),
        sentence=EVERY_INPUT,
    )


def _external(location: str, offset: int, length: int, files: dict[str, bytes]) -> Draft:
    draft = static(scene("surface", seed=34))
    tensor = draft.proto.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    for key, value in (("location", location), ("offset", offset), ("length", length)):
        tensor.external_data.add(key=key, value=str(value))
    return Draft(draft.proto, draft.manifest, files)


WEIGHTS = rows(scene("surface", seed=34)).astype("<f4").tobytes()
EXTERNALS: list[tuple[str, str, tuple[Any, ...], str]] = [
    (
        "weights_left_behind",
        "Copied the model without its .data file.",
        ("model.onnx.data", 0, len(WEIGHTS), {}),
        r"model\.onnx\.data|missing|external|not exist",
    ),
    (
        "weights_in_the_parent_folder",
        "The .data file lies in the folder above.",
        ("../weights.bin", 0, len(WEIGHTS), {}),
        r"\.\./weights|folder|outside|external",
    ),
    (
        "weights_by_absolute_path",
        "The .data file is named by its path on the author's disk.",
        ("/home/me/weights.bin", 0, len(WEIGHTS), {}),
        r"absolute|/home/me|folder|outside|external",
    ),
    (
        "weights_cut_short",
        "The download of the .data file broke off.",
        ("model.onnx.data", 0, len(WEIGHTS), {"model.onnx.data": WEIGHTS[:1000]}),
        r"bytes|short|end|length|external|truncat",
    ),
    (
        "weights_beyond_the_end",
        "The offset is that of another .data file.",
        ("model.onnx.data", 1 << 20, len(WEIGHTS), {"model.onnx.data": WEIGHTS}),
        r"offset|bytes|end|external|short",
    ),
    (
        "weights_of_another_length",
        "The length is that of another tensor.",
        ("model.onnx.data", 0, 40, {"model.onnx.data": WEIGHTS}),
        r"length|bytes|external",
    ),
]
for name, mistake, arguments, cause in EXTERNALS:
    fault(
        name,
        FAMILY,
        mistake,
        cause,
        build=partial(_external, *arguments),
        sentence=FOLDER,
        checker=name
        in ("weights_cut_short", "weights_beyond_the_end", "weights_of_another_length"),
        loads=False,
    )


def _cullers_nan() -> Draft:
    """Inverts the view by its determinant, which zeroed inputs do not have."""
    source = scene("surface", seed=35)
    graph = GraphBuilder()
    view = graph.input("camera", [4, 4])
    determinant = graph.op("Det", view)
    factor = graph.op("Div", determinant, determinant)
    where = graph.op("Mul", graph.constant(source.position), factor)
    parts = rows(source)
    packed = packed_by_parts(
        graph, where, graph.constant(parts[:, 3:4]), graph.constant(parts[:, 4:])
    )
    low, high = source.position.min(0), source.position.max(0)
    manifest = declare(64, low, high, inputs=CAMERA_INPUTS[:1])
    return generator(graph, packed, graph.constant(sh_columns(source, 3)), manifest)


fault(
    "zeroed_view_is_nan",
    FAMILY,
    "Inverts the view matrix, which does not exist for zeroed inputs.",
    r"\bnan\b|finite|zero",
    build=_cullers_nan,
    sentence=Sentence(
        "roles.md", "A generator must give finite outputs when all its inputs are zero"
    ),
)


def _viewport_nan() -> Draft:
    source = scene("surface", seed=35)
    graph = GraphBuilder()
    size = graph.input("size", [2])
    aspect = graph.op("Div", graph.gather(size, [0], 0), graph.gather(size, [1], 0))
    opacity = graph.op("Pow", graph.constant(source.opacity[:, None]), aspect)
    parts = rows(source)
    packed = packed_by_parts(
        graph, graph.constant(parts[:, :3]), opacity, graph.constant(parts[:, 4:])
    )
    low, high = source.position.min(0), source.position.max(0)
    entry = {"name": "size", "role": "viewport", "default": [1280, 720]}
    manifest = declare(64, low, high, inputs=[entry])
    return generator(graph, packed, graph.constant(sh_columns(source, 3)), manifest)


fault(
    "zeroed_viewport_is_nan",
    FAMILY,
    "Divides width by height, which are both zero in the first run.",
    r"\bnan\b|finite|zero",
    build=_viewport_nan,
    sentence=Sentence(
        "roles.md", "A generator must give finite outputs when all its inputs are zero"
    ),
)
