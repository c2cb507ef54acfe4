"""A stage: sources that move while somebody looks at them."""

__all__ = ["LivePlayback"]

from collections.abc import Sequence
from typing import Final, Literal, final

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import GsgenError
from gsgen.runtime.playback.input_tracks import Track
from gsgen.runtime.playback.player import FrameRequest, Player, composed
from gsgen.runtime.playback.post_process import PostProcessor
from gsgen.runtime.playback.timeline import AnimatedInputs, Timeline
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Frame, Output
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.sources.source import Source

_FPS: Final = 25.0
_FRAMES: Final = 100  # that a time which has no frames of its own is cut into


@final
class LivePlayback:
    """What is shown: sources, the frame of the film that they are at, and how they are drawn.

    Frames are those of ``gsgen render --frames``. A frame is begun, and taken when it is done:
    nobody waits, and what is drawn in between is the frame before.

    Args:
        sources: What is drawn together.
        post: Models that the colours go through, in this order.
        tracks: What inputs are fed.
        time: Of all frames; None to go through the range.
        frames: How many; None for one a value of the tracks, or what suits a range.
        fps: Frames a second; None for what the manifest says, or 25.
        sh_degree: Use no harmonics above this; None for all.
        antialias: How the scene was trained; None for what each source says.

    Attributes:
        sources: What is drawn together.
        post: Models that the colours go through.
        frames: How many there are; 1 where nothing moves.
        fps: How many pass in a second.
        playing: Whether time goes on.
        sh_degree: Harmonics above it are left out; :meth:`scene` takes it up.
        antialias: How the scene is said to have been trained; :meth:`scene` takes it up.
        version: Grows when the Gaussians have changed.

    Raises:
        ConfigInvalid: As :class:`gsgen.runtime.playback.frame_sequence.FrameSequence`.
        UnknownName: No model has the input of a track.
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
        self.sources, self.post = list(sources), list(post)
        takers: list[AnimatedInputs] = [*self.sources, *self.post]
        self._score = Timeline(takers, tracks, time)
        self.frames = 1
        if self._score.moving:
            self.frames = frames or (
                self._score.frames if self._score.frames > 1 else _counted(self.sources)
            )
        rates = (source.time.fps for source in self.sources if source.time is not None)
        self.fps = fps or next((rate for rate in rates if rate), _FPS)
        self.sh_degree: int | None = sh_degree
        self.antialias: Literal["classic", "mip"] | None = antialias
        self.playing, self.version = False, 0
        self._position = 0.0
        self._shown: object = None
        self._begun: object = None
        probed_frames = sorted({0, self.frames // 2, self.frames - 1}, reverse=True)
        for index, source in enumerate(self.sources):  # an orbit goes around all of it
            source.survey((number, self._values(number)[index]) for number in probed_frames)
        self.scene()  # what cannot be drawn together says so now

    @property
    def number(self) -> int:
        """The frame that it is at, from 0."""
        return int(self._position)

    def seek(self, number: int) -> None:
        """Go to a frame; before the first is the last."""
        self._position = float(number % self.frames)

    def advance(self, seconds: float) -> None:
        """Let time pass, if it plays."""
        if self.playing:
            self._position = (self._position + seconds * self.fps) % self.frames

    def moment(self) -> float | None:
        """Return the time that the first source that has one is at."""
        for source, values in zip(self.sources, self._values(self.number), strict=False):
            if source.time is not None and source.time.name in values:
                return float(np.asarray(values[source.time.name]).reshape(-1)[0])
        return None

    @property
    def busy(self) -> bool:
        """Whether a frame was begun and not taken."""
        return self._begun is not None

    def begin(self, camera: Camera) -> None:
        """Begin to compute what a camera sees now, unless that is here or under way."""
        request = self._wanted(camera)
        if self._begun is None and request != self._shown:
            for source, values in zip(
                self.sources, self._values(self.number), strict=False
            ):
                source.start(camera, values, self.number)
            self._begun = request

    def take(self, wait: bool = False) -> None:
        """Take what is done.

        Args:
            wait: Whether to wait for it.

        Raises:
            GsgenError: A value does not fit, or a model fails. It is not tried again.
        """
        if self._begun is None or not (
            wait or all(source.ready for source in self.sources)
        ):
            return
        self._shown, self._begun = self._begun, None
        before = self._state()
        try:
            for source in self.sources:
                source.finish()
        except GsgenError:
            self.playing = False
            self.abandon()
            raise
        finally:
            self.version += before != self._state()

    def settle(self, camera: Camera) -> None:
        """Compute what a camera sees now, and wait for it.

        Raises:
            GsgenError: As :meth:`take`.
        """
        self.take(wait=True)
        self.begin(camera)
        self.take(wait=True)

    def scene(self) -> Scene:
        """Return what is drawn."""
        return composed(self.sources, self.sh_degree, self.antialias)

    def player(
        self, renderer: Renderer, background: Sequence[float], output: Output
    ) -> Player:
        """Return what draws the sources as they are drawn now."""
        return Player(
            self.sources,
            post=self.post if output == "color" else (),
            renderer=renderer,
            background=background,
            outputs=(output,),
            sh_degree=self.sh_degree,
            antialias=self.antialias,
        )

    def frame(self, player: Player, camera: Camera) -> Frame:
        """Compute and draw a whole frame, which goes through the post-process models.

        Raises:
            GsgenError: A value does not fit, or a model fails.
        """
        self.abandon()
        request, before = self._wanted(camera), self._state()
        frame = player.render(FrameRequest(camera, self._values(self.number), self.number))
        self._shown = request
        self.version += before != self._state()
        return frame

    def depths(self, camera: Camera) -> tuple[float, float]:
        """Return between which depths most of it lies."""
        extents = [source.extent() for source in self.sources]
        ahead = [
            float(np.linalg.norm(center - camera.eye))
            if camera.kind == "panorama"
            else float(camera.view[2, :3] @ center + camera.view[2, 3])
            for center, _ in extents
        ]
        reach = [radius for _, radius in extents]
        near = min(depth - size for depth, size in zip(ahead, reach, strict=True))
        far = max(depth + size for depth, size in zip(ahead, reach, strict=True))
        return max(near, camera.near), max(far, 2 * camera.near)

    @property
    def middle(self) -> tuple[Float[np.ndarray, "3"], float]:
        """The middle of the first source and the reach of it, as orbits have it."""
        return self.sources[0].extent()

    def abandon(self) -> None:
        """Wait for what was begun; what is wrong with it concerns nobody."""
        self._begun = None
        for source in self.sources:
            source.abandon()

    def close(self) -> None:
        """Release what computes, in the middle of a frame if need be: it may never end."""
        for source in self.sources:
            source.interrupt()
        self.abandon()
        for source in self.sources:
            source.close()
        for model in self.post:
            model.close()

    def _values(self, number: int) -> list[dict[str, object]]:
        return [dict(values) for values in self._score.values(number, self.frames)]

    def _wanted(self, camera: Camera) -> object:
        """Return what tells one moment from another."""
        if not any(source.inputs for source in self.sources):
            return 0
        lens = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
        return self.number, camera.view.tobytes(), lens

    def _state(self) -> list[tuple[int, ...]]:
        return [
            (
                id(source.data),
                source.data.rows_version,
                source.data.appearance_version,
                source.data.cells_version,
                source.data.count,
            )
            for source in self.sources
        ]


def _counted(sources: Sequence[Source]) -> int:
    """Return how many frames those who count them have."""
    ends = [
        spec.range
        for source in sources
        for spec in source.inputs
        if spec.role == "frame_index" and spec.range is not None and source.time is None
    ]
    return max([int(high - low) + 1 for low, high in ends], default=_FRAMES)
