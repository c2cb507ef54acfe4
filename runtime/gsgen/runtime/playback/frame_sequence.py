"""Draws every frame of a playback into an image file, a video or a folder."""

__all__ = ["FULL_TURN_DEGREES", "FrameSequence", "metres_of_unit"]

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal, final

import numpy as np

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.media import deep_pictures, pictures
from gsgen.runtime.media.mp4 import Sound
from gsgen.runtime.media.output_formats import require_output_format
from gsgen.runtime.media.pictures import PICTURE_MODES, Mode
from gsgen.runtime.playback.camera_options import Viewpoint
from gsgen.runtime.playback.input_tracks import Track
from gsgen.runtime.playback.playback import Playback
from gsgen.runtime.playback.player import FrameRequest
from gsgen.runtime.playback.post_process import PostProcessor
from gsgen.runtime.playback.timeline import AnimatedInputs, Timeline, camera_time_tracks
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.eyes import pair_of_eyes
from gsgen.runtime.scene.frame import Frame
from gsgen.runtime.sources.source import Source

FULL_TURN_DEGREES: Final = 360.0
"""Degrees of one orbit around the scene."""


@final
class FrameSequence(Playback):
    """All frames of a playback from given cameras; each is computed while another is drawn.

    Other arguments are those of :class:`Playback`.

    Args:
        sources: Sources that are drawn together; an orbit is around the first.
        view: Camera, or cameras, of the frames.
        mode: The output that is drawn.
        background: Red, green, blue and alpha, from 0 to 1.
        time: One time for all frames; None to go through the range over several frames.
        frames: Number of frames; None for one per camera, per value of the tracks, or per file of
            a sequence.
        turn: Degrees that an orbit turns over all frames; None for a full turn if nothing else
            moves.
        tracks: Values of other inputs.
        eye_distance: Metres from a left to a right eye, whose images stand side by side; None for
            one camera. A scene that does not tell the length of its unit is taken to be in metres.
        renderer: Draws the frames; a new one by default.

    Attributes:
        player: Computes and draws the frames.
        notes: Notes on the cameras, for the user.

    Raises:
        ConfigInvalid: ``time`` is set but no source has a time, colour spaces differ, or a track
            does not fit.
        UnknownName: No model has the input of a track.
    """

    def __init__(
        self,
        sources: Sequence[Source],
        view: Viewpoint,
        mode: Mode = "color",
        *,
        background: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        sh_degree: int | None = None,
        antialias: Literal["classic", "mip"] | None = None,
        time: float | None = None,
        frames: int | None = None,
        turn: float | None = None,
        fps: float | None = None,
        tracks: Sequence[Track] = (),
        post: Sequence[PostProcessor] = (),
        eye_distance: float | None = None,
        renderer: Renderer | None = None,
    ) -> None:
        if turn is not None and not np.isfinite(turn):
            raise ConfigInvalid(f"is {turn}, expected a finite number of degrees", where="--turn")
        models: list[AnimatedInputs] = [*sources, *post]
        camera_tracks, notes = camera_time_tracks(view, models, tracks, time)
        timeline = Timeline(models, [*camera_tracks, *tracks], time)
        super().__init__(
            sources,
            post,
            timeline,
            frames=frames
            or max(
                len(view.cameras),
                timeline.frames,
                view.span.frames if view.span else 1,
                *(len(source.files) for source in sources),
            ),
            fps=fps or view.fps or (view.span.fps if view.span else None),
            sh_degree=sh_degree,
            antialias=antialias,
        )
        self._view, self._output_mode, self.notes = view, mode, view.notes + notes
        metres_per_unit = metres_of_unit(sources)
        self._eye_distance = eye_distance and eye_distance / (metres_per_unit or 1.0)
        if eye_distance is not None and metres_per_unit is None:
            self.notes += (
                "no scene tells the length of its unit, which is taken to be a metre: "
                "--eye-distance changes the distance of the eyes",
            )
        is_moving = timeline.is_animated or view.keys is not None
        is_camera_turning = self.frames > 1 and view.orbit is not None and not is_moving
        self._turn_degrees = (
            turn if turn is not None else (FULL_TURN_DEGREES if is_camera_turning else 0.0)
        )
        self.player = self.make_player(renderer, background, PICTURE_MODES[mode], post)
        self._last_frame: Frame | None = None

    @property
    def motion(self) -> str:
        """What several frames of these options show: an animation, a turntable or stills."""
        if self._timeline.is_animated:
            return "goes through the range of the animation"
        is_orbiting = self._view.orbit is not None
        return "makes a turntable" if is_orbiting else "makes a turntable with `--camera orbit`"

    def frame_request(self, number: int) -> FrameRequest:
        """Return the camera and the input values of frame ``number``, from 0."""
        turn = self._turn_degrees * number / self.frames
        view = self._view.at(number, self.frames)
        camera = view.camera(self.sources[0], number, turn)
        if self._eye_distance is None:
            return self.request(camera, number)
        left, right = pair_of_eyes(camera, self._eye_distance)
        return replace(self.request(left, number), right=right)

    def frame_requests(self) -> Iterator[FrameRequest]:
        """Yield the camera and the input values of all frames, in order."""
        return map(self.frame_request, range(self.frames))

    def draw(self, number: int) -> Frame:
        """Draw the frame ``number`` of the sequence, from 0."""
        self._last_frame = self.player.render(self.frame_request(number))
        return self._last_frame

    def write(
        self,
        path: Path,
        on_frame: Callable[[int], None] = lambda _: None,
        *,
        bits: Literal[8, 16] = 8,
        sound: Sound | None = None,
    ) -> None:
        """Draw all frames into a file or a folder, which is complete or absent afterwards.

        Args:
            path: An image file, an .exr, an .npy, an .mp4, a .gif, or a folder, which gets
                ``frame_0000.png`` and so on.
            on_frame: Called before each frame with its number, from 1.
            bits: Bits of each channel of PNG files.
            sound: What is heard in an .mp4 from its first frame on.

        Raises:
            ConfigInvalid: The suffix is unknown or unfit for several frames, or the cameras of a
                video have different sizes.
        """
        suffix = path.suffix.lower()
        require_output_format(path, frames=self.frames, bits=bits)
        needs_one_size = suffix in (".npy", *pictures.VIDEO_SUFFIXES)
        if needs_one_size and len(self._view.sizes) > 1:
            raise _differing_sizes(path, self._view.sizes)
        if suffix == ".npy":
            arrays = [
                pictures.array_of(frame, self._output_mode) for frame in self._draw_frames(on_frame)
            ]
            pictures.save_array(path, np.stack(arrays) if self.frames > 1 else arrays[0])
        elif suffix in pictures.VIDEO_SUFFIXES:
            pictures.save_video(path, self._pictures(on_frame), self.fps, sound)
        elif suffix in pictures.IMAGE_SUFFIXES and self.frames == 1:
            for picture in self._pictures(on_frame, bits):
                if bits == 8:
                    pictures.save_picture(path, picture, self.frame_request(0).camera)
                else:
                    deep_pictures.save_png16(path, picture)
        elif suffix == deep_pictures.EXR_SUFFIX and self.frames == 1:
            for frame in self._draw_frames(on_frame):
                deep_pictures.save_exr(path, frame, self._output_mode)
        else:
            save = pictures.save_picture if bits == 8 else deep_pictures.save_png16
            for number, picture in enumerate(self._pictures(on_frame, bits)):
                save(path / f"frame_{number:04}.png", picture)

    def _draw_frames(self, on_frame: Callable[[int], None]) -> Iterator[Frame]:
        on_frame(1)
        if self.frames > 1 and any(source.pools for source in self.sources):
            requests = list(self.frame_requests())
            cameras = [eye for entry in requests for eye in (entry.camera, entry.right) if eye]
            for source in self.sources:
                source.expect(cameras)
        for number, frame in enumerate(self.player.play(self.frame_requests())):
            self._last_frame = frame
            yield frame
            if number + 1 < self.frames:
                on_frame(number + 2)

    def _pictures(
        self, on_frame: Callable[[int], None], bits: Literal[8, 16] = 8
    ) -> Iterator[np.ndarray]:
        """Yield frames as integer images; the depth range of the first frame scales all of them."""
        depths: tuple[float, float] | None = None
        for frame in self._draw_frames(on_frame):
            if depths is None and "depth" in self._output_mode:
                depths = pictures.depth_range(pictures.array_of(frame, self._output_mode))
            convert = pictures.picture_of if bits == 8 else deep_pictures.picture16_of
            yield convert(frame, self._output_mode, depths)

    @property
    def last_frame(self) -> Frame:
        """The frame that was drawn last."""
        assert self._last_frame is not None  # draw() or write() comes first
        return self._last_frame

    def summary(self) -> dict[str, object]:
        """Return size, device, and numbers of frames and Gaussians of a drawn sequence; its waits."""
        assert self._last_frame is not None  # write() comes first
        height, width = self._last_frame.alpha.shape
        return {
            "frames": self.frames,
            "width": width,
            "height": height,
            "gaussians": sum(source.count for source in self.sources),
            "visible": self._last_frame.visible,
            "triangles": sum(len(mesh.data) for mesh in self.player.scene.meshes),
            "pairs": self._last_frame.pairs,
            "device": self.player.renderer.device.name,
            "frames_in_flight": self.player.statistics.in_flight,
            "waited": round(self.player.statistics.waited, 3),
            "growths": self.player.statistics.growths,
            "redrawn": self.player.statistics.redrawn,
        }


def metres_of_unit(sources: Sequence[Source]) -> float | None:
    """Return the metres of a unit of length, as the first model that tells them does; or None."""
    return next(filter(None, (source.metres_per_unit for source in sources)), None)


def _differing_sizes(path: Path, sizes: set[tuple[int, int]]) -> ConfigInvalid:
    size_list = ", ".join(f"{width}×{height}" for width, height in sorted(sizes)[:4])
    return ConfigInvalid(
        f"needs frames of one size, but the cameras have {size_list}",
        where=str(path),
        hint="Give --width and --height, or a folder.",
    )
