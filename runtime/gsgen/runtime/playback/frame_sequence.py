"""Films: one frame after the other, from sources that may move, to files."""

__all__ = ["FrameSequence"]

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final, Literal, final

import numpy as np

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.media import pictures
from gsgen.runtime.media.pictures import MODES, Mode
from gsgen.runtime.playback.camera_options import Viewpoint
from gsgen.runtime.playback.input_tracks import Track
from gsgen.runtime.playback.player import FrameRequest, Player
from gsgen.runtime.playback.post_process import PostProcessor
from gsgen.runtime.playback.timeline import AnimatedInputs, Timeline
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.frame import Frame
from gsgen.runtime.sources.source import Source

_FPS: Final = 25.0
_CIRCLE: Final = 360.0


@final
class FrameSequence:
    """Frames of sources that are drawn together; each is computed while another is drawn.

    Args:
        sources: What is drawn; the first says where an orbit's middle and its upward direction are.
        view: From where.
        mode: What is shown.
        background: Red, green, blue, alpha.
        sh_degree: Use no harmonics above this; None for all.
        antialias: How the scene was trained; None for what each source says.
        time: Of all frames; None to go through the range where there are several.
        frames: How many; None for one a camera, or one a value of the tracks.
        turn: Degrees that an orbit turns over all frames; None for a circle if nothing else moves.
        tracks: What other inputs are fed.
        post: Models that the colours go through, in this order.
        renderer: What draws; a new one where absent.

    Attributes:
        frames: How many there are.
        sources: What is drawn.
        player: What plays them.

    Raises:
        ConfigInvalid: A time is asked of sources that have none, colour spaces differ, or a track
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
        tracks: Sequence[Track] = (),
        post: Sequence[PostProcessor] = (),
        renderer: Renderer | None = None,
    ) -> None:
        if turn is not None and not np.isfinite(turn):
            raise ConfigInvalid(f"is {turn}, wanted degrees", where="--turn")
        self.sources, self._view, self._mode = list(sources), view, mode
        takers: list[AnimatedInputs] = [*sources, *post]
        self._score = Timeline(takers, tracks, time)
        self.frames = frames or max(len(view.cameras), self._score.frames)
        moving = self._score.moving
        turning = self.frames > 1 and view.orbit is not None and not moving
        self._turn = turn if turn is not None else (_CIRCLE if turning else 0.0)
        probed_frames = sorted({0, self.frames // 2, self.frames - 1}, reverse=True)
        for index, source in enumerate(sources):  # an orbit goes around what the film shows
            source.survey(
                (frame, self._score.values(frame, self.frames)[index])
                for frame in probed_frames
            )
        self.player = Player(
            sources,
            post=post,
            renderer=renderer,
            background=background,
            outputs=(MODES[mode],),
            sh_degree=sh_degree,
            antialias=antialias,
        )
        self._last: Frame | None = None

    def draw(self, number: int) -> Frame:
        """Draw frame ``number``, from 0."""
        self._last = self.player.render(self.shot(number))
        return self._last

    def shot(self, number: int) -> FrameRequest:
        """Return what frame ``number`` shows."""
        turn = self._turn * number / self.frames
        camera = self._view.camera(self.sources[0], number, turn)
        return FrameRequest(camera, self._score.values(number, self.frames), number)

    def write(
        self, path: Path, fps: float | None, watch: Callable[[int], None] = lambda _: None
    ) -> None:
        """Draw all frames into ``path``, which is whole or absent in the end.

        Args:
            path: A picture, an .npy, an .mp4, a .gif, or a folder, which gets ``frame_0000.png`` and so on.
            fps: Frames per second of a film; None for what the manifest says, or 25.
            watch: Called before each frame with its number, from 1.

        Raises:
            ConfigInvalid: The suffix means nothing, or is of one picture where there are several, or
                of a film where the cameras' sizes differ.
        """
        suffix = path.suffix.lower()
        if suffix in (".npy", *pictures.FILMS) and len(self._view.sizes) > 1:
            raise _uneven(path, self._view.sizes)
        if suffix == ".npy":
            arrays = [pictures.array_of(frame, self._mode) for frame in self._drawn(watch)]
            pictures.save_array(path, np.stack(arrays) if self.frames > 1 else arrays[0])
        elif suffix in pictures.FILMS:
            pictures.save_film(path, self._pictures(watch), fps or self._fps())
        elif suffix in pictures.SUFFIXES and self.frames == 1:
            for picture in self._pictures(watch):
                pictures.save_picture(path, picture, self.shot(0).camera)
        elif not suffix or path.is_dir():
            for number, picture in enumerate(self._pictures(watch)):
                pictures.save_picture(path / f"frame_{number:04}.png", picture)
        else:
            raise _unfitting(path, self.frames)

    def _drawn(self, watch: Callable[[int], None]) -> Iterator[Frame]:
        watch(1)
        for number, frame in enumerate(
            self.player.play(map(self.shot, range(self.frames)))
        ):
            self._last = frame
            yield frame
            if number + 1 < self.frames:
                watch(number + 2)

    def _pictures(self, watch: Callable[[int], None]) -> Iterator[np.ndarray]:
        """Yield each frame as bytes; the first one's depths are the grey scale of all."""
        depths: tuple[float, float] | None = None
        for frame in self._drawn(watch):
            if depths is None and "depth" in self._mode:
                depths = pictures.depth_range(pictures.array_of(frame, self._mode))
            yield pictures.picture_of(frame, self._mode, depths)

    def _fps(self) -> float:
        times = (source.time for source in self.sources)
        return next((spec.fps for spec in times if spec is not None and spec.fps), _FPS)

    def summary(self) -> dict[str, int | str]:
        """Return what was drawn, of the last frame where there are several."""
        assert self._last is not None  # write() comes first
        height, width = self._last.alpha.shape
        return {
            "frames": self.frames,
            "width": width,
            "height": height,
            "gaussians": sum(source.data.count for source in self.sources),
            "visible": self._last.visible,
            "triangles": sum(len(mesh.data) for mesh in self.player.scene.meshes),
            "pairs": self._last.pairs,
            "device": self.player.renderer.device.name,
        }


def _uneven(path: Path, sizes: set[tuple[int, int]]) -> ConfigInvalid:
    listed = ", ".join(f"{width}×{height}" for width, height in sorted(sizes)[:4])
    return ConfigInvalid(
        f"has frames of one size, but the cameras have {listed}",
        where=str(path),
        hint="Give --width and --height, or a folder.",
    )


def _unfitting(path: Path, frames: int) -> ConfigInvalid:
    known = ", ".join((*pictures.SUFFIXES, *pictures.FILMS, ".npy"))
    if path.suffix.lower() in pictures.SUFFIXES:
        return ConfigInvalid(
            f"is one picture, but there are {frames} frames",
            where=str(path),
            hint="Give a folder, an .mp4, a .gif or an .npy.",
        )
    return ConfigInvalid(
        f"has a suffix that means nothing here: {path.suffix}",
        where=str(path),
        hint=f"Known: {known}, or a folder.",
    )
