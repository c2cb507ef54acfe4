"""Films: one frame after the other, from sources that may move, to files."""

__all__ = ["Film"]

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final, Literal, final

import numpy as np

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.manifest import Input
from gsgen.runtime import pictures
from gsgen.runtime.camera import Camera
from gsgen.runtime.frame import Frame
from gsgen.runtime.pictures import MODES, Mode
from gsgen.runtime.renderer import Renderer
from gsgen.runtime.scene import Scene, SplatSet
from gsgen.runtime.sources import Source
from gsgen.runtime.viewpoint import Viewpoint

_FPS: Final = 25.0
_CIRCLE: Final = 360.0


@final
class Film:
    """Frames of sources that are drawn together.

    Args:
        sources: What is drawn; the first says where an orbit's middle and its upward direction are.
        view: From where.
        mode: What is shown.
        background: Red, green, blue, alpha.
        sh_degree: Use no harmonics above this; None for all.
        antialias: How the scene was trained; None for what each source says.
        time: Of all frames; None to go through the range where there are several.
        frames: How many; None for one a camera.
        turn: Degrees that an orbit turns over all frames; None for a circle if nothing else moves.
        renderer: What draws; a new one where absent.

    Raises:
        ConfigInvalid: A time is asked of sources that have none, or colour spaces differ.
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
        renderer: Renderer | None = None,
    ) -> None:
        self._sources, self._view, self._mode = list(sources), view, mode
        self._background, self._time = background, time
        self.frames = frames or max(1, len(view.cameras))
        timed = [source for source in sources if source.time is not None]
        if time is not None and not timed:
            raise ConfigInvalid("no scene has a time", where="--time")
        turning = self.frames > 1 and view.orbit is not None and not timed
        self._turn = turn if turn is not None else (_CIRCLE if turning else 0.0)
        spaces = {source.color_space for source in sources}
        if len(spaces) > 1:
            raise ConfigInvalid(
                "one scene has linear colours, another sRGB: they cannot be blended",
                where="scenes",
            )
        self._scene = Scene(
            [
                SplatSet(
                    source.data, degree=sh_degree, antialias=antialias or source.antialias
                )
                for source in sources
            ],
            color_space=spaces.pop() if spaces else "srgb",
        )
        self._renderer = renderer or Renderer()
        self._last: Frame | None = None

    def draw(self, number: int) -> Frame:
        """Draw frame ``number``, from 0."""
        camera = self._camera(number)
        for source in self._sources:
            source.update(camera, self._moment(source.time, number))
        self._last = self._renderer.render(
            self._scene, camera, background=self._background, outputs=(MODES[self._mode],)
        )
        return self._last

    def _camera(self, number: int) -> Camera:
        turn = self._turn * number / self.frames
        return self._view.camera(self._sources[0], number, turn)

    def _moment(self, declared: Input | None, number: int) -> float | None:
        """Return the time of a frame: a loop's last frame comes just before its first."""
        if declared is None or self._time is not None:
            return self._time
        if self.frames == 1 or declared.range is None:
            return None
        low, high = declared.range
        steps = self.frames if declared.loop else self.frames - 1
        return low + (high - low) * number / steps

    def write(
        self, path: Path, fps: float | None, watch: Callable[[int], None] = lambda _: None
    ) -> None:
        """Draw all frames into ``path``, which is whole or absent in the end.

        Args:
            path: A picture, an .npy, an .mp4, a .gif, or a folder, which gets ``frame_0000.png`` and so on.
            fps: Frames per second of a film; None for what the manifest says, or 25.
            watch: Called before each frame with its number, from 1.

        Raises:
            ConfigInvalid: The suffix means nothing, or is of one picture where there are several.
        """
        suffix = path.suffix.lower()
        if suffix == ".npy":
            arrays = [pictures.array_of(one, self._mode) for one in self._drawn(watch)]
            pictures.save_array(path, np.stack(arrays) if self.frames > 1 else arrays[0])
        elif suffix in pictures.FILMS:
            pictures.save_film(path, self._pictures(watch), fps or self._fps())
        elif suffix in pictures.SUFFIXES and self.frames == 1:
            for picture in self._pictures(watch):
                pictures.save_picture(path, picture)
        elif not suffix or path.is_dir():
            for number, picture in enumerate(self._pictures(watch)):
                pictures.save_picture(path / f"frame_{number:04}.png", picture)
        else:
            raise _unfitting(path, self.frames)

    def _drawn(self, watch: Callable[[int], None]) -> Iterator[Frame]:
        for number in range(self.frames):
            watch(number + 1)
            yield self.draw(number)

    def _pictures(self, watch: Callable[[int], None]) -> Iterator[np.ndarray]:
        """Yield each frame as bytes; the first one's depths are the grey scale of all."""
        depths: tuple[float, float] | None = None
        for frame in self._drawn(watch):
            if depths is None and "depth" in self._mode:
                depths = pictures.depth_range(pictures.array_of(frame, self._mode))
            yield pictures.picture_of(frame, self._mode, depths)

    def _fps(self) -> float:
        times = (source.time for source in self._sources)
        return next((one.fps for one in times if one is not None and one.fps), _FPS)

    def summary(self) -> dict[str, int | str]:
        """Return what was drawn, of the last frame where there are several."""
        assert self._last is not None  # write() comes first
        height, width = self._last.alpha.shape
        return {
            "frames": self.frames,
            "width": width,
            "height": height,
            "gaussians": sum(source.data.count for source in self._sources),
            "visible": self._last.visible,
            "pairs": self._last.pairs,
            "device": self._renderer.device.name,
        }


def _unfitting(path: Path, frames: int) -> ConfigInvalid:
    known = ", ".join((*pictures.SUFFIXES, *pictures.FILMS, ".npy"))
    if path.suffix.lower() in pictures.SUFFIXES:
        return ConfigInvalid(
            f"is one picture, but there are {frames} frames",
            where=str(path),
            mend="Give a folder, an .mp4, a .gif or an .npy.",
        )
    return ConfigInvalid(
        f"has a suffix that means nothing here: {path.suffix}",
        where=str(path),
        mend=f"Known: {known}, or a folder.",
    )
