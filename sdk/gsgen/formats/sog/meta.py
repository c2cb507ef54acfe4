"""The meta.json of a SOG, each value judged when it is asked for."""

import json
import math
from dataclasses import dataclass
from typing import Any, Final, NoReturn, final

import numpy as np
from jaxtyping import Float32, Float64

from gsgen.formats.shared.errors import HeaderMalformed, NotRecognised, NotSupported, shown

META: Final = "meta.json"
"""The file that says what the images mean."""

_MOST_SPLATS = 2**31 - 1
_MOST_PALETTE = 1 << 16
_CODES = 256
_BANDS = (1, 2, 3)


@final
@dataclass(frozen=True, slots=True)
class Meta:
    """What meta.json says.

    Attributes:
        data: The parsed file.
        count: How many splats there are.
    """

    data: dict[str, Any]
    count: int

    @classmethod
    def parse(cls, content: bytes) -> "Meta":
        """Read meta.json.

        Raises:
            NotRecognised: It is no JSON object of a SOG.
            NotSupported: It is of another version, or lists levels of detail.
            HeaderMalformed: It does not say how many splats there are.
        """
        data = _object(content)
        if "lodLevels" in data or "tree" in data:
            raise NotSupported(
                "a streamed SOG of several levels of detail",
                where=META,
                expected="one SOG",
                hint="read one of the files that it names",
            )
        if "means" not in data:
            raise NotRecognised(
                "JSON without means", where=META, expected="the meta.json of a SOG"
            )
        version = data.get("version", 1)
        if version != 2:
            raise NotSupported(f"version {shown(str(version))}", where=META, expected="2")
        return cls(data, _whole(data.get("count"), f"{META}, count", _MOST_SPLATS))

    def files(self, group: str, number: int) -> list[str]:
        """Return the names of the images of ``group``."""
        found = self._list(group, "files", number)
        if not all(isinstance(name, str) for name in found):
            self._refuse(group, "files", f"{number} names")
        return found

    def triple(self, group: str, key: str) -> Float64[np.ndarray, "3"]:
        """Return three finite numbers."""
        return np.asarray(self._numbers(group, key, 3), np.float64)

    def codebook(self, group: str) -> Float32[np.ndarray, "256"]:
        """Return the 256 numbers that the bytes of an image mean."""
        with np.errstate(over="ignore"):  # as infinity it meets the check of values
            numbers = np.array(self._numbers(group, "codebook", _CODES), np.float64)
            return numbers.astype(np.float32)

    def palette(self) -> tuple[int, int] | None:
        """Return the size of the palette of harmonics and their degree, if there are any."""
        if self.data.get("shN") is None:
            return None
        group = self._group("shN")
        size = _whole(group.get("count"), f"{META}, shN.count", _MOST_PALETTE)
        bands = group.get("bands")
        if bands not in _BANDS:
            self._refuse("shN", "bands", "1, 2 or 3")
        return size, int(bands)

    def _group(self, group: str) -> dict[str, Any]:
        found = self.data.get(group)
        if not isinstance(found, dict):
            raise HeaderMalformed(f"no {group}", where=META, expected="an object")
        return found

    def _list(self, group: str, key: str, number: int) -> list[Any]:
        found = self._group(group).get(key)
        if not isinstance(found, list) or len(found) != number:
            self._refuse(group, key, f"a list of {number}")
        return found

    def _numbers(self, group: str, key: str, number: int) -> list[float]:
        found = self._list(group, key, number)
        for value in found:
            number_like = isinstance(value, int | float) and not isinstance(value, bool)
            if not (number_like and abs(value) < math.inf):
                self._refuse(group, key, f"{number} finite numbers")
        return [float(value) if abs(value) < 1e300 else math.inf for value in found]

    def _refuse(self, group: str, key: str, expected: str) -> NoReturn:
        found = shown(str(self._group(group).get(key)))
        raise HeaderMalformed(found, where=f"{META}, {group}.{key}", expected=expected)


def _object(content: bytes) -> dict[str, Any]:
    try:
        data = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise NotRecognised(
            f"no JSON ({error})", where=META, expected="the meta.json of a SOG"
        ) from error
    if not isinstance(data, dict):
        raise NotRecognised(
            f"a {type(data).__name__}", where=META, expected="an object, as of a SOG"
        )
    return data


def _whole(value: object, where: str, most: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= most:
        raise HeaderMalformed(
            shown(str(value)), where=where, expected=f"a whole number from 1 to {most}"
        )
    return value
