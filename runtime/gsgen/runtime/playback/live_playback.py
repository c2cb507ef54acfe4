"""Plays splat files and ONNX generators in real time while a window shows them."""

__all__ = ["LivePlayback"]

from collections.abc import Sequence
from typing import Final, Literal, final

import numpy as np

from gsgen.contract.errors import GsgenError
from gsgen.runtime.playback.input_tracks import Track
from gsgen.runtime.playback.playback import Playback
from gsgen.runtime.playback.player import Player
from gsgen.runtime.playback.post_process import PostProcessor
from gsgen.runtime.playback.timeline import Timeline
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Frame, Output
from gsgen.runtime.sources.source import Source

_DEFAULT_STEP_COUNT: Final = 100  # steps of a time range without a frame count of its own


@final
class LivePlayback(Playback):
    """A playback that repeats in real time; frames are those of ``gsgen render --frames``.

    A frame is begun, and taken when it is computed. No call waits for it: until then, the previous
    frame is drawn. Other arguments are those of :class:`Playback`.

    Args:
        tracks: Values of inputs.
        time: One time for all frames; None to go through the range.
        frames: Number of frames; None for one per value of the tracks, or a default for a range.

    Attributes:
        playing: Whether time advances.
        version: A counter that grows when the Gaussians change.
    """

    def __init__(
        self,
        sources: Sequence[Source],
        *,
        post: Sequence[PostProcessor] = (),
        tracks: Sequence[Track] = (),
        time: float | None = None,
        frames: int | None = None,
        fps: float | None = None,
        sh_degree: int | None = None,
        antialias: Literal["classic", "mip"] | None = None,
    ) -> None:
        timeline = Timeline([*sources, *post], tracks, time)
        span = timeline.span
        default_frames = timeline.frames if timeline.frames > 1 else _range_length(sources)
        if span is not None:
            default_frames = span.frames
        super().__init__(
            sources,
            post,
            timeline,
            frames=(frames or default_frames) if timeline.is_animated else 1,
            fps=fps or (span.fps if span else None),
            sh_degree=sh_degree,
            antialias=antialias,
        )
        self.playing, self.version = False, 0
        self._frame_position = 0.0
        self._drawn_moment: object = None  # the moment that the sources are at
        self._pending_moment: object = None  # the moment that the sources compute
        self.scene()  # sources that cannot be drawn together raise here

    @property
    def number(self) -> int:
        """The number of the current frame, from 0."""
        return int(self._frame_position)

    def seek(self, number: int) -> None:
        """Go to a frame number, modulo the number of frames."""
        self._frame_position = float(number % self.frames)

    def advance(self, seconds: float) -> None:
        """Advance the playback by some seconds, unless it is paused."""
        if self.playing:
            self._frame_position = (self._frame_position + seconds * self.fps) % self.frames

    def moment(self) -> float | None:
        """Return the current time of the first source of Gaussians that has a time input."""
        for source, values in zip(self.sources, self.values(self.number), strict=False):
            if source.time is not None and source.time.name in values:
                return float(np.asarray(values[source.time.name]).reshape(-1)[0])
        return None

    @property
    def busy(self) -> bool:
        """Whether a frame of the playback is in progress, or its Gaussians may still change."""
        return self._pending_moment is not None or self._is_streaming()

    def _is_streaming(self) -> bool:
        return any(source.is_streaming for source in self.sources)

    def begin(self, camera: Camera) -> None:
        """Begin to compute the current frame for a camera, unless it is computed or in progress."""
        moment = self._playback_moment_key(camera)
        if self._pending_moment is None and (moment != self._drawn_moment or self._is_streaming()):
            values = self.values(self.number)
            for source, source_values in zip(self.sources, values, strict=False):
                source.start(camera, source_values, self.number)
            self._pending_moment = moment

    def take(self, *, wait: bool = False) -> None:
        """Switch to the frame of :meth:`begin` if it is computed; ``wait`` waits until it is."""
        is_ready = wait or all(source.ready for source in self.sources)
        if self._pending_moment is None or not is_ready:
            return
        self._drawn_moment, self._pending_moment = self._pending_moment, None
        before = self._data_versions()
        try:
            for source in self.sources:
                source.finish()
        except GsgenError:
            self.playing = False
            self.abandon()
            raise
        finally:
            self.version += before != self._data_versions()

    def settle(self, camera: Camera) -> None:
        """Compute the current frame for a camera, and wait for it."""
        self.take(wait=True)
        self.begin(camera)
        self.take(wait=True)

    def player(self, renderer: Renderer, background: Sequence[float], output: Output) -> Player:
        """Return a player of Gaussian sources; post-process models run for the colour output."""
        post = self.post if output == "color" else ()
        return self.make_player(renderer, background, output, post)

    def frame(self, player: Player, camera: Camera) -> Frame:
        """Compute and draw the current frame, through the post-process models."""
        self.abandon()
        moment, before = self._playback_moment_key(camera), self._data_versions()
        frame = player.render(self.request(camera, self.number))
        self._drawn_moment = moment
        self.version += before != self._data_versions()
        return frame

    def depths(self, camera: Camera) -> tuple[float, float]:
        """Return the nearest and the farthest depth of all Gaussians and meshes for a camera."""
        extents = [source.extent() for source in self.sources]
        source_depths = [
            float(np.linalg.norm(center - camera.eye))
            if camera.has_ray_depth
            else float(camera.view[2, :3] @ center + camera.view[2, 3])
            for center, _ in extents
        ]
        reach = [radius for _, radius in extents]
        near = min(depth - size for depth, size in zip(source_depths, reach, strict=True))
        far_depth = max(depth + size for depth, size in zip(source_depths, reach, strict=True))
        return max(near, camera.near), max(far_depth, 2 * camera.near)

    def abandon(self) -> None:
        """Wait for the frame that :meth:`begin` requested, and discard its result or error."""
        self._pending_moment = None
        for source in self.sources:
            source.abandon()

    def close(self) -> None:
        """Release the splat files and models; a model run that never ends is interrupted."""
        for source in self.sources:
            source.interrupt()
        self.abandon()
        for source in self.sources:
            source.close()
        for model in self.post:
            model.close()

    def _playback_moment_key(self, camera: Camera) -> object:
        """Return a key that changes when the models must compute a new frame."""
        number = self.number if any(source.inputs for source in self.sources) else 0
        if not any(source.follows_camera for source in self.sources):
            return number
        return number, camera.view.tobytes(), camera.intrinsics

    def _data_versions(self) -> list[tuple[int, ...]]:
        return [source.state for source in self.sources]


def _range_length(sources: Sequence[Source]) -> int:
    """Return the longest range of a frame number input, or a default if no input has a range."""
    ranges = [
        spec.range
        for source in sources
        for spec in source.inputs
        if spec.role == "frame_index" and spec.range is not None and source.time is None
    ]
    return max([int(high - low) + 1 for low, high in ranges], default=_DEFAULT_STEP_COUNT)
