"""Viewpoints in words: where a camera stands, as people type it."""

__all__ = ["Viewpoint", "viewpoint"]

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera import Camera
from gsgen.runtime.sources import Source, direction

_FORMS: Final = (
    "Give orbit[:AZIMUTH,ELEVATION[,RADIUS]], look-at:EX,EY,EZ,TX,TY,TZ or a JSON file."
)
_AZIMUTH: Final = 30.0
_ELEVATION: Final = 20.0


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
    """

    orbit: tuple[float, float, float | None] | None
    look_at: tuple[float, ...] | None
    cameras: tuple[Camera, ...]
    width: int | None
    height: int | None
    fov: float
    up: tuple[float, float, float] | None = None
    flat: bool = False

    def camera(self, source: Source, number: int, turn: float) -> Camera:
        """Return the camera of frame ``number``.

        Args:
            source: What it looks at, where the words name no point.
            number: From 0; the cameras of a file are gone through, and then again.
            turn: Degrees that an orbit has gone on since the first frame.
        """
        center, reach = source.extent()
        made = self._placed(source, center, reach, number, turn)
        if not self.flat:
            return made
        ahead = float(made.view[2, :3] @ center + made.view[2, 3])
        return made.flattened(ahead if ahead > made.near else reach)

    def _placed(
        self,
        source: Source,
        center: Float[np.ndarray, "3"],
        reach: float,
        number: int,
        turn: float,
    ) -> Camera:
        if self.cameras:
            own = self.cameras[number % len(self.cameras)]
            return own.scaled(self.width or own.width, self.height or own.height)
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
) -> Viewpoint:
    """Read what a user typed for ``--camera``.

    Args:
        text: ``orbit``, ``look-at`` or a file; None orbits.
        width: See :class:`Viewpoint`.
        height: See :class:`Viewpoint`.
        fov: See :class:`Viewpoint`.
        up: An axis such as ``-y``; None for what the source says.
        flat: See :class:`Viewpoint`.

    Raises:
        ConfigInvalid: It is none of the forms.
        SceneInvalid: The file holds something that is no camera.
    """
    if not 0 < fov < 180:
        raise ConfigInvalid(f"{fov} degrees, wanted 0 to 180", where="--fov")
    upward = None if up is None else direction(up)
    head, _, rest = (text or "orbit").partition(":")
    if head == "orbit":
        numbers = _numbers(text or "", rest, (0, 2, 3)) if rest else ()
        azimuth, elevation = numbers[:2] or (_AZIMUTH, _ELEVATION)
        radius = numbers[2] if len(numbers) > 2 else None
        return Viewpoint(
            (azimuth, elevation, radius), None, (), width, height, fov, upward, flat
        )
    if head == "look-at":
        eye_and_target = _numbers(text or "", rest, (6,))
        return Viewpoint(None, eye_and_target, (), width, height, fov, upward, flat)
    return Viewpoint(None, None, _cameras(Path(text or "")), width, height, fov, flat=flat)


def _numbers(text: str, part: str, counts: tuple[int, ...]) -> tuple[float, ...]:
    try:
        numbers = tuple(float(one) for one in part.split(","))
    except ValueError as error:
        raise ConfigInvalid(f"{text!r}: {error}", where="--camera", mend=_FORMS) from error
    if len(numbers) not in counts or not all(map(math.isfinite, numbers)):
        wanted = " or ".join(map(str, counts))
        raise ConfigInvalid(
            f"{text!r} has {len(numbers)} numbers, wanted {wanted} finite ones",
            where="--camera",
            mend=_FORMS,
        )
    return numbers


def _cameras(path: Path) -> tuple[Camera, ...]:
    """Read one camera, or a list of them."""
    try:
        made = json.loads(path.read_text("utf-8"))
    except OSError as error:
        raise ConfigInvalid(
            f"{str(path)!r} is no camera and no file that can be read: {error.strerror}",
            where="--camera",
            mend=_FORMS,
        ) from error
    except ValueError as error:
        raise ConfigInvalid(f"is no JSON: {error}", where=str(path)) from error
    if made == []:
        raise ConfigInvalid("holds no camera", where=str(path))
    return tuple(
        Camera.from_dict(one) for one in (made if isinstance(made, list) else [made])
    )
