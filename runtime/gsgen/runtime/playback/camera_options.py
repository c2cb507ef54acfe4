"""Viewpoints in words: where a camera stands, as people type it."""

__all__ = ["Viewpoint", "viewpoint"]

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files import open_cameras, split_pick
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.sources.source import Source, direction

_FORMS: Final = "Give orbit[:AZIMUTH,ELEVATION[,RADIUS]], look-at:EX,EY,EZ,TX,TY,TZ or a file of cameras."
_AZIMUTH: Final = 30.0
_ELEVATION: Final = 20.0
_AROUND: Final = 2048  # pixels that a panorama is wide


@final
@dataclass(frozen=True, slots=True)
class Viewpoint:
    """What ``--camera`` and its companions say.

    Attributes:
        orbit: Azimuth and elevation in degrees, and the radius, or None for one that fits.
        look_at: Eye and target, six numbers.
        cameras: Cameras of a file.
        width: Of the image; None for the camera's own, or 1280.
        height: Of the image; None for the camera's own, or 720.
        fov: Vertical field of view, in degrees.
        up: The upward direction; None for what the source says.
        flat: Whether the camera is orthographic; what it looks at is as large as without.
        around: Whether it is a panorama. An orbit without a radius then stands in the middle; a
            camera of a file stays as it is turned, unless ``up`` says where its poles are.
        notes: What is to be said about the cameras of the file.
    """

    orbit: tuple[float, float, float | None] | None
    look_at: tuple[float, ...] | None
    cameras: tuple[Camera, ...]
    width: int | None
    height: int | None
    fov: float
    up: tuple[float, float, float] | None = None
    flat: bool = False
    around: bool = False
    notes: tuple[str, ...] = ()

    @property
    def sizes(self) -> set[tuple[int, int]]:
        """Widths and heights that the cameras of a file have here; nothing without a file."""
        return {
            (self.width or camera.width, self.height or camera.height)
            for camera in self.cameras
            if not self.around
        }

    def camera(self, source: Source, number: int, turn: float) -> Camera:
        """Return the camera of frame ``number``.

        Args:
            source: What it looks at, where the words name no point.
            number: From 0; the cameras of a file are gone through, and then again.
            turn: Degrees that an orbit has gone on since the first frame.
        """
        center, reach = source.extent()
        if self.around:
            return self._panorama(source, center, number, turn)
        camera = self._placed(source, center, reach, number, turn)
        if not self.flat:
            return camera
        ahead = float(camera.view[2, :3] @ center + camera.view[2, 3])
        return camera.flattened(ahead if ahead > camera.near else reach)

    def _panorama(
        self, source: Source, center: Float[np.ndarray, "3"], number: int, turn: float
    ) -> Camera:
        width = self.width or (2 * self.height if self.height else _AROUND)
        height = self.height or max(1, width // 2)
        if self.cameras:
            file_camera = self.cameras[number % len(self.cameras)]
            if self.up is None:
                return file_camera.all_around(width, height)
            eye, toward = file_camera.eye.tolist(), file_camera.view[2, :3].tolist()
            return Camera.panorama(eye, toward, up=self.up, width=width, height=height)
        eye, toward = self._heading(source, center, turn)
        up = self.up or source.up
        return Camera.panorama(eye, toward, up=up, width=width, height=height)

    def _heading(
        self, source: Source, center: Float[np.ndarray, "3"], turn: float
    ) -> tuple[list[float], list[float]]:
        """Return where a panorama is seen from, and which way its middle looks."""
        if self.look_at is not None:
            eye, target = np.array(self.look_at[:3]), np.array(self.look_at[3:])
            return eye.tolist(), (target - eye).tolist()
        azimuth, elevation, radius = self.orbit or (_AZIMUTH, _ELEVATION, None)
        middle, azimuth, up = center.tolist(), azimuth + turn, self.up or source.up
        level = Camera.orbit(middle, 1.0, azimuth=azimuth, up=up).view[2, :3].tolist()
        if radius is None:
            return middle, level
        orbit = Camera.orbit(middle, radius, azimuth=azimuth, elevation=elevation, up=up)
        return orbit.eye.tolist(), level

    def _placed(
        self,
        source: Source,
        center: Float[np.ndarray, "3"],
        reach: float,
        number: int,
        turn: float,
    ) -> Camera:
        if self.cameras:
            file_camera = self.cameras[number % len(self.cameras)]
            return file_camera.scaled(
                self.width or file_camera.width, self.height or file_camera.height
            )
        size = {"width": self.width or 1280, "height": self.height or 720}
        up = self.up or source.up
        if self.look_at is not None:
            eye, target = self.look_at[:3], self.look_at[3:]
            return Camera.look_at(eye, target, up=up, fov_y=self.fov, **size)
        azimuth, elevation, radius = self.orbit or (_AZIMUTH, _ELEVATION, None)
        if radius is None:
            narrow = self.fov * min(1.0, size["width"] / size["height"])
            radius = reach / math.sin(math.radians(narrow) / 2)
        return Camera.orbit(
            center.tolist(),
            radius,
            azimuth=azimuth + turn,
            elevation=elevation,
            up=up,
            fov_y=self.fov,
            near=min(0.01, radius / 100),
            **size,
        )


def viewpoint(
    text: str | None,
    width: int | None = None,
    height: int | None = None,
    fov: float = 50.0,
    up: str | None = None,
    flat: bool = False,
    around: bool = False,
) -> Viewpoint:
    """Read what a user typed for ``--camera``.

    Args:
        text: ``orbit``, ``look-at``, or a file of cameras, of which ``#WHICH`` picks; None orbits.
        width: See :class:`Viewpoint`.
        height: See :class:`Viewpoint`.
        fov: See :class:`Viewpoint`.
        up: An axis such as ``-y``; None for what the source says.
        flat: See :class:`Viewpoint`.
        around: See :class:`Viewpoint`.

    Raises:
        ConfigInvalid: It is none of the forms.
        SceneInvalid: The file holds something that is no camera.
    """
    if not 0 < fov < 180:
        raise ConfigInvalid(f"{fov} degrees, wanted 0 to 180", where="--fov")
    if flat and around:
        both = "--orthographic and --panorama"
        raise ConfigInvalid("were both given; a camera is one of them", where=both)
    upward = None if up is None else direction(up)
    head, _, arguments = (text or "orbit").partition(":")
    if head == "orbit":
        numbers = _numbers(text or "", arguments, (0, 2, 3)) if arguments else ()
        azimuth, elevation = numbers[:2] or (_AZIMUTH, _ELEVATION)
        radius = numbers[2] if len(numbers) > 2 else None
        orbit = (azimuth, elevation, radius)
        return Viewpoint(orbit, None, (), width, height, fov, upward, flat, around)
    if head == "look-at":
        eye_and_target = _numbers(text or "", arguments, (6,))
        return Viewpoint(None, eye_and_target, (), width, height, fov, upward, flat, around)
    path, selection = split_pick(text or "")
    if not _exists(path):
        raise ConfigInvalid(
            f"{text!r} is no camera and no file that can be read",
            where="--camera",
            hint=_FORMS,
        )
    file = open_cameras(path)
    cameras = tuple(entry.camera for entry in file.pick(selection))
    return Viewpoint(
        None, None, cameras, width, height, fov, upward, flat, around, file.notes
    )


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # the name is too long, say
        return False


def _numbers(text: str, part: str, counts: tuple[int, ...]) -> tuple[float, ...]:
    try:
        numbers = tuple(float(word) for word in part.split(","))
    except ValueError as error:
        raise ConfigInvalid(f"{text!r}: {error}", where="--camera", hint=_FORMS) from error
    if len(numbers) not in counts or not all(map(math.isfinite, numbers)):
        expected = " or ".join(map(str, counts))
        raise ConfigInvalid(
            f"{text!r} has {len(numbers)} numbers, wanted {expected} finite ones",
            where="--camera",
            hint=_FORMS,
        )
    return numbers
