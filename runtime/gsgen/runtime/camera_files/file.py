"""What a file of cameras holds, and how one of them is picked."""

__all__ = ["CameraFile", "NamedCamera"]

import re
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Final, final

from gsgen.contract.errors import ConfigInvalid, UnknownName
from gsgen.runtime.scene.camera import Camera

_SHOWN: Final = 8  # names that an error lists
_SLICE: Final = re.compile(r"(-?\d*):(-?\d*)(?::(-?\d*))?")


@final
@dataclass(frozen=True, slots=True)
class NamedCamera:
    """A camera of a file.

    Attributes:
        name: What the file calls it, most often its picture.
        camera: The camera, in the file's world.
    """

    name: str
    camera: Camera


@final
@dataclass(frozen=True, slots=True)
class CameraFile:
    """The cameras of a file.

    Attributes:
        path: Where they were read from.
        format: What the file is, in words.
        cameras: In the order of the file; at least one.
        notes: What the cameras leave out, such as lens distortion: a sentence each.
    """

    path: str
    format: str
    cameras: tuple[NamedCamera, ...]
    notes: tuple[str, ...] = ()

    def pick(self, which: str | None) -> tuple[NamedCamera, ...]:
        """Return the cameras that ``which`` names.

        Args:
            which: A name, its last part with or without the suffix, a number from 0 (from the end
                if negative), or a slice such as ``0:10``, ``::5``; None for all. A name comes
                before a number.

        Raises:
            ConfigInvalid: It names none, or several.
        """
        if which is None:
            return self.cameras
        for known_as in (_whole, _last, _stem):
            found = [one for one in self.cameras if known_as(one.name) == which]
            if len(found) > 1:
                raise ConfigInvalid(
                    f"{len(found)} cameras are called {which!r}: {_listed(found)}",
                    where=self.path,
                    hint="Give a number from 0, or the whole name.",
                )
            if found:
                return tuple(found)
        if re.fullmatch(r"-?\d{1,9}", which):
            return (self._numbered(int(which)),)
        if match := _SLICE.fullmatch(which):
            return self._slice(which, match)
        raise self._unknown(which)

    def _numbered(self, number: int) -> NamedCamera:
        count = len(self.cameras)
        if not -count <= number < count:
            raise ConfigInvalid(
                f"has {count} cameras, numbered from 0 to {count - 1}; {number} is none of them",
                where=self.path,
            )
        return self.cameras[number]

    def _slice(self, which: str, match: re.Match[str]) -> tuple[NamedCamera, ...]:
        first, last, step = (
            int(one) if one and one != "-" else None for one in match.groups()
        )
        found = self.cameras[slice(first, last, step)] if step != 0 else ()
        if not found:
            raise ConfigInvalid(
                f"{which!r} takes none of the {len(self.cameras)} cameras", where=self.path
            )
        return found

    def _unknown(self, which: str) -> ConfigInvalid:
        error = UnknownName.among(
            "camera", which, (_last(one.name) for one in self.cameras), self.path
        )
        return ConfigInvalid(
            error.message,
            where=self.path,
            hint=f"{error.hint} It has {_listed(self.cameras)}; a number from 0 will do, too.",
        )


def _whole(name: str) -> str:
    return name


def _last(name: str) -> str:
    return PurePosixPath(name).name


def _stem(name: str) -> str:
    return PurePosixPath(name).stem


def _listed(cameras: list[NamedCamera] | tuple[NamedCamera, ...]) -> str:
    names = ", ".join(one.name for one in cameras[:_SHOWN])
    more = len(cameras) - _SHOWN
    return f"{names} and {more} more" if more > 0 else names
