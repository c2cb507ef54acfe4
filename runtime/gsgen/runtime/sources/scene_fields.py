"""Fields of a scene file: each is taken out by name and judged, and none may be left over."""

__all__ = ["Fields", "fields_of", "refuse"]

from collections.abc import Iterator, Mapping
from typing import Any, NoReturn, TypeVar, final, overload

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import UnknownName
from gsgen.runtime.errors import SceneInvalid

_MOST = 1e12
Word = TypeVar("Word", bound=str)


def refuse(message: str, where: str, hint: str = "") -> NoReturn:
    """Raise SceneInvalid.

    Raises:
        SceneInvalid: Always.
    """
    raise SceneInvalid(message, where=where, hint=hint)


def fields_of(document: Mapping[str, Any], where: str) -> "Fields":
    """Return the fields of the outermost object of the file ``where``."""
    return Fields(document, where, ": ")


@final
class Fields:
    """One object of the file.

    Args:
        made: The object.
        where: Its place, which errors name.
        joint: What stands between that and the name of a field.
    """

    def __init__(self, document: Mapping[str, Any], where: str, joint: str = ".") -> None:
        self._made, self.where, self._joint = document, where, joint
        self._known: list[str] = []

    def place(self, name: str) -> str:
        """Return what to call the place of a field."""
        return f"{self.where}{self._joint}{name}"

    def refuse(self, name: str, message: str) -> NoReturn:
        """Say what is wrong with a field.

        Raises:
            SceneInvalid: Always.
        """
        refuse(message, self.place(name))

    def has(self, name: str) -> bool:
        """Say whether a field is there, and not null."""
        return self.peek(name) is not None

    def peek(self, name: str) -> Any:
        """Return a field as it is; None where it is not there."""
        self._known.append(name)
        return self._made.get(name)

    def take(self, name: str, expected: str) -> Any:
        """Return a field that is text, or one of the other kinds that ``expected`` names."""
        value = self.peek(name)
        kinds: tuple[type, ...] = (str,)
        if "numbers" in expected:
            kinds = (str, list)
        if "object" in expected:
            kinds = (str, dict)
        if value is not None and not isinstance(value, kinds):
            self._wrong(name, expected)
        return value

    def required(self, name: str) -> str:
        """Return a text that has to be there."""
        value = self.peek(name)
        if not isinstance(value, str) or not value:
            self._wrong(name, "text")
        return str(value)

    @overload
    def number(
        self, name: str, *, low: float = ..., high: float = ..., fallback: float
    ) -> float: ...
    @overload
    def number(
        self, name: str, *, low: float = ..., high: float = ..., fallback: None = ...
    ) -> float | None: ...
    def number(
        self,
        name: str,
        *,
        low: float = -_MOST,
        high: float = _MOST,
        fallback: float | None = None,
    ) -> float | None:
        """Return a number from ``low`` to ``high``."""
        value = self.peek(name)
        if value is None:
            return fallback
        if isinstance(value, bool) or not isinstance(value, int | float):
            self._wrong(name, "a number")
        if not low <= value <= high:
            least = f"from {low:g}" if low > -_MOST else ""
            most = f"to {high:g}" if high < _MOST else ""
            self._wrong(name, " ".join(filter(None, ["a finite number", least, most])))
        return float(value)

    def whole(self, name: str, *, low: int, high: int) -> int | None:
        """Return a whole number from ``low`` to ``high``."""
        value = self.peek(name)
        if value is None:
            return None
        if (
            isinstance(value, bool)
            or not isinstance(value, int)
            or not low <= value <= high
        ):
            self._wrong(name, f"a whole number from {low} to {high}")
        return int(value)

    def side(self, name: str) -> int | None:
        """Return a number of pixels."""
        return self.whole(name, low=1, high=16_384)

    def choice(self, name: str, known: tuple[Word, ...]) -> Word | None:
        """Return one of several words.

        Raises:
            UnknownName: It is none of them; the nearest is suggested.
        """
        value = self.peek(name)
        if value is not None and value not in known:
            if not isinstance(value, str):
                self._wrong(name, " or ".join(known))
            raise UnknownName.among("word", value, known, self.place(name))
        return next((word for word in known if word == value), None)

    def array(self, name: str, *shapes: tuple[int, ...]) -> Float[np.ndarray, "..."] | None:
        """Return an array of finite numbers of one of some shapes."""
        value = self.peek(name)
        if value is None:
            return None
        kinds = [
            "a number" if not shape else "×".join(map(str, shape)) + " numbers"
            for shape in shapes
        ]
        expected = " or ".join(kinds)
        try:
            array = np.array(value)
        except ValueError:  # rows of several lengths
            self._wrong(name, expected)
        if array.dtype.kind not in "if" or array.shape not in shapes:
            self._wrong(name, expected)
        if not (np.abs(array) <= _MOST).all():
            self._wrong(name, f"{expected} that are finite")
        return array.astype(np.float64)

    def mapping(self, name: str) -> Mapping[str, Any]:
        """Return an object of any names, whose values are numbers or lists of them."""
        value = self.peek(name)
        if value is None:
            return {}
        if not isinstance(value, dict):
            self._wrong(name, "an object")
        return {key: self._values(f"{name}.{key}", value) for key, value in value.items()}

    def _values(self, name: str, value: Any) -> np.ndarray:
        try:
            array = np.array(value)
        except ValueError:
            array = np.array(None)
        if array.dtype.kind not in "ifb":
            refuse(f"is {_shown(value)}, wanted numbers", self.place(name))
        return array

    def inner(self, name: str) -> "Fields":
        """Return the fields of an object in a field."""
        value = self.peek(name)
        if not isinstance(value, dict):
            self._wrong(name, "an object")
        return Fields(value, self.place(name))

    def parts(self, name: str) -> Iterator["Fields"]:
        """Yield the fields of each object of a list; a text stands for an object of its path."""
        entries = self.peek(name)
        if entries is not None and not isinstance(entries, list):
            self._wrong(name, "a list")
        for index, entry in enumerate(entries or []):
            where = f"{self.place(name)}[{index}]"
            document = {"path": entry} if isinstance(entry, str) else entry
            if not isinstance(document, dict):
                refuse(f"is {_shown(entry)}, wanted an object or a path", where)
            yield Fields(document, where)

    def close(self) -> None:
        """Make sure that nothing was left over.

        Raises:
            UnknownName: There is a field that nobody asked for; the nearest name is suggested.
        """
        for name in self._made:
            if name not in self._known:
                raise UnknownName.among("field", name, set(self._known), self.where)

    def _wrong(self, name: str, expected: str) -> NoReturn:
        if name not in self._made:
            refuse(f"is missing: wanted {expected}", self.place(name))
        refuse(f"is {_shown(self._made[name])}, wanted {expected}", self.place(name))


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:59] + "…"
