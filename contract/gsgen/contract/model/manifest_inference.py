"""Infers a manifest for a model that has none, and lists every inferred fact.

Only whole names are recognised, never parts of them. The author confirms or corrects each
guess before the manifest is embedded.
"""

__all__ = ["infer_manifest"]

from typing import Literal

from gsgen.contract.model.graph import Graph, Tensor, static_dims
from gsgen.contract.spec.fields.roles import ROLES, Shape, matching_shape
from gsgen.contract.spec.layout import APPEARANCE_CHANNELS, ROW_LENGTH
from gsgen.contract.spec.manifest import (
    AppearanceOutput,
    CountOutput,
    GaussiansOutput,
    GeneratorManifest,
    GeneratorOutputs,
    Input,
    Space,
)
from gsgen.contract.spec.manifest_io import Candidate
from gsgen.contract.spec.spherical_harmonics import degree_of

_INPUT_NAMES = {
    "view": ("view", "view_matrix", "viewmatrix", "camera", "camera_matrix", "viewmat", "w2c"),
    "projection": ("proj", "projection", "projection_matrix", "proj_matrix", "projmat"),
    "time": ("time", "t", "timestamp"),
    "frame_index": ("frame", "frame_index", "frame_id"),
    "camera_position": ("camera_position", "camera_center", "campos", "cam_pos"),
    "viewport": ("viewport", "resolution", "image_size"),
    "pose": ("pose", "poses", "body_pose", "joint_rotations"),
    "shape": ("shape", "betas", "shapes"),
    "root_translation": ("trans", "root_translation", "transl", "translation"),
    "root_rotation": ("root_rotation", "global_orient", "root_orient"),
    "expression": ("expression", "expr"),
    "appearance_id": ("appearance_id", "appearance", "embedding_id"),
}
_GAUSSIAN_NAMES = ("gaussians", "gaussian", "gaussian_f16", "gaussian_f32", "gaussian_packed")
_COLOR_NAMES = (
    "color",
    "colors",
    "color_sh",
    "color_rgb",
    "sh",
    "shs",
    "rgb",
    "features",
    "sh_f16",
)
_COUNT_NAMES = ("num_points", "count", "num_gaussians", "n_points")
_PLACEHOLDER_CAPACITY = 1


def infer_manifest(graph: Graph, name: str) -> Candidate:
    """Infer a model's manifest from the names and shapes of its graph's tensors."""
    manifest_guesses: list[str] = []
    inputs = tuple(_input(tensor, manifest_guesses) for tensor in graph.inputs if _role_of(tensor))
    unknown = [tensor.name for tensor in graph.inputs if not _role_of(tensor)]
    manifest_guesses += [
        f"input {name!r} has no recognisable role: add it by hand" for name in unknown
    ]
    outputs = GeneratorOutputs(
        _gaussians(graph, manifest_guesses),
        _appearance(graph, manifest_guesses),
        _count(graph, manifest_guesses),
    )
    manifest = GeneratorManifest(name=name, inputs=inputs, outputs=outputs, space=Space())
    manifest_guesses.append(
        "space: -y up, arbitrary unit, column matrix order (the usual for 3DGS)"
    )
    manifest_guesses.append("bounds: unknown, add the box that holds the Gaussians")
    return Candidate(manifest, tuple(manifest_guesses))


def _role_of(tensor: Tensor) -> str | None:
    lower_name = tensor.name.lower()
    return next((role for role, names in _INPUT_NAMES.items() if lower_name in names), None)


def _input(tensor: Tensor, manifest_guesses: list[str]) -> Input:
    role = _role_of(tensor)
    assert role is not None
    manifest_guesses.append(f"input {tensor.name!r} is the {role}, by its name")
    fixed_dims = static_dims(tensor)
    entry = ROLES[role]
    has_free_shape = fixed_dims is not None and matching_shape(entry, fixed_dims) is not None
    has_named_axes = any(isinstance(dim, str) for shape in entry.shapes for dim in shape)
    span = (0.0, 1.0) if role == "time" or entry.needs_range else None
    if span:
        manifest_guesses.append(f"input {tensor.name!r} has the range [0, 1]")
    return Input(
        name=tensor.name,
        role=role,
        shape=_fixed_sizes(fixed_dims) if has_free_shape and has_named_axes else None,
        range=span,
        default="zeros",
    )


def _fixed_sizes(dims: Shape | None) -> tuple[int, ...] | None:
    return tuple(int(dim) for dim in dims) if dims is not None else None


def _find_named(graph: Graph, names: tuple[str, ...]) -> Tensor | None:
    return next((t for t in graph.outputs if t.name.lower() in names), None)


def _last_dim(tensor: Tensor) -> int:
    dim = tensor.dims[-1] if tensor.dims else None
    return dim if isinstance(dim, int) else 0


def _gaussians(graph: Graph, manifest_guesses: list[str]) -> GaussiansOutput | None:
    tensor = _find_named(graph, _GAUSSIAN_NAMES)
    packed_outputs = [tensor for tensor in graph.outputs if _last_dim(tensor) == ROW_LENGTH]
    if tensor is None and len(packed_outputs) == 1:
        tensor = packed_outputs[0]
    if tensor is None:
        manifest_guesses.append(
            f"no output is named like packed Gaussians or is the only one ending in {ROW_LENGTH}"
        )
        return None
    manifest_guesses.append(f"output {tensor.name!r} holds the packed Gaussians")
    first = tensor.dims[0] if tensor.dims else None
    capacity = first if isinstance(first, int) and first > 0 else _PLACEHOLDER_CAPACITY
    return GaussiansOutput(tensor.name, capacity, _float_dtype(tensor))


def _float_dtype(tensor: Tensor) -> Literal["float32", "float16"]:
    return "float16" if tensor.dtype == "float16" else "float32"


def _appearance(graph: Graph, manifest_guesses: list[str]) -> AppearanceOutput | None:
    tensor = _find_named(graph, _COLOR_NAMES)
    if tensor is None:
        manifest_guesses.append("no output is named like an appearance")
        return None
    channels = _last_dim(tensor)
    if channels in APPEARANCE_CHANNELS["sh"] and channels != 3:
        degree = degree_of(channels // 3)
        manifest_guesses.append(
            f"output {tensor.name!r} holds SH of degree {degree}, by its {channels} channels"
        )
        return AppearanceOutput(tensor.name, "sh", degree)
    manifest_guesses.append(
        f"output {tensor.name!r} holds raw RGB, by its {channels or '?'} channels"
    )
    return AppearanceOutput(tensor.name, "rgb")


def _count(graph: Graph, manifest_guesses: list[str]) -> CountOutput | None:
    tensor = _find_named(graph, _COUNT_NAMES)
    if tensor is None:
        manifest_guesses.append("no output is named like a row count")
        return None
    manifest_guesses.append(f"output {tensor.name!r} is the number of live rows")
    return CountOutput(tensor.name)
