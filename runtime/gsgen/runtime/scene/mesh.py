"""Triangle meshes: opaque surfaces among the Gaussians of a scene."""

__all__ = ["SHADINGS", "Mesh", "MeshData", "Shading"]

from dataclasses import dataclass, field, replace
from typing import Final, Literal, final, get_args

import numpy as np
from jaxtyping import Float, Float32, Integer, UInt8, UInt32

from gsgen.formats.shared.origins import relative_positions
from gsgen.formats.shared.splats import NO_ORIGIN
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.scene.transforms import identity, moved, require_affine

Shading = Literal["unlit", "headlight"]
"""How a mesh is lit: see :class:`Mesh`."""

SHADINGS: Final[tuple[Shading, ...]] = get_args(Shading)

_DEFAULT_GREY: Final = 0.7
_MAX_COORDINATE: Final = 1e18  # its square is finite in float32


@final
class MeshData:
    """Triangles with colours or a texture, which several meshes may share.

    Args:
        vertices: Positions, [V, 3], finite.
        faces: Three indices of vertices per triangle, [F, 3], in either orientation.
        colors: Red, green, blue of each vertex, [V, 3] or [V, 4], floats or bytes; alpha is
            ignored, as meshes are opaque. None for grey, or white with a texture.
        uv: Texture coordinates of each vertex, [V, 2]: (0, 0) is the lower left corner of the
            texture, which repeats beyond (1, 1).
        texture: Bytes, [height, width, 3 or 4], the upper row first; multiplies the colours.
        color_space: Colour space of colours and texture.

    Attributes:
        vertices: As float32.
        origin: The point that vertices are relative to, where float32 would round coordinates.
        faces: As uint32.
        colors: As float32, [V, 3].
        uv: As float32, or None.
        texture: [height, width, 4], or None.
        color_space: As given.
        version: Grows with every update; holders of a copy compare it.

    Raises:
        SceneInvalid: An array cannot be drawn; the message names the row and the value.
    """

    vertices: Float32[np.ndarray, "v 3"]
    origin: tuple[float, float, float]
    faces: UInt32[np.ndarray, "f 3"]
    colors: Float32[np.ndarray, "v 3"]
    uv: Float32[np.ndarray, "v 2"] | None
    texture: UInt8[np.ndarray, "h w 4"] | None
    color_space: Literal["srgb", "linear"]
    version: int

    def __init__(
        self,
        vertices: Float[np.ndarray, "v 3"],
        faces: Integer[np.ndarray, "f 3"],
        colors: np.ndarray | None = None,
        *,
        uv: Float[np.ndarray, "v 2"] | None = None,
        texture: UInt8[np.ndarray, "h w c"] | None = None,
        color_space: Literal["srgb", "linear"] = "srgb",
    ) -> None:
        self.vertices, self.origin = _relative_vertices(vertices)
        self.faces = _faces(faces, len(self.vertices))
        self.texture = None if texture is None else _rgba_texture(texture)
        self.uv = None if uv is None else _float_array(uv, "uv", (2,), len(self.vertices))
        if (self.uv is None) != (self.texture is None):
            missing_field = "uv" if self.uv is None else "texture"
            raise SceneInvalid(
                "is None, expected both uv and texture, or neither", where=missing_field
            )
        if colors is None:
            colors = np.full((len(self.vertices), 3), _DEFAULT_GREY if texture is None else 1.0)
        elif np.asarray(colors).dtype == np.uint8:
            colors = np.asarray(colors) / 255
        self.colors = _float_array(colors, "colors", (3, 4), len(self.vertices))[:, :3]
        _require_one_of(color_space, ("srgb", "linear"), "color_space")
        self.color_space = color_space
        self.version = 0

    def update(self, vertices: Float[np.ndarray, "v 3"]) -> None:
        """Replace the vertex positions; their number stays, so that GPU buffers are reused.

        Raises:
            SceneInvalid: The number of vertices changed, or one is not finite.
        """
        self.vertices, self.origin = _relative_vertices(vertices, len(self.vertices))
        self.version += 1

    def __len__(self) -> int:
        return len(self.faces)


@final
@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A mesh: triangles with a transform to the world and a shading.

    Attributes:
        data: The triangles.
        transform: Local → world, [4, 4], affine and invertible.
        shading: ``unlit`` shows colours as they are; ``headlight`` multiplies them by
            0.2 + 0.8 |n·v|, for the face's normal n and the direction v to the camera.

    Raises:
        SceneInvalid: The transform or the shading cannot be used.
    """

    data: MeshData
    transform: Float[np.ndarray, "4 4"] = field(default_factory=identity)
    shading: Shading = "unlit"

    def __post_init__(self) -> None:
        matrix = np.array(self.transform, np.float64)
        object.__setattr__(self, "transform", matrix)
        require_affine(matrix)
        _require_one_of(self.shading, SHADINGS, "shading")

    @property
    def vertices_to_world(self) -> Float[np.ndarray, "4 4"]:
        """The transform of the vertices, which are relative to the origin of ``data``, to the world."""
        return moved(self.transform, self.data.origin)

    def placed(self, transform: Float[np.ndarray, "4 4"]) -> "Mesh":
        """Return the mesh with another transform applied after its own transform."""
        return replace(self, transform=np.asarray(transform, np.float64) @ self.transform)


def _relative_vertices(
    vertices: Float[np.ndarray, "v 3"], rows: int | None = None
) -> tuple[Float32[np.ndarray, "v 3"], tuple[float, float, float]]:
    """Return vertices as float32, and the origin that they are relative to."""
    array = np.asarray(vertices)
    if array.dtype != np.float64 or array.shape[1:] != (3,):
        return _float_array(array, "vertices", (3,), rows), NO_ORIGIN
    offset, origin, _ = relative_positions(array)
    return _float_array(offset, "vertices", (3,), rows), origin


def _require_one_of(value: str, allowed_values: tuple[str, ...], where: str) -> None:
    if value not in allowed_values:
        raise SceneInvalid(f"is {value!r}, expected {' or '.join(allowed_values)}", where=where)


def _float_array(
    array: np.ndarray, where: str, widths: tuple[int, ...], rows: int | None = None
) -> Float32[np.ndarray, "n c"]:
    """Convert rows of finite vertex attributes to float32 in C order."""
    source_array = np.asarray(array)
    is_valid = (
        source_array.ndim == 2
        and source_array.shape[1] in widths
        and source_array.dtype.kind in "fiu"
    )
    if not is_valid or (rows is not None and len(source_array) != rows):
        expected = " or ".join(map(str, widths))
        raise SceneInvalid(
            f"is {source_array.dtype} {list(source_array.shape)}, expected numbers "
            f"[{'N' if rows is None else rows}, {expected}]",
            where=where,
        )
    invalid_rows = ~(np.abs(source_array) <= _MAX_COORDINATE).all(axis=1)
    if invalid_rows.any():
        row = int(invalid_rows.argmax())
        raise SceneInvalid(
            f"{invalid_rows.sum():,} of {len(source_array):,} rows are not finite or beyond {_MAX_COORDINATE:g}; "
            f"row {row} is {source_array[row].tolist()}",
            where=where,
            hint="Remove these vertices and the faces that use them.",
        )
    return np.ascontiguousarray(source_array, np.float32)


def _faces(array: np.ndarray, vertices: int) -> UInt32[np.ndarray, "f 3"]:
    source_array = np.asarray(array)
    if source_array.ndim != 2 or source_array.shape[1] != 3 or source_array.dtype.kind not in "iu":
        raise SceneInvalid(
            f"is {source_array.dtype} {list(source_array.shape)}, expected integers [F, 3]",
            where="faces",
        )
    invalid_rows = ~((source_array >= 0) & (source_array < vertices)).all(axis=1)
    if invalid_rows.any():
        row = int(invalid_rows.argmax())
        raise SceneInvalid(
            f"row {row} is {source_array[row].tolist()}, expected indices of {vertices:,} vertices",
            where="faces",
        )
    return np.ascontiguousarray(source_array, np.uint32)


def _rgba_texture(array: np.ndarray) -> UInt8[np.ndarray, "h w 4"]:
    source_array = np.asarray(array)
    is_valid = (
        source_array.ndim == 3
        and source_array.shape[2] in (3, 4)
        and source_array.dtype == np.uint8
    )
    if not is_valid or 0 in source_array.shape:
        raise SceneInvalid(
            f"is {source_array.dtype} {list(source_array.shape)}, expected uint8 [height, width, 3 or 4]",
            where="texture",
        )
    rgba_texture = np.full((*source_array.shape[:2], 4), 255, np.uint8)
    rgba_texture[..., :3] = source_array[..., :3]
    return rgba_texture
