"""The base of playbacks: sources of Gaussians, post-process models, and input values by frame."""

__all__ = ["Playback", "frame_rate"]

from collections.abc import Sequence
from typing import Literal

from gsgen.runtime.playback.input_tracks import require_pictures
from gsgen.runtime.playback.player import FrameRequest, Player, compose_scene
from gsgen.runtime.playback.post_process import PostProcessor
from gsgen.runtime.playback.timeline import Timeline
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Output
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.sources.key_frames import DEFAULT_FPS
from gsgen.runtime.sources.source import Source, Values


def frame_rate(sources: Sequence[Source]) -> float:
    """Return the frames per second of the first source of Gaussians that has a rate, or 25."""
    rates = (source.time.fps for source in sources if source.time is not None)
    return next((rate for rate in rates if rate), DEFAULT_FPS)


class Playback:
    """Sources, post-process models, input values and a frame rate, to draw frames by number.

    :class:`FrameSequence` draws every frame into files; :class:`LivePlayback` follows a clock. Both
    therefore show the same picture for the same frame number.

    Args:
        sources: Sources that are drawn together.
        post: Post-process models that the colours go through, in this order.
        timeline: Input values of the sources and models.
        frames: Number of frames.
        fps: Frames per second; None for the first source's rate, or 25.
        sh_degree: Highest degree of spherical harmonics; None for all. :meth:`scene` reads it.
        antialias: Antialiasing of the training; None for each source's own setting. :meth:`scene`
            reads it.

    Raises:
        ConfigInvalid: A source is computed from pictures that are not given.
    """

    def __init__(
        self,
        sources: Sequence[Source],
        post: Sequence[PostProcessor],
        timeline: Timeline,
        *,
        frames: int,
        fps: float | None = None,
        sh_degree: int | None = None,
        antialias: Literal["classic", "mip"] | None = None,
    ) -> None:
        require_pictures(sources, timeline.tracks)
        self.sources, self.post = list(sources), list(post)
        self._timeline, self.frames = timeline, frames
        self.fps = fps or frame_rate(self.sources)
        self.sh_degree: int | None = sh_degree
        self.antialias: Literal["classic", "mip"] | None = antialias
        # An orbit goes around the extent of all frames. The first frame is surveyed last, so
        # that the sources stay at it.
        survey_frames = sorted({0, frames // 2, frames - 1}, reverse=True)
        for index, source in enumerate(self.sources):
            source.survey((number, self.values(number)[index]) for number in survey_frames)

    def values(self, number: int) -> list[Values]:
        """Return the input values of each source of Gaussians and post-process model in a frame."""
        return self._timeline.values(number, self.frames)

    def request(self, camera: Camera, number: int) -> FrameRequest:
        """Return the request to draw frame ``number`` with a camera."""
        return FrameRequest(camera, self.values(number), number)

    def scene(self) -> Scene:
        """Return files and models as one scene, with the playback's SH degree and antialiasing."""
        return compose_scene(self.sources, self.sh_degree, self.antialias)

    def make_player(
        self,
        renderer: Renderer | None,
        background: Sequence[float],
        output: Output,
        post: Sequence[PostProcessor],
    ) -> Player:
        """Return a player of sources of Gaussians, whose colours post-process models change."""
        return Player(
            self.sources,
            post=post,
            renderer=renderer,
            background=background,
            outputs=(output,),
            sh_degree=self.sh_degree,
            antialias=self.antialias,
        )
