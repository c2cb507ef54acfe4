"""Computes the transforms of the nodes of a glTF scene, and applies them to splats.

The format is that of the glTF 2.0 specification, section 3.5 (Khronos).
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64

from gsgen.contract.spec.geometry import rotation_matrix
from gsgen.formats.glb.container import (
    Container,
    Json,
    array_member,
    number_member,
    require_integer,
)
from gsgen.formats.shared.errors import HeaderMalformed, NotSupported
from gsgen.formats.shared.harmonics import rotate_sh
from gsgen.formats.shared.origins import relative_positions
from gsgen.formats.shared.quantities import log, rotations, unit
from gsgen.formats.shared.splats import Splats

Matrix = Float64[np.ndarray, "4 4"]

_IDENTITY_TRANSFORM = tuple(np.eye(4).flatten().tolist())
_MAX_DEPTH = 200


def meshes(glb: Container) -> Iterator[tuple[int, Matrix]]:
    """Yield the meshes of a glTF scene, each with its mesh→world matrix."""
    pending_nodes = [(index, np.eye(4), 0) for index in reversed(_root_nodes(glb))]
    visited_nodes: set[int] = set()
    while pending_nodes:
        index, parent_matrix, depth = pending_nodes.pop()
        where = f"nodes[{index}]"
        if index in visited_nodes or depth > _MAX_DEPTH:
            raise HeaderMalformed(
                "the node is its own ancestor or has two parents", where=where, expected="a tree"
            )
        visited_nodes.add(index)
        node = glb.item("nodes", index, where)
        matrix = parent_matrix @ _local_matrix(node, where)
        if "mesh" in node:
            yield require_integer(node["mesh"], f"{where}.mesh"), matrix
        child_indices = [
            require_integer(child, f"{where}.children")
            for child in array_member(node, "children", where)
        ]
        pending_nodes += [(child, matrix, depth + 1) for child in reversed(child_indices)]


def _root_nodes(glb: Container) -> list[int]:
    if "scenes" in glb.document:
        scene = glb.item("scenes", glb.document.get("scene", 0), "scene")
        return [
            require_integer(root, "scene.nodes") for root in array_member(scene, "nodes", "scene")
        ]
    nodes = array_member(glb.document, "nodes", "document")
    child_indices: set[Any] = set()
    for index, node in enumerate(nodes):
        if isinstance(node, dict):
            children = array_member(node, "children", f"nodes[{index}]")
            child_indices |= {
                require_integer(child, f"nodes[{index}].children") for child in children
            }
    return [index for index in range(len(nodes)) if index not in child_indices]


def _local_matrix(node: Json, where: str) -> Matrix:
    if "matrix" in node:
        matrix = np.array(number_member(node, "matrix", _IDENTITY_TRANSFORM, where)).reshape(4, 4).T
    else:
        x, y, z, w = number_member(node, "rotation", (0.0, 0.0, 0.0, 1.0), where)
        scale = number_member(node, "scale", (1.0, 1.0, 1.0), where)
        matrix = np.eye(4)
        matrix[:3, :3] = rotation_matrix(np.array([[w, x, y, z]]))[0] * scale
        matrix[:3, 3] = number_member(node, "translation", (0.0, 0.0, 0.0), where)
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise HeaderMalformed(
            f"the last row of the matrix is {matrix[3].tolist()}",
            where=f"{where}.matrix",
            expected="0 0 0 1",
        )
    if not np.linalg.det(matrix[:3, :3]) > 0:
        raise NotSupported(
            "the transform of the node mirrors or flattens",
            where=where,
            expected="a scale above 0 along every axis",
        )
    return np.asarray(matrix)


def transform_splats(splats: Splats, matrix: Matrix) -> Splats:
    """Transform ``splats`` by a matrix M: Σ becomes M Σ Mᵀ, and SH are rotated.

    Positions that float32 would round become relative to an origin.
    """
    linear_part = matrix[:3, :3]
    if np.array_equal(matrix, np.eye(4)):
        return splats
    u, sizes, right_vectors = np.linalg.svd(linear_part)
    rotation_part = u @ right_vectors
    offset = linear_part @ splats.origin + matrix[:3, 3]
    position, origin, rounding = relative_positions(splats.position @ linear_part.T + offset)
    if np.allclose(sizes, sizes[0], rtol=1e-6):  # without shear the axes stay orthogonal
        rotation = _rotated_quaternions(splats.rotation, rotation_part)
        log_scale = splats.log_scale + np.float32(np.log(sizes[0]))
    else:
        ellipsoid_axes = np.einsum("ij,njk->nik", linear_part, rotation_matrix(splats.rotation))
        with np.errstate(over="ignore"):
            ellipsoid_axes *= np.exp(splats.log_scale.astype(np.float64))[:, None, :]
        axes, scale = _axes(ellipsoid_axes)
        rotation, log_scale = rotations(axes), log(scale)
    return replace(
        splats,
        position=position,
        origin=origin,
        rounding=rounding if any(origin) else 0.0,
        rotation=rotation,
        log_scale=log_scale.astype(np.float32),
        sh=rotate_sh(splats.sh, rotation_part),
    )


def _rotated_quaternions(
    rotation: Float32[np.ndarray, "n 4"], rotation_part: Float64[np.ndarray, "3 3"]
) -> Float32[np.ndarray, "n 4"]:
    """Rotate quaternions by a rotation matrix, and make their largest component positive."""
    w, x, y, z = rotations(rotation_part[None])[0].astype(np.float64)
    a, b, c, d = unit(rotation).T.astype(np.float64)
    quaternions = np.stack(
        [
            w * a - x * b - y * c - z * d,
            x * a + w * b - z * c + y * d,
            y * a + z * b + w * c - x * d,
            z * a - y * b + x * c + w * d,
        ]
    )
    largest = np.abs(quaternions).argmax(axis=0)
    quaternions *= np.where(quaternions[largest, np.arange(len(largest))] < 0, -1.0, 1.0)
    return np.ascontiguousarray(quaternions.T, np.float32)


def _axes(
    ellipsoid_axes: Float64[np.ndarray, "n 3 3"],
) -> tuple[Float64[np.ndarray, "n 3 3"], Float64[np.ndarray, "n 3"]]:
    """Decompose covariances S Sᵀ of 3×3 matrices S into rotations and standard deviations."""
    u, sizes, _ = np.linalg.svd(ellipsoid_axes)
    u[:, :, 2] *= np.sign(np.linalg.det(u))[:, None]
    return u, sizes
