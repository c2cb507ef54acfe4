"""Keeps the triangles, colours and textures of meshes in GPU buffers."""

__all__ = ["MeshBuffers", "MeshResidency"]

from dataclasses import dataclass
from typing import final
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import UInt8

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer, TextureView
from gsgen.runtime.scene.mesh import MeshData

_PLACEHOLDER_UV = np.zeros((1, 2), np.float32)
_WHITE_TEXEL = np.full((1, 1, 4), 255, np.uint8)


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MeshBuffers:
    """GPU buffers with the arrays of one :class:`MeshData`.

    Attributes:
        vertices: Three float32 per vertex.
        faces: Three uint32 per triangle.
        colors: Three float32 per vertex.
        uvs: Two float32 per vertex; two in all for meshes without a texture.
        picture: View of the texture; one white texel for meshes without one.
        count: Number of triangles.
    """

    vertices: Buffer
    faces: Buffer
    colors: Buffer
    uvs: Buffer
    picture: TextureView
    count: int


@final
class MeshResidency:
    """Keeps each ``MeshData`` in GPU buffers for as long as the object exists."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._buffers_by_mesh: WeakKeyDictionary[MeshData, MeshBuffers] = WeakKeyDictionary()
        self._version_by_mesh: WeakKeyDictionary[MeshData, int] = WeakKeyDictionary()

    def buffers(self, data: MeshData) -> MeshBuffers:
        """Return the GPU buffers of a mesh; uploads new meshes and changed vertices.

        Raises:
            CapacityExceeded: An array or the texture is larger than the device binds.
        """
        if data not in self._buffers_by_mesh:
            self._buffers_by_mesh[data] = MeshBuffers(
                vertices=self._upload("mesh vertices", data.vertices),
                faces=self._upload("mesh faces", data.faces),
                colors=self._upload("mesh colors", data.colors),
                uvs=self._upload("mesh uv", _PLACEHOLDER_UV if data.uv is None else data.uv),
                picture=self._picture(_WHITE_TEXEL if data.texture is None else data.texture),
                count=len(data),
            )
        elif self._version_by_mesh[data] != data.version:
            self._device.write(self._buffers_by_mesh[data].vertices, data.vertices)
        self._version_by_mesh[data] = data.version
        return self._buffers_by_mesh[data]

    def _upload(self, label: str, values: np.ndarray) -> Buffer:
        buffer = self._device.storage(label, values.nbytes)
        self._device.write(buffer, values)
        return buffer

    def _picture(self, texture: UInt8[np.ndarray, "h w 4"]) -> TextureView:
        height, width = texture.shape[:2]
        uploaded = self._device.texture(
            "mesh texture", (width, height), "rgba8unorm", "TEXTURE_BINDING|COPY_DST"
        )
        self._device.raw.queue.write_texture(
            {"texture": uploaded},
            np.ascontiguousarray(texture),
            {"bytes_per_row": 4 * width, "rows_per_image": height},
            (width, height, 1),
        )
        return uploaded.create_view()
