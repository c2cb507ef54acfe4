"""Reads glTF accessors, i.e. typed arrays, from a GLB file.

The format is that of the glTF 2.0 specification, section 3.6 (Khronos).
"""

from typing import Final

import numpy as np
from jaxtyping import Float32

from gsgen.formats.glb.container import Container, Json, require_integer
from gsgen.formats.shared.bytes import require_length
from gsgen.formats.shared.errors import HeaderMalformed, NotSupported, quoted

_COMPONENT_DTYPES: Final = {
    5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4",
}  # fmt: skip
_WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_LONGEST_STRIDE = 252


def read_accessor(
    glb: Container, index: object, widths: tuple[int, ...], where: str
) -> Float32[np.ndarray, "n w"]:
    """Return the glTF accessor ``index`` as floats; normalised integers become fractions of 1.

    Raises:
        HeaderMalformed: The accessor breaks the specification.
        NotSupported: The accessor is sparse.
        FileTruncated: The accessor reaches beyond the end of its buffer.
    """
    accessor = glb.item("accessors", index, where)
    if "sparse" in accessor or "bufferView" not in accessor:
        raise NotSupported(
            "the accessor is sparse", where=where, expected="an accessor with all values"
        )
    kind, width = accessor.get("componentType"), accessor.get("type")
    if (
        not (isinstance(kind, int) and isinstance(width, str))
        or kind not in _COMPONENT_DTYPES
        or width not in _WIDTHS
    ):
        raise HeaderMalformed(
            f"the accessor has type {quoted(str(width))} and component type {quoted(str(kind))}",
            where=where,
            expected=f"{', '.join(_WIDTHS)} of a component type from 5120 to 5126",
        )
    if _WIDTHS[width] not in widths:
        names = [name for name, size in _WIDTHS.items() if size in widths]
        raise HeaderMalformed(
            f"the accessor has type {width}", where=where, expected=" or ".join(names)
        )
    stored = _stored_array(glb, accessor, np.dtype(_COMPONENT_DTYPES[kind]), _WIDTHS[width], where)
    values = stored.astype(np.float32)
    if accessor.get("normalized") and stored.dtype.kind != "f":
        values = np.maximum(values / np.float32(np.iinfo(stored.dtype).max), -1)
    return values


def _stored_array(
    glb: Container, accessor: Json, dtype: np.dtype, width: int, where: str
) -> np.ndarray:
    view = glb.item("bufferViews", accessor["bufferView"], where)
    count = require_integer(accessor.get("count"), f"{where}, count")
    value_bytes = dtype.itemsize * width
    stride = require_integer(
        view.get("byteStride", value_bytes), f"{where}, byteStride", _LONGEST_STRIDE
    )
    if stride < value_bytes:
        raise HeaderMalformed(
            f"the buffer view has a stride of {stride} bytes",
            where=where,
            expected=f"{value_bytes} or more",
        )
    start, size = view_range(glb, view, where)
    offset = require_integer(accessor.get("byteOffset", 0), f"{where}, byteOffset")
    needed = stride * (count - 1) + value_bytes if count else 0
    if offset + needed > size:
        raise HeaderMalformed(
            f"the {count} values of the accessor end at byte {offset + needed}",
            where=where,
            expected=f"at most {size}, the end of the buffer view",
        )
    if not count:
        return np.empty((0, width), dtype)
    return np.ndarray((count, width), dtype, glb.data, start + offset, (stride, dtype.itemsize))


def view_range(glb: Container, view: Json, where: str) -> tuple[int, int]:
    """Return the byte offset of a glTF buffer view in the GLB file, and the view's length."""
    buffer = require_integer(view.get("buffer"), f"{where}, buffer")
    if buffer or "uri" in glb.item("buffers", 0, where):
        raise NotSupported(
            f"buffer {buffer} is not in the GLB file",
            where=where,
            expected="data in the binary chunk",
            hint="pack all buffers into the GLB file",
        )
    offset = require_integer(view.get("byteOffset", 0), f"{where}, byteOffset")
    size = require_integer(view.get("byteLength"), f"{where}, byteLength")
    chunk = memoryview(glb.data)[: glb.start + glb.size]
    require_length(chunk, glb.start + offset, size, where)
    return glb.start + offset, size
