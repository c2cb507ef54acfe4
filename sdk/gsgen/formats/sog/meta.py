"""Parses the meta.json of a SOG file; values are checked on access."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NoReturn, final

import numpy as np
from jaxtyping import Float32, Float64

from gsgen.contract.file_kinds.recognition import kind_of
from gsgen.formats.shared.bytes import MAX_SPLATS, not_recognised
from gsgen.formats.shared.errors import FormatNotRecognised, HeaderMalformed, NotSupported, quoted
from gsgen.formats.shared.files import FilePath

META_FILE: Final = "meta.json"
"""The file that describes the images."""
STREAMED_META: Final = "lod-meta.json"
"""The file that lists the SOG files of several levels of detail."""
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

_EXPECTED_FILE: Final = "the meta.json of a SOG"
_SH_BANDS = (1, 2, 3)


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

    Attributes:
        data: The parsed file.
        count: The number of splats.
    """

    data: dict[str, Any]
    count: int

    @classmethod
    def parse(cls, content: bytes) -> "Meta":
        """Parse the meta.json of a SOG file.

        Raises:
            FormatNotRecognised: The content is not the JSON object of a SOG.
            NotSupported: The version is not 2, or the file lists levels of detail.
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
        if version != 2:
            raise NotSupported(
                f"the SOG version is {quoted(str(version))}", where=META_FILE, expected="version 2"
            )
        return cls(data, _require_integer(data.get("count"), f"{META_FILE}, count", MAX_SPLATS))

    @property
    def antialiased(self) -> bool:
        """Whether a SOG file declares antialiased splats, by one of two keys that writers use."""
        return self.data.get("model") == ANTIALIASED or self.data.get("antialias") is True

    def files(self, group: str, number: int) -> list[str]:
        """Return the image file names of a quantity ``group`` in SOG's meta.json."""
        names = self._require_list(group, "files", number)
        if not all(isinstance(name, str) for name in names):
            self._raise_malformed(group, "files", f"{number} names")
        return names

    def all_files(self) -> list[str]:
        """Return the names of all images that the meta.json of a SOG file lists."""
        numbers = {"means": 2, "scales": 1, "quats": 1, "sh0": 1, "shN": 2}
        groups = [group for group in numbers if self.data.get(group) is not None]
        return [name for group in groups for name in self.files(group, numbers[group])]

    def triple(self, group: str, key: str) -> Float64[np.ndarray, "3"]:
        """Return the three finite numbers at key ``key`` of ``group`` in SOG's meta.json."""
        return np.asarray(self._numbers(group, key, 3), np.float64)

    def codebook(self, group: str) -> Float32[np.ndarray, "256"]:
        """Return the 256 codebook numbers of ``group`` in SOG's meta.json."""
        with np.errstate(over="ignore"):  # the check of values refuses infinity
            numbers = np.array(self._numbers(group, "codebook", CODEBOOK_SIZE), np.float64)
            return numbers.astype(np.float32)

    def palette(self) -> tuple[int, int] | None:
        """Return the size and degree of the SH palette of a SOG file; None without higher SH."""
        if self.data.get("shN") is None:
            return None
        group = self._group("shN")
        size = _require_integer(group.get("count"), f"{META_FILE}, shN.count", MAX_PALETTE_SIZE)
        bands = group.get("bands")
        if bands not in _SH_BANDS:
            self._raise_malformed("shN", "bands", "1, 2 or 3")
        return size, int(bands)

    def _group(self, group: str) -> dict[str, Any]:
        entry = self.data.get(group)
        if not isinstance(entry, dict):
            raise HeaderMalformed(
                f"the JSON object lacks the key {group!r}", where=META_FILE, expected="an object"
            )
        return entry

    def _require_list(self, group: str, key: str, number: int) -> list[Any]:
        entries = self._group(group).get(key)
        if not isinstance(entries, list) or len(entries) != number:
            self._raise_malformed(group, key, f"a list of {number}")
        return entries

    def _numbers(self, group: str, key: str, number: int) -> list[float]:
        entries = self._require_list(group, key, number)
        for value in entries:
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if not (is_number and abs(value) < math.inf):
                self._raise_malformed(group, key, f"{number} finite numbers")
        return [float(value) if abs(value) < 1e300 else math.inf for value in entries]

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


def _require_integer(value: object, where: str, most: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= most:
        raise HeaderMalformed(
            quoted(str(value)), where=where, expected=f"a whole number from 1 to {most}"
        )
    return value
