"""Parses the meta.json of a SOG file; values are checked on access."""

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NoReturn, final

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from gsgen.contract.file_kinds.names import META_FILE, STREAMED_META
from gsgen.contract.file_kinds.recognition import kind_of
from gsgen.formats.shared.bytes import MAX_SPLATS, not_recognised
from gsgen.formats.shared.errors import FormatNotRecognised, HeaderMalformed, NotSupported, quoted
from gsgen.formats.shared.files import FilePath
from gsgen.formats.shared.splats import SH_COUNTS

ANTIALIASED: Final = "antialiased"
"""The ``model`` of splats that were trained with the filter of Mip-Splatting."""
PALETTE_WIDTH: Final = 64
"""The entries of the palette of harmonics in a row of its image."""
QUATERNION_TAG: Final = 252
"""Alpha of a quaternion whose largest component is the first."""
CODEBOOK_SIZE: Final = 256
"""The numbers of a codebook."""
MAX_PALETTE_SIZE: Final = 1 << 16
"""The most entries of the palette of harmonics."""

_VERSIONS: Final = (1, 2)
# Keys that say how a file was made, or repeat what its images say.
_DESCRIPTIVE_KEYS: Final = frozenset({"asset", "dtype", "encoding", "quantization", "shape"})
_EXPECTED_FILE: Final = "the meta.json of a SOG"
_SH_BANDS = (1, 2, 3)
_DEFAULT_MODEL = "default"
# Group → how many images it has.
_GROUPS: Final = {"means": 2, "scales": 1, "quats": 1, "sh0": 1, "shN": 2}


def is_meta(path: FilePath) -> bool:
    """Return whether a path is that of a SOG's meta.json, beside which its images lie."""
    return Path(path).name.lower() == META_FILE


def looks_like_meta(head: bytes) -> bool:
    """Return whether a file begins as the meta.json of a SOG or the lod-meta.json of several."""
    if head.lstrip()[:1] != b"{":
        return False
    kind = kind_of(head)
    return kind is not None and kind.name in ("sog", "streamed-sog")


def is_streamed_meta(path: FilePath) -> bool:
    """Return whether a path is that of the lod-meta.json of a streamed SOG.

    It is written from all splats at once, because its levels merge them.
    """
    return Path(path).name.lower() == STREAMED_META


@final
@dataclass(frozen=True, slots=True)
class Meta:
    """The parsed meta.json of a SOG file.

    Version 1 stores bytes between ``mins`` and ``maxs``; version 2 stores indices of a codebook.

    Attributes:
        data: The parsed file.
        count: The number of splats.
        version: The version of the format, 1 or 2.
    """

    data: dict[str, Any]
    count: int
    version: int
    _used_keys: set[str] = field(default_factory=set)

    @classmethod
    def parse(cls, content: bytes) -> "Meta":
        """Parse the meta.json of a SOG file.

        Raises:
            FormatNotRecognised: The content is not the JSON object of a SOG.
            NotSupported: The version is not 1 or 2, or the file lists levels of detail.
            HeaderMalformed: The number of splats is missing or invalid.
        """
        data = parse_object(content)
        if "lodLevels" in data or "tree" in data:
            raise NotSupported(
                "the file is a streamed SOG of several levels of detail",
                where=META_FILE,
                expected="a SOG of one level",
                hint="read one of the files that it lists",
            )
        if "means" not in data:
            raise not_recognised(content, _EXPECTED_FILE, "{")
        version = data.get("version", 1)
        if isinstance(version, bool) or version not in _VERSIONS:
            raise NotSupported(
                f"the SOG version is {quoted(str(version))}",
                where=META_FILE,
                expected="version 1 or 2",
            )
        return cls(data, _splat_count(data, version), version, {"version", "count"})

    @property
    def antialiased(self) -> bool:
        """Whether a SOG file declares antialiased splats, by one of two keys that writers use."""
        if self.data.get("model") in (None, ANTIALIASED, _DEFAULT_MODEL):
            self._used_keys.add("model")
        if isinstance(self.data.get("antialias"), bool):
            self._used_keys.add("antialias")
        return self.data.get("model") == ANTIALIASED or self.data.get("antialias") is True

    def unused(self) -> list[str]:
        """Return the keys of a SOG's meta.json that were not asked for, except descriptive ones."""
        keys = []
        for name, entry in self.data.items():
            members = [f"{name}.{key}" for key in entry] if isinstance(entry, dict) else [name]
            keys += [name] if isinstance(entry, dict) and name not in _GROUPS else members
        named = [key for key in keys if key.rpartition(".")[2] not in _DESCRIPTIVE_KEYS]
        return [f"key {key}" for key in named if key not in self._used_keys]

    def files(self, group: str, number: int) -> list[str]:
        """Return the image file names of a quantity ``group`` in SOG's meta.json."""
        names = self._require_list(group, "files", number)
        if not all(isinstance(name, str) for name in names):
            self._raise_malformed(group, "files", f"{number} names")
        return names

    def all_files(self) -> list[str]:
        """Return the names of all images that the meta.json of a SOG file lists."""
        groups = [group for group in _GROUPS if self.data.get(group) is not None]
        return [name for group in groups for name in self.files(group, _GROUPS[group])]

    def triple(self, group: str, key: str) -> Float64[np.ndarray, "3"]:
        """Return the three finite numbers at key ``key`` of ``group`` in SOG's meta.json."""
        return np.asarray(self._numbers(group, key, 3), np.float64)

    def decode(self, group: str, pixels: UInt8[np.ndarray, "*n c"]) -> Float32[np.ndarray, "*n c"]:
        """Return the numbers that the bytes of a quantity's image stand for.

        Harmonics (``shN``) of version 1 have one range; other quantities have one per channel.
        """
        with np.errstate(over="ignore"):  # the check of values refuses infinity
            if self.version > 1:
                codebook = np.array(self._numbers(group, "codebook", CODEBOOK_SIZE), np.float64)
                return np.asarray(codebook.astype(np.float32)[pixels])
            width = 1 if group == "shN" else pixels.shape[-1]
            least, most = (self._bounds(group, key, width) for key in ("mins", "maxs"))
            values = least + (most - least) * (pixels / (CODEBOOK_SIZE - 1))
            return np.asarray(values, np.float32)

    def _bounds(self, group: str, key: str, width: int) -> Float64[np.ndarray, " c"]:
        """Return the numbers at ``key``; a single one may stand without brackets."""
        entry = self._value(group, key)
        values = entry if isinstance(entry, list) else [entry]
        if len(values) != width or not all(map(_is_number, values)):
            self._raise_malformed(group, key, f"{width} finite numbers")
        return np.array(list(map(_to_float, values)), np.float64)

    @property
    def has_palette(self) -> bool:
        """Whether the splats have harmonics above degree 0."""
        return self.data.get("shN") is not None

    def palette(self) -> tuple[int, int]:
        """Return the size and degree of the SH palette that a SOG file of version 2 declares."""
        size = _require_integer(
            self._value("shN", "count"), f"{META_FILE}, shN.count", MAX_PALETTE_SIZE
        )
        bands = self._value("shN", "bands")
        if bands not in _SH_BANDS:
            self._raise_malformed("shN", "bands", "1, 2 or 3")
        return size, int(bands)

    def _value(self, group: str, key: str) -> Any:
        """Return a member of a group, or None, and note that it was asked for."""
        entry = self._group(group).get(key)
        self._used_keys.update((group, f"{group}.{key}"))
        return entry

    def _group(self, group: str) -> dict[str, Any]:
        entry = self.data.get(group)
        if not isinstance(entry, dict):
            raise HeaderMalformed(
                f"the JSON object lacks the key {group!r}", where=META_FILE, expected="an object"
            )
        return entry

    def _require_list(self, group: str, key: str, number: int) -> list[Any]:
        entries = self._value(group, key)
        if not isinstance(entries, list) or len(entries) != number:
            self._raise_malformed(group, key, f"a list of {number}")
        return entries

    def _numbers(self, group: str, key: str, number: int) -> list[float]:
        entries = self._require_list(group, key, number)
        if not all(map(_is_number, entries)):
            self._raise_malformed(group, key, f"{number} finite numbers")
        return list(map(_to_float, entries))

    def _raise_malformed(self, group: str, key: str, expected: str) -> NoReturn:
        actual = quoted(str(self._group(group).get(key)))
        raise HeaderMalformed(actual, where=f"{META_FILE}, {group}.{key}", expected=expected)


def parse_object(content: bytes) -> dict[str, Any]:
    """Parse a JSON file whose top level is an object.

    Raises:
        FormatNotRecognised: The content is not JSON, or not an object.
    """
    if not content.lstrip().startswith(b"{"):
        raise not_recognised(content, _EXPECTED_FILE, content[:4].hex(" "))
    try:
        data = json.loads(content)
    except (ValueError, RecursionError) as error:
        reason = "it nests too deeply" if isinstance(error, RecursionError) else error
        raise FormatNotRecognised(
            f"the file has invalid JSON ({reason})", where=META_FILE, expected=_EXPECTED_FILE
        ) from error
    assert isinstance(data, dict)  # it begins with a brace
    return data


def palette_of_image(width: int, height: int) -> tuple[int, int]:
    """Return the size and degree of the SH palette of version 1, which its image alone says.

    Raises:
        HeaderMalformed: The image has another width than 64 entries of a degree.
    """
    degree_by_width = {PALETTE_WIDTH * (SH_COUNTS[degree] - 1): degree for degree in _SH_BANDS}
    if width not in degree_by_width or height * PALETTE_WIDTH > MAX_PALETTE_SIZE:
        widths = ", ".join(map(str, degree_by_width))
        raise HeaderMalformed(
            f"an image of {width} × {height} pixels",
            where="shN",
            expected=f"a width of {widths}, and {MAX_PALETTE_SIZE // PALETTE_WIDTH} rows at most",
        )
    return height * PALETTE_WIDTH, degree_by_width[width]


def _splat_count(data: dict[str, Any], version: int) -> int:
    """Return the number of splats: ``count``, or in version 1 the first number of means.shape."""
    if version == 1:
        means = data["means"]
        shape = means.get("shape") if isinstance(means, dict) else None
        first = shape[0] if isinstance(shape, list) and shape else None
        return _require_integer(first, f"{META_FILE}, means.shape", MAX_SPLATS)
    return _require_integer(data.get("count"), f"{META_FILE}, count", MAX_SPLATS)


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < math.inf


def _to_float(value: float) -> float:
    """Convert a JSON number; one that float64 cannot hold becomes infinite, and is refused."""
    return float(value) if abs(value) < 1e300 else math.inf


def _require_integer(value: object, where: str, most: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= most:
        raise HeaderMalformed(
            quoted(str(value)), where=where, expected=f"a whole number from 1 to {most}"
        )
    return value
