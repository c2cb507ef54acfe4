"""Players: generators and the renderer joined, so that one computes while the other draws."""

__all__ = ["FrameRequest", "GeneratorPlayer", "Player", "composed"]

import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from types import TracebackType
from typing import Literal, Self, final

import numpy as np

from gsgen.contract.errors import ConfigInvalid, GsgenError
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.runtime.errors import placed
from gsgen.runtime.playback.post_process import PostProcessor
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Frame, Output
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.sources.source import GeneratorSource, Source, Values

_COLOR: tuple[Output, ...] = ("color",)
_NOTHING = (0.0, 0.0, 0.0, 0.0)


@final
@dataclass(frozen=True, slots=True, eq=False)
class FrameRequest:
    """What a frame shows.

    Attributes:
        camera: From where, and how large.
        values: For each source, in their order, tensor name or role → value; and after them for
            each post-process model. What is not named keeps its value.
        number: What an error calls the frame; None for how many were begun before it.
    """

    camera: Camera
    values: Sequence[Values] = ()
    number: int | None = None


@final
class Player:
    """Draws sources as one scene, frame after frame.

    While a frame is drawn, the next one is computed. What the sources leave as it was is not
    uploaded again, and no buffer is made once the first frame is drawn.

    Args:
        sources: What is drawn. They stay open when the player closes.
        post: What the colours go through, in this order. They stay open, too.
        renderer: What draws; a new one where absent.
        background: Red, green, blue and alpha behind it all.
        outputs: What is made of each frame.
        sh_degree: Use no harmonics above this; None for all.
        antialias: How the scene was trained; None for what each source says.

    Attributes:
        scene: What is drawn.
        renderer: What draws.

    Raises:
        ConfigInvalid: Colour spaces differ, or models work on colours that are not made.
    """

    def __init__(
        self,
        sources: Sequence[Source],
        *,
        post: Sequence[PostProcessor] = (),
        renderer: Renderer | None = None,
        background: Sequence[float] = _NOTHING,
        outputs: Collection[Output] = _COLOR,
        sh_degree: int | None = None,
        antialias: Literal["classic", "mip"] | None = None,
    ) -> None:
        if post and "color" not in outputs:
            output_names = ", ".join(sorted(outputs))
            message = f"works on colours, but {output_names} is what is made"
            raise ConfigInvalid(message, where=post[0].name)
        self._sources, self._post = list(sources), list(post)
        self.scene = composed(sources, sh_degree, antialias)
        self.renderer = renderer or Renderer()
        self._background, self._outputs = background, outputs
        self._begun = 0

    def render(self, shot: FrameRequest) -> Frame:
        """Compute and draw one frame.

        Raises:
            GsgenError: A value does not fit or a model fails; it names model, input and frame.
        """
        number = self._start(shot)
        self._finish()
        return self._draw(shot, number)

    def play(self, shots: Iterable[FrameRequest]) -> Iterator[Frame]:
        """Yield a frame for each shot.

        A shot is taken from ``shots``, and its inference begun, before the frame of the one before
        is drawn: frames are the same as :meth:`render` makes them, and come sooner.

        Raises:
            GsgenError: As :meth:`render`, when it is that frame's turn.
        """
        before: tuple[FrameRequest, int] | None = None
        try:
            for shot in shots:
                self._finish()
                number = self._start(shot)
                if before is not None:
                    yield self._draw(*before)
                before = shot, number
            self._finish()
            if before is not None:
                yield self._draw(*before)
        except KeyboardInterrupt:
            for source in self._sources:
                source.interrupt()
            raise
        finally:
            for source in self._sources:  # where nobody wants the rest
                source.abandon()

    def _start(self, shot: FrameRequest) -> int:
        """Begin to compute a frame, and return its number."""
        number = self._begun if shot.number is None else shot.number
        self._begun += 1
        for source, values in zip(self._sources, _each(shot.values), strict=False):
            source.start(shot.camera, values, number)
        return number

    def _finish(self) -> None:
        for source in self._sources:
            source.finish()

    def _draw(self, shot: FrameRequest, number: int) -> Frame:
        frame = self.renderer.render(
            self.scene, shot.camera, background=self._background, outputs=self._outputs
        )
        post_values = _each(shot.values[len(self._sources) :])
        for model, values in zip(self._post, post_values, strict=False):
            try:
                frame = model(frame, values)
            except GsgenError as error:
                raise placed(error, model.name, number) from error
        return frame


def _each(values: Sequence[Values]) -> Iterator[Values]:
    """Yield the values, and then nothing to be changed."""
    yield from values
    yield from repeat({})


def composed(
    sources: Sequence[Source],
    sh_degree: int | None = None,
    antialias: Literal["classic", "mip"] | None = None,
) -> Scene:
    """Return sources as one scene, which follows them as they change.

    Args:
        sources: What is drawn.
        sh_degree: Use no harmonics above this; None for all.
        antialias: How the scene was trained; None for what each source says.

    Raises:
        ConfigInvalid: Colour spaces differ.
    """
    return Scene(
        [source.splats(sh_degree, antialias) for source in sources],
        color_space=_common_space(sources),
        meshes=[mesh for source in sources for mesh in source.meshes],
    )


def _common_space(sources: Sequence[Source]) -> Literal["srgb", "linear"]:
    spaces = {source.color_space for source in sources if len(source.data)}
    if len(spaces) > 1:
        raise ConfigInvalid(
            "one scene has linear colours, another sRGB: they cannot be blended",
            where="scenes",
        )
    return spaces.pop() if spaces else "srgb"


@final
class GeneratorPlayer:
    """A generator that is drawn every frame.

    ::

        with GeneratorPlayer("avatar.onnx") as player:
            frame = player.render(camera, time=0.3)
            for frame in player.play(camera, poses=walk):
                screen.show(frame.srgb8)

    Inputs keep their value from frame to frame; at first they have the manifest's defaults.

    Args:
        model: The ONNX file. Validate it before, if it is not your own.
        post: Post-process models that the colours go through, in this order.
        provider: What ONNX Runtime runs models on: cpu, webgpu, cuda, or auto for the fastest.
        sizes: Symbol → size of a dimension that the model leaves open.
        renderer: What draws; a new one where absent.
        background: Red, green, blue and alpha behind it all.
        outputs: What is made of each frame.

    Attributes:
        source: The generator: its inputs, and the Gaussians as they are now.
        manifest: What the generator declares.

    Raises:
        ModelUnreadable: A file is no ONNX model.
        SceneInvalid: It is not of the kind that it is used as.
        DeviceUnavailable: There is nothing to draw with.
        GsgenError: Whatever ``FrameSession`` raises.
    """

    def __init__(
        self,
        model: str | os.PathLike[str],
        *,
        post: Sequence[str | os.PathLike[str]] = (),
        provider: str = "auto",
        sizes: Mapping[str, int] | None = None,
        renderer: Renderer | None = None,
        background: Sequence[float] = _NOTHING,
        outputs: Collection[Output] = _COLOR,
    ) -> None:
        self.source = GeneratorSource(Path(model), provider, sizes)
        self._post: list[PostProcessor] = []
        try:
            self._post.extend(PostProcessor(Path(path), provider) for path in post)
            self._player = Player(
                [self.source],
                post=self._post,
                renderer=renderer,
                background=background,
                outputs=outputs,
            )
        except BaseException:
            self.close()
            raise

    @property
    def manifest(self) -> GeneratorManifest:
        """What the generator declares."""
        return self.source.manifest

    def render(
        self,
        camera: Camera,
        *,
        time: float | None = None,
        pose: np.ndarray | None = None,
        values: Values | None = None,
    ) -> Frame:
        """Compute and draw one frame.

        Args:
            camera: From where, and how large.
            time: In the declared range; None leaves it as it is.
            pose: Joint rotations, [J, 3] axis-angle or [J, 4] quaternions; None leaves them.
            values: Other inputs: tensor name or role → value.

        Raises:
            UnknownName: The model has no such input.
            InputInvalid: A value does not fit; the message names the model, input and frame.
            RunFailed: ONNX Runtime failed.
        """
        return self._player.render(FrameRequest(camera, (_merged(time, pose, values),)))

    def play(
        self,
        cameras: Camera | Iterable[Camera],
        *,
        times: Iterable[float] | None = None,
        poses: Iterable[np.ndarray] | None = None,
        values: Iterable[Values] | None = None,
    ) -> Iterator[Frame]:
        """Yield one frame after the other, computing each while the one before is drawn.

        Args:
            cameras: One for each frame, or one for all.
            times: One for each frame; None leaves the time as it is.
            poses: As in :meth:`render`, one for each frame.
            values: As in :meth:`render`, for each frame.

        The shortest of what is given ends the film; one camera alone is one frame.

        Raises:
            GsgenError: As in :meth:`render`, when it is that frame's turn.
        """
        tracks = [
            iter(iterable) if iterable is not None else None
            for iterable in (times, poses, values)
        ]
        if isinstance(cameras, Camera):
            cameras = repeat(cameras) if any(tracks) else [cameras]
        columns = [repeat(None) if track is None else track for track in tracks]
        return self._player.play(
            FrameRequest(camera, (_merged(*parts),))
            for camera, *parts in zip(cameras, *columns, strict=False)
        )

    def close(self) -> None:
        """Release the sessions; doing it twice does no harm."""
        self.source.close()
        for model in self._post:
            model.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _merged(
    time: float | None, pose: np.ndarray | None, values: Values | None
) -> dict[str, object]:
    by_role = {"time": time, "pose": pose}
    values_by_role = {name: value for name, value in by_role.items() if value is not None}
    return values_by_role | dict(values or {})
