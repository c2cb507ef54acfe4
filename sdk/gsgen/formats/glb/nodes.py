"""Where the nodes of a GLB file put its meshes, and splats that are put somewhere else.

The format is that of the glTF 2.0 specification, section 3.5 (Khronos).
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from gsgen.contract.spec.geometry import rotation_matrix
from gsgen.formats.glb.container import Container, Json, members, numbers, whole
from gsgen.formats.shared.errors import HeaderMalformed, NotSupported
from gsgen.formats.shared.harmonics import rotate_sh
from gsgen.formats.shared.quantities import log, rotations
from gsgen.formats.shared.splats import Splats

Matrix = Float64[np.ndarray, "4 4"]

_IDENTITY = tuple(np.eye(4).flatten().tolist())
_DEEPEST = 200


def meshes(glb: Container) -> Iterator[tuple[int, Matrix]]:
    """Yield the meshes that the scene shows, and the matrix that puts each in the world.

    Raises:
        HeaderMalformed: A node is its own ancestor, is not there, or has no usable matrix.
    """
    todo = [(index, np.eye(4), 0) for index in reversed(_roots(glb))]
    seen: set[int] = set()
    while todo:
        index, above, depth = todo.pop()
        where = f"nodes[{index}]"
        if index in seen or depth > _DEEPEST:
            raise HeaderMalformed(
                "a node within itself, or in two places", where=where, expected="a tree"
            )
        seen.add(index)
        node = glb.item("nodes", index, where)
        matrix = above @ _local(node, where)
        if "mesh" in node:
            yield whole(node["mesh"], f"{where}.mesh"), matrix
        inner = [
            whole(one, f"{where}.children") for one in members(node, "children", where)
        ]
        todo += [(one, matrix, depth + 1) for one in reversed(inner)]


def _roots(glb: Container) -> list[int]:
    if "scenes" in glb.document:
        scene = glb.item("scenes", glb.document.get("scene", 0), "scene")
        return [whole(one, "scene.nodes") for one in members(scene, "nodes", "scene")]
    nodes = members(glb.document, "nodes", "document")
    inner: set[Any] = set()
    for index, node in enumerate(nodes):
        if isinstance(node, dict):
            children = members(node, "children", f"nodes[{index}]")
            inner |= {whole(one, f"nodes[{index}].children") for one in children}
    return [index for index in range(len(nodes)) if index not in inner]


def _local(node: Json, where: str) -> Matrix:
    if "matrix" in node:
        made = np.array(numbers(node, "matrix", _IDENTITY, where)).reshape(4, 4).T
    else:
        x, y, z, w = numbers(node, "rotation", (0.0, 0.0, 0.0, 1.0), where)
        scale = numbers(node, "scale", (1.0, 1.0, 1.0), where)
        made = np.eye(4)
        made[:3, :3] = rotation_matrix(np.array([[w, x, y, z]]))[0] * scale
        made[:3, 3] = numbers(node, "translation", (0.0, 0.0, 0.0), where)
    if not np.array_equal(made[3], [0, 0, 0, 1]):
        raise HeaderMalformed(
            f"last row {made[3].tolist()}", where=f"{where}.matrix", expected="0 0 0 1"
        )
    if not np.linalg.det(made[:3, :3]) > 0:
        raise NotSupported(
            "a transform that mirrors or flattens",
            where=where,
            expected="a scale above 0 along every axis",
        )
    return np.asarray(made)


def moved(splats: Splats, matrix: Matrix) -> Splats:
    """Return ``splats`` after ``matrix``: Σ becomes M Σ Mᵀ, and colours turn along."""
    linear = matrix[:3, :3]
    if np.array_equal(matrix, np.eye(4)):
        return splats
    left, sizes, right = np.linalg.svd(linear)
    turn = left @ right
    position = splats.position @ linear.T + matrix[:3, 3]
    spread = np.einsum("ij,njk->nik", linear, rotation_matrix(splats.rotation))
    with np.errstate(over="ignore"):
        spread *= np.exp(splats.log_scale.astype(np.float64))[:, None, :]
    if np.allclose(sizes, sizes[0], rtol=1e-6):  # nothing is sheared: axes stay axes
        rotation, scale = turn @ rotation_matrix(splats.rotation), None
        log_scale = splats.log_scale + np.float32(np.log(sizes[0]))
    else:
        rotation, scale = _axes(spread)
        log_scale = log(scale)
    return replace(
        splats,
        position=position.astype(np.float32),
        rotation=rotations(rotation),
        log_scale=log_scale.astype(np.float32),
        sh=rotate_sh(splats.sh, turn),
    )


def _axes(
    spread: Float64[np.ndarray, "n 3 3"],
) -> tuple[Float64[np.ndarray, "n 3 3"], Float64[np.ndarray, "n 3"]]:
    """Return the axes of the ellipsoids spread · spreadᵀ as rotations, and their half sizes."""
    left, sizes, _ = np.linalg.svd(spread)
    left[:, :, 2] *= np.sign(np.linalg.det(left))[:, None]
    return left, sizes
