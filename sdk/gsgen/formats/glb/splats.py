"""Decodes splats of a glTF primitive with KHR_gaussian_splatting, or a draft of this extension.

The axes are those of the file, x left, y up, z forward. Drafts of the extension stored SPZ in a
buffer view, or ``_ROTATION`` and ``_SCALE`` next to COLOR_0.
"""

import re
from dataclasses import replace
from typing import Any, Final, Literal

import numpy as np
from jaxtyping import Bool, Float32

from gsgen.formats.glb.accessors import read_accessor, view_range
from gsgen.formats.glb.container import Container, Json, object_member
from gsgen.formats.shared.axes import RDF_LUF, RDF_RUB, flip
from gsgen.formats.shared.errors import (
    HeaderMalformed,
    NotSupported,
    PropertyMissing,
    ValueInvalid,
    quoted,
)
from gsgen.formats.shared.notices import warn_unused
from gsgen.formats.shared.quantities import SH_C0, log, logit, unit_or_zero
from gsgen.formats.shared.splats import SH_COUNTS, Splats
from gsgen.formats.spz import container, streams

EXTENSION_NAME: Final = "KHR_gaussian_splatting"
COLOR_SPACES: Final[dict[str, Literal["srgb", "linear"]]] = {
    "srgb_rec709_display": "srgb",
    "lin_rec709_display": "linear",
}

_SPZ_EXTENSION_NAMES = (
    "KHR_gaussian_splatting_compression_spz_2",
    "KHR_gaussian_splatting_compression_spz",
    "KHR_spz_gaussian_splats_compression",
)
READABLE_EXTENSIONS: Final = (
    EXTENSION_NAME,
    *_SPZ_EXTENSION_NAMES,
    "KHR_mesh_quantization",
    "KHR_materials_*",
    "KHR_lights_punctual",
    "KHR_xmp_json_ld",
    "EXT_structural_metadata",
    "EXT_mesh_features",
)
"""The extensions that a file of splats may require: those of splats, and those without effect."""
_POINTS_MODE = 0
_COEFFICIENT_NAME = re.compile(re.escape(EXTENSION_NAME) + r":SH_DEGREE_(\d)_COEF_(\d)")


def is_splats(primitive: Json) -> bool:
    """Return whether a glTF primitive holds splats by KHR_gaussian_splatting or a draft of it."""
    extensions, attributes = primitive.get("extensions"), primitive.get("attributes")
    has_extension = isinstance(extensions, dict) and any(
        key in extensions for key in (EXTENSION_NAME, *_SPZ_EXTENSION_NAMES)
    )
    return has_extension or (isinstance(attributes, dict) and _uses_draft_attributes(attributes))


def _uses_draft_attributes(attributes: Json) -> bool:
    return {"_ROTATION", "_SCALE"} <= attributes.keys()


def read_primitive(glb: Container, primitive: Json, where: str, max_bytes: int) -> Splats:
    """Decode the splats of a glTF primitive."""
    extensions = object_member(primitive, "extensions", where)
    extension = object_member(extensions, EXTENSION_NAME, where)
    mode = primitive.get("mode", 4)
    if mode != _POINTS_MODE:
        raise HeaderMalformed(quoted(str(mode)), where=f"{where}, mode", expected="0, points")
    space: Literal["srgb", "linear"] = "srgb"
    attributes = object_member(primitive, "attributes", where)
    if EXTENSION_NAME in extensions:
        space = _color_space(extension, attributes, where)
    packed = extensions | object_member(extension, "extensions", where)
    for name in _SPZ_EXTENSION_NAMES:
        if name in packed:
            splats = _splats_from_spz(
                glb, object_member(packed, name, where), f"{where}, {name}", max_bytes
            )
            return replace(splats, color_space=space)
    return _splats_from_attributes(glb, attributes, where, space)


def _color_space(extension: Json, attributes: Json, where: str) -> Literal["srgb", "linear"]:
    kernel, space = extension.get("kernel", "ellipse"), extension.get("colorSpace")
    if kernel != "ellipse":
        raise NotSupported(quoted(str(kernel)), where=f"{where}, kernel", expected="ellipse")
    # Drafts do not state it, whether they store SPZ or attributes of their own names.
    if space is None and ("extensions" in extension or _uses_draft_attributes(attributes)):
        return "srgb"
    if not isinstance(space, str) or space not in COLOR_SPACES:
        raise NotSupported(
            "missing" if space is None else quoted(str(space)),
            where=f"{where}, colorSpace",
            expected=" or ".join(COLOR_SPACES),
        )
    return COLOR_SPACES[space]


def _splats_from_spz(glb: Container, extension: Json, where: str, max_bytes: int) -> Splats:
    view = glb.item("bufferViews", extension.get("bufferView"), where)
    start, size = view_range(glb, view, where)
    frame = container.unpack(bytes(glb.data[start : start + size]), max_bytes)
    warn_unused(where, frame.unused)
    splats = streams.decode(
        frame.streams,
        version=frame.version,
        degree=frame.degree,
        fractional_bits=frame.fractional_bits,
        antialiased=frame.antialiased,
    )
    if frame.signs == RDF_RUB:  # no declaration: the draft specifies LUF
        return splats
    return flip(flip(splats, frame.signs), RDF_LUF)


def _splats_from_attributes(
    glb: Container, attributes: Json, where: str, space: Literal["srgb", "linear"]
) -> Splats:
    arrays = _AttributeReader(glb, attributes, where)
    position = arrays.read("POSITION", widths=(3,))
    rotation = arrays.read(f"{EXTENSION_NAME}:ROTATION", "_ROTATION", widths=(4,))
    scale = arrays.read(f"{EXTENSION_NAME}:SCALE", "_SCALE", widths=(3,))
    color = None
    if f"{EXTENSION_NAME}:OPACITY" in attributes:
        opacity = arrays.read(f"{EXTENSION_NAME}:OPACITY", widths=(1,))[:, 0]
        sh = _harmonics(arrays, attributes, where)
    else:
        color = arrays.read("COLOR_0", widths=(4,))
        opacity, sh = color[:, 3], ((color[:, None, :3] - 0.5) / SH_C0).astype(np.float32)
    _require_valid(scale, scale >= 0, f"{where}, SCALE", "0 or more")
    _require_valid(opacity, (opacity >= 0) & (opacity <= 1), f"{where}, OPACITY", "0 to 1")
    return Splats(
        position=position,
        rotation=unit_or_zero(rotation[:, [3, 0, 1, 2]]),
        log_scale=log(scale),
        logit_opacity=logit(opacity),
        sh=sh,
        color_space=space,
    )


class _AttributeReader:
    """Reads the attribute arrays of one glTF primitive, which must have equal lengths."""

    def __init__(self, glb: Container, attributes: dict[str, Any], where: str) -> None:
        self._glb, self._attributes, self._location = glb, attributes, where
        self._rows: int | None = None

    def read(self, *names: str, widths: tuple[int, ...]) -> Float32[np.ndarray, "n w"]:
        """Read the first of the glTF attributes ``names`` that the primitive has."""
        name = next((name for name in names if name in self._attributes), None)
        if name is None:
            raise PropertyMissing(
                f"the primitive lacks the attribute {names[0]}",
                where=self._location,
                expected=f"POSITION, and ROTATION, SCALE, OPACITY and SH of {EXTENSION_NAME}",
            )
        where = f"{self._location}, attribute {name}"
        array = read_accessor(self._glb, self._attributes[name], widths, where)
        if self._rows is not None and len(array) != self._rows:
            raise HeaderMalformed(
                f"the attribute has {len(array)} values",
                where=where,
                expected=f"{self._rows} values, as POSITION has",
            )
        self._rows = len(array)
        return array


def _harmonics(
    arrays: _AttributeReader, attributes: Json, where: str
) -> Float32[np.ndarray, "n k 3"]:
    stored_pairs = {
        (int(match[1]), int(match[2]))
        for match in map(_COEFFICIENT_NAME.fullmatch, attributes)
        if match
    }
    degree = max((band for band, _ in stored_pairs), default=0)
    if degree >= len(SH_COUNTS):
        raise NotSupported(f"the splats have SH degree {degree}", where=where, expected="0 to 4")
    pairs = [(band, n) for band in range(degree + 1) for n in range(2 * band + 1)]
    missing = [coefficient(*pair) for pair in pairs if pair not in stored_pairs]
    if missing:
        raise PropertyMissing(
            f"the primitive lacks the attribute {missing[0]}",
            where=where,
            expected=f"all {len(pairs)} coefficients of SH degree {degree}",
        )
    sh = np.empty((0, 0, 3), np.float32)
    for column, pair in enumerate(pairs):
        values = arrays.read(coefficient(*pair), widths=(3,))
        if not column:
            sh = np.empty((len(values), len(pairs), 3), np.float32)
        sh[:, column] = values
    return sh


def coefficient(band: int, index: int) -> str:
    """Return the glTF attribute name of the SH coefficient of degree ``band`` at ``index``."""
    return f"{EXTENSION_NAME}:SH_DEGREE_{band}_COEF_{index}"


def _require_valid(
    values: Float32[np.ndarray, "..."], is_valid: Bool[np.ndarray, "..."], where: str, expected: str
) -> None:
    if not is_valid.all():
        first = int(np.argmin(is_valid))  # the comparisons are false for NaN
        raise ValueInvalid(
            f"{is_valid.size - np.count_nonzero(is_valid)} of {is_valid.size} values are invalid: "
            f"the first is {values.ravel()[first]:g}",
            where=where,
            expected=expected,
        )
