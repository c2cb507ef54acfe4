"""Parses ``--camera`` and its companion options into the cameras of all frames."""

__all__ = ["DEFAULT_FOV", "FRAMING_MARGIN", "Viewpoint", "viewpoint"]

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, final

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.scene.camera import DEFAULT_NEAR, Camera
from gsgen.runtime.sources.key_frames import KeyFrames, Span
from gsgen.runtime.sources.source import Source, axis_direction

_ACCEPTED_FORMS_HINT: Final = (
    "Give orbit[:AZIMUTH,ELEVATION[,RADIUS]], look-at:EX,EY,EZ,TX,TY,TZ or a file of cameras."
)
_DEFAULT_AZIMUTH: Final = 30.0
_ELEVATION_DEGREES: Final = 20.0
_LOOK_AT_NUMBERS: Final = 6
_PANORAMA_WIDTH: Final = 2048  # pixels
_DEFAULT_WIDTH, _DEFAULT_HEIGHT = 1280, 720


FRAMING_MARGIN: Final = 1.05
"""Radius of an orbit without one, over the least radius from which a scene is in the picture."""
DEFAULT_FOV: Final = 50.0
"""The default vertical field of view, in degrees."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Viewpoint:
    """The cameras of all frames of a video, as the camera options describe them.

    One of ``orbit``, ``look_at`` and ``cameras`` is set; without any, the camera orbits.

    Attributes:
        orbit: Azimuth and elevation in degrees, and the radius, or None for one that fits.
        look_at: Eye and target, six numbers.
        cameras: Cameras of a file.
        width: Width of the image in pixels; None for the camera's own (or in proportion to the
            height), or 1280.
        height: Height of the image in pixels; None for the camera's own (or in proportion to the
            width), or 720.
        fov: Vertical field of view, in degrees.
        up: The upward direction; None for that of the source.
        is_orthographic: Whether there is no perspective; the scene's centre keeps its size.
        is_panorama: Whether the camera sees all directions. An orbit without a radius is then in
            the middle; a camera of a file keeps its rotation, unless ``up`` is set.
        file_notes: Notes on the file of cameras.
        times: The time of the scene at each of ``cameras``, of a file that has times.
        fps: Frames per second of a camera path with a rate.
        keys: Key frames of an orbit, or of eye and target, in place of these.
        span: The timeline of the key frames.
    """

    orbit: tuple[float, float, float | None] | None = None
    look_at: tuple[float, ...] | None = None
    cameras: tuple[Camera, ...] = ()
    width: int | None = None
    height: int | None = None
    fov: float = DEFAULT_FOV
    up: tuple[float, float, float] | None = None
    is_orthographic: bool = False
    is_panorama: bool = False
    file_notes: tuple[str, ...] = ()
    times: tuple[float, ...] = ()
    fps: float | None = None
    keys: KeyFrames | None = None
    span: Span | None = None

    def at(self, number: int, frames: int) -> "Viewpoint":
        """Return the viewpoint of frame ``number``, from 0, by the key frames if there are any."""
        if self.keys is None or self.span is None:
            return self
        numbers = tuple(self.keys.at(self.span.seconds_of(number, frames)).tolist())
        if len(numbers) == _LOOK_AT_NUMBERS:
            return replace(self, orbit=None, look_at=numbers)
        radius = numbers[2] if len(numbers) > 2 else None
        return replace(self, orbit=(numbers[0], numbers[1], radius), look_at=None)

    @property
    def sizes(self) -> set[tuple[int, int]]:
        """The image sizes of the cameras from a camera file; empty without a file."""
        return {self._size(camera) for camera in self.cameras if not self.is_panorama}

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the cameras for the user: losses of their file, and images of another shape."""
        return self.file_notes + self._camera_shape_notes()

    def _camera_shape_notes(self) -> tuple[str, ...]:
        """Return a note if images have another shape than the cameras of the file."""
        reshaped_cameras = [
            camera
            for camera in self.cameras
            if not self.is_panorama and not camera.has_shape(*self._size(camera))
        ]
        if not reshaped_cameras:
            return ()
        camera, (width, height) = reshaped_cameras[0], self._size(reshaped_cameras[0])
        is_wider = width * camera.height > height * camera.width
        frame_effect = "shows more at" if is_wider else "crops"
        sides = "the left and right"
        if camera.kind == "panorama":
            frame_effect, sides = "crops", "the top and bottom" if is_wider else sides
        return (
            f"{len(reshaped_cameras)} of {len(self.cameras)} cameras have another shape, such as "
            f"{camera.width}×{camera.height}: an image of {width}×{height} {frame_effect} {sides}, and "
            "nothing is stretched",
        )

    def _size(self, camera: Camera) -> tuple[int, int]:
        """Return the image size of a camera of a file; one given side keeps the shape."""
        if self.width is not None and self.height is not None:
            return self.width, self.height
        if self.width is not None:
            return self.width, max(1, round(camera.height * self.width / camera.width))
        if self.height is not None:
            return max(1, round(camera.width * self.height / camera.height)), self.height
        return camera.width, camera.height

    def camera(self, source: Source, number: int, turn: float) -> Camera:
        """Return the camera of frame ``number``, from 0; the cameras of a camera file repeat.

        An orbit is around ``source``, and has turned by ``turn`` degrees since the first frame.
        """
        center, reach = source.extent()
        if self.is_panorama:
            return self._panorama(source, center, number, turn)
        camera = self._place_cameras(source, center, reach, number, turn)
        if not self.is_orthographic:
            return camera
        depth_of_center = float(camera.view[2, :3] @ center + camera.view[2, 3])
        return camera.flattened(depth_of_center if depth_of_center > camera.near else reach)

    def _panorama(
        self, source: Source, center: Float[np.ndarray, "3"], number: int, turn: float
    ) -> Camera:
        width = self.width or (2 * self.height if self.height else _PANORAMA_WIDTH)
        height = self.height or max(1, width // 2)
        if self.cameras:
            file_camera = self.cameras[number % len(self.cameras)]
            if self.up is None:
                return file_camera.panorama_around(width, height)
            eye, toward = file_camera.eye.tolist(), file_camera.view[2, :3].tolist()
            return Camera.panorama(eye, toward, up=self.up, width=width, height=height)
        eye, toward = self._panorama_pose(source, center, turn)
        up = self.up or source.up
        return Camera.panorama(eye, toward, up=up, width=width, height=height)

    def _panorama_pose(
        self, source: Source, center: Float[np.ndarray, "3"], turn: float
    ) -> tuple[list[float], list[float]]:
        """Return a panorama camera's position, and the direction of the image's middle column."""
        if self.look_at is not None:
            eye, target = np.array(self.look_at[:3]), np.array(self.look_at[3:])
            return eye.tolist(), (target - eye).tolist()
        azimuth, elevation, radius = self.orbit or (_DEFAULT_AZIMUTH, _ELEVATION_DEGREES, None)
        middle, azimuth, up = center.tolist(), azimuth + turn, self.up or source.up
        level = Camera.orbit(middle, 1.0, azimuth=azimuth, up=up).view[2, :3].tolist()
        if radius is None:
            return middle, level
        orbit = Camera.orbit(middle, radius, azimuth=azimuth, elevation=elevation, up=up)
        return orbit.eye.tolist(), level

    def _place_cameras(
        self, source: Source, center: Float[np.ndarray, "3"], reach: float, number: int, turn: float
    ) -> Camera:
        if self.cameras:
            file_camera = self.cameras[number % len(self.cameras)]
            return file_camera.resized(*self._size(file_camera))
        size = {"width": self.width or _DEFAULT_WIDTH, "height": self.height or _DEFAULT_HEIGHT}
        up = self.up or source.up
        if self.look_at is not None:
            eye, target = self.look_at[:3], self.look_at[3:]
            return Camera.look_at(eye, target, up=up, fov_y=self.fov, **size)
        azimuth, elevation, radius = self.orbit or (_DEFAULT_AZIMUTH, _ELEVATION_DEGREES, None)
        if radius is None:
            narrow_fov = self.fov * min(1.0, size["width"] / size["height"])
            radius = FRAMING_MARGIN * reach / math.sin(math.radians(narrow_fov) / 2)
        return Camera.orbit(
            center.tolist(),
            radius,
            azimuth=azimuth + turn,
            elevation=elevation,
            up=up,
            fov_y=self.fov,
            near=min(DEFAULT_NEAR, radius / 100),
            **size,
        )


def viewpoint(
    text: str | None,
    width: int | None = None,
    height: int | None = None,
    fov: float = DEFAULT_FOV,
    up: str | None = None,
    *,
    orthographic: bool = False,
    panorama: bool = False,
) -> Viewpoint:
    """Parse the value of ``--camera`` and its companion options; see :class:`Viewpoint`.

    ``text`` is ``orbit``, ``look-at`` or a file of cameras, from which ``#NAME`` selects; None
    orbits. ``up`` is an axis such as ``-y``; None is that of the source.
    """
    if not 0 < fov < 180:
        message = f"is {fov} degrees, expected more than 0 and less than 180"
        raise ConfigInvalid(message, where="--fov")
    if orthographic and panorama:
        raise ConfigInvalid(
            "exclude each other: a camera has one projection",
            where="--orthographic and --panorama",
            hint="Leave one of them out.",
        )
    up_vector = None if up is None else axis_direction(up)
    viewpoint_base = Viewpoint(
        width=width,
        height=height,
        fov=fov,
        up=up_vector,
        is_orthographic=orthographic,
        is_panorama=panorama,
    )
    camera_type, _, arguments = (text or "orbit").partition(":")
    if camera_type == "orbit":
        numbers = _parse_number_list(text or "", arguments, (0, 2, 3)) if arguments else ()
        azimuth, elevation = numbers[:2] or (_DEFAULT_AZIMUTH, _ELEVATION_DEGREES)
        radius = numbers[2] if len(numbers) > 2 else None
        return replace(viewpoint_base, orbit=(azimuth, elevation, radius))
    if camera_type == "look-at":
        eye_and_target = _parse_number_list(text or "", arguments, (6,))
        return replace(viewpoint_base, look_at=eye_and_target)
    from gsgen.runtime.camera_files import open_cameras, split_pick

    path, selection = split_pick(text or "")
    if not _does_path_exist(path):
        raise ConfigInvalid(
            f"{text!r} is neither a camera nor an existing file",
            where="--camera",
            hint=_ACCEPTED_FORMS_HINT,
        )
    size = (width, height) if width is not None and height is not None else None
    file = open_cameras(path, size)
    entries = file.pick(selection)
    times = [entry.time for entry in entries if entry.time is not None]
    notes = file.notes
    if 0 < len(times) < len(entries):
        notes += (f"{path}: not used: the times, which only {len(times)} of {len(entries)} have",)
        times = []
    return replace(
        viewpoint_base,
        cameras=tuple(entry.camera for entry in entries),
        file_notes=notes,
        times=tuple(times),
        fps=file.fps,
    )


def _does_path_exist(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # for example a name that is too long
        return False


def _parse_number_list(text: str, part: str, counts: tuple[int, ...]) -> tuple[float, ...]:
    try:
        numbers = tuple(float(word) for word in part.split(","))
    except ValueError as error:
        raise ConfigInvalid(
            f"{text!r}: {error}", where="--camera", hint=_ACCEPTED_FORMS_HINT
        ) from error
    if len(numbers) not in counts or not all(map(math.isfinite, numbers)):
        expected = " or ".join(map(str, counts))
        raise ConfigInvalid(
            f"{text!r} has {len(numbers)} numbers, expected {expected} finite ones",
            where="--camera",
            hint=_ACCEPTED_FORMS_HINT,
        )
    return numbers
