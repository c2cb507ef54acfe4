"""The cameras of a camera file, and their selection by name, number or slice."""

__all__ = ["CameraFile", "NamedCamera"]

import re
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Final, final

from gsgen.contract.errors import ConfigInvalid, UnknownName
from gsgen.runtime.scene.camera import Camera

_LISTED_NAMES: Final = 8  # names that an error lists
_SLICE_PATTERN: Final = re.compile(r"(-?\d*):(-?\d*)(?::(-?\d*))?")


@final
@dataclass(frozen=True, slots=True)
class NamedCamera:
    """A camera with its name in a camera file, most often the file name of an image.

    ``time`` is the time of the scene in this camera's picture, if the file has one.
    """

    name: str
    camera: Camera
    time: float | None = None


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CameraFile:
    """The contents of a camera file: at least one camera.

    Attributes:
        path: Path of the file.
        format: Title of the file's format.
        cameras: The cameras, in the order of the file.
        notes: Sentences about losses, such as cameras without a pose, and fields that are not used.
        fps: Frames per second of a camera path that has a rate.
    """

    path: str
    format: str
    cameras: tuple[NamedCamera, ...]
    notes: tuple[str, ...] = ()
    fps: float | None = None

    def pick(self, selection: str | None) -> tuple[NamedCamera, ...]:
        """Return the cameras of a camera file that a name, a number or a slice selects.

        Args:
            selection: A name, its last part with or without the suffix, a number from 0 (from the
                end if negative), or a slice such as ``0:10``, ``::5``; None for all. Names are
                tried before numbers.

        Raises:
            ConfigInvalid: The selection matches no camera, or a name matches several.
        """
        if selection is None:
            return self.cameras
        for name_form in (_full_name, _file_name, _file_stem):
            matches = [camera for camera in self.cameras if name_form(camera.name) == selection]
            if len(matches) > 1:
                raise ConfigInvalid(
                    f"{len(matches)} cameras are called {selection!r}: {_list_names(matches)}",
                    where=self.path,
                    hint="Give a number from 0, or the full name.",
                )
            if matches:
                return tuple(matches)
        if re.fullmatch(r"-?\d{1,9}", selection):
            return (self._camera_by_number(int(selection)),)
        if match := _SLICE_PATTERN.fullmatch(selection):
            return self._cameras_in_slice(selection, match)
        raise self._unknown_camera_error(selection)

    def _camera_by_number(self, number: int) -> NamedCamera:
        count = len(self.cameras)
        if not -count <= number < count:
            raise ConfigInvalid(
                f"has no camera {number}, expected 0 to {count - 1}", where=self.path
            )
        return self.cameras[number]

    def _cameras_in_slice(self, selection: str, match: re.Match[str]) -> tuple[NamedCamera, ...]:
        first, last, step = (
            int(slice_bound) if slice_bound and slice_bound != "-" else None
            for slice_bound in match.groups()
        )
        matches = self.cameras[slice(first, last, step)] if step != 0 else ()
        if not matches:
            raise ConfigInvalid(
                f"{selection!r} selects none of the {len(self.cameras)} cameras", where=self.path
            )
        return matches

    def _unknown_camera_error(self, selection: str) -> ConfigInvalid:
        form = _file_name if "." in selection else _file_stem
        form = _full_name if "/" in selection else form
        known_names = {form(camera.name) for camera in self.cameras}
        error = UnknownName.among("camera", selection, known_names, self.path)
        return ConfigInvalid(
            error.message,
            where=self.path,
            hint=f"{error.hint} It has {_list_names(self.cameras)}; a number from 0 works, too.",
        )


def _full_name(name: str) -> str:
    return name


def _file_name(name: str) -> str:
    return PurePosixPath(name).name


def _file_stem(name: str) -> str:
    return PurePosixPath(name).stem


def _list_names(cameras: list[NamedCamera] | tuple[NamedCamera, ...]) -> str:
    names = ", ".join(camera.name for camera in cameras[:_LISTED_NAMES])
    unlisted_count = len(cameras) - _LISTED_NAMES
    return f"{names} and {unlisted_count} more" if unlisted_count > 0 else names
