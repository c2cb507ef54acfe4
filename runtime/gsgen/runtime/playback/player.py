"""Plays sources of Gaussians: computes a frame while the renderer draws the ones before it."""

__all__ = ["FrameRequest", "GeneratorPlayer", "Player", "compose_scene"]

import math
import os
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self, TypeVar, final

import numpy as np

from gsgen.contract.errors import ConfigInvalid, GsgenError
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.runtime.errors import SceneInvalid, locate_in_frame
from gsgen.runtime.playback.frame_queue import FrameQueue, PlayStatistics
from gsgen.runtime.playback.post_process import PostProcessor
from gsgen.runtime.renderer.late_counts import MAX_FRAMES_IN_FLIGHT
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.eyes import beside, eye_frames
from gsgen.runtime.scene.frame import COLOR_OUTPUT_ONLY, Frame, Output
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.sources.source import GeneratorSource, Source, Values

if TYPE_CHECKING:
    from gsgen.sdk.binding.confined.models import ConfinedModels

AnyCamera = TypeVar("AnyCamera", Camera, Camera | None)

_TRANSPARENT_RGBA = (0.0, 0.0, 0.0, 0.0)


@final
@dataclass(frozen=True, slots=True, eq=False)
class FrameRequest:
    """The camera and the input values of one frame.

    Attributes:
        camera: Camera, and the size of the image.
        values: Tensor name or role → value, for each source in order, then for each post-process
            model. Absent inputs keep their value.
        number: Frame number in error messages; None for the count of earlier frames.
        right: Camera of a right eye, whose image stands at the right of that of ``camera``.
    """

    camera: Camera
    values: Sequence[Values] = ()
    number: int | None = None
    right: Camera | None = None


@final
class Player:
    """Draws several sources of Gaussians as one scene, frame after frame.

    While a frame is drawn, the next one is submitted, and the one after it computed. Unchanged
    arrays of a source are not uploaded again, and no buffer is created after the first frames,
    unless more splats are drawn than before. For post-process models that enlarge, frames are drawn
    smaller, and have the size of the camera again.

    Args:
        sources: Sources that are drawn together; the caller closes them.
        post: Post-process models that the colours go through, in this order; the caller closes
            them.
        renderer: Draws the frames; a new one by default.
        background: Red, green, blue and alpha behind the scene.
        outputs: Outputs of each frame.
        sh_degree: Highest degree of spherical harmonics; None for all.
        antialias: Antialiasing of the training; None for each source's own setting.
        frames_in_flight: Most frames that :meth:`play` submits before it waits for the oldest one;
            1 to wait for each, as it does if a source cannot hold earlier frames.

    Attributes:
        scene: The sources as one scene.
        renderer: Draws the frames.
        statistics: Waiting, frames in flight and growth of buffers in the last :meth:`play`.

    Raises:
        ConfigInvalid: Colour spaces differ, or post-process models lack the colour output.
    """

    def __init__(
        self,
        sources: Sequence[Source],
        *,
        post: Sequence[PostProcessor] = (),
        renderer: Renderer | None = None,
        background: Sequence[float] = _TRANSPARENT_RGBA,
        outputs: Collection[Output] = COLOR_OUTPUT_ONLY,
        sh_degree: int | None = None,
        antialias: Literal["classic", "mip"] | None = None,
        frames_in_flight: int = MAX_FRAMES_IN_FLIGHT,
    ) -> None:
        if post and "color" not in outputs:
            output_names = ", ".join(sorted(outputs))
            message = f"works on colours, but the output is {output_names}"
            hint = "Leave the post-process model out, or draw colours."
            raise ConfigInvalid(message, where=post[0].name, hint=hint)
        if frames_in_flight < 1:
            message = f"is {frames_in_flight}, expected at least 1"
            raise ConfigInvalid(message, where="frames_in_flight")
        self._sources, self._post_processors = list(sources), list(post)
        self._enlargement = math.prod(model.scale for model in post)
        if self._enlargement > 1 and set(outputs) != {"color"}:
            message = f"enlarges colours alone, but the outputs are {', '.join(sorted(outputs))}"
            raise ConfigInvalid(message, where=post[0].name, hint="Draw colours alone.")
        self.scene = compose_scene(sources, sh_degree, antialias)
        self.renderer = renderer or Renderer()
        self._background, self._outputs = background, outputs
        self._started_count, self._frames_in_flight = 0, frames_in_flight
        self.statistics = PlayStatistics()

    def render(self, request: FrameRequest) -> Frame:
        """Compute and draw the requested frame.

        Raises:
            GsgenError: A value does not fit or a model fails; the error names model, input, frame.
        """
        eyes = self._separate_eyes(request)
        if len(eyes) > 1:
            return beside(*map(self.render, eyes))
        number = self._start_frame(request)
        self._finish_sources()
        frame = self.renderer.render(
            self.scene,
            self._drawn_camera(request.camera),
            background=self._background,
            outputs=self._outputs,
            right=self._drawn_camera(request.right),
        )
        return self._post_process(frame, request, number)

    def play(self, requests: Iterable[FrameRequest]) -> Iterator[Frame]:
        """Yield the frame of each request, with others in flight: drawn, or being computed.

        Frames equal those of :meth:`render`, and come sooner. Requests are taken two frames before
        their own frame is yielded.

        Raises:
            GsgenError: See :meth:`render`; raised when the frame's turn comes.
        """
        queue = FrameQueue(self.renderer, self.scene, self._background, self._outputs)
        self.statistics = queue.statistics
        max_in_flight = self._max_frames_in_flight()
        queue.waits = max_in_flight == 1
        eye_counts = deque[int]()

        try:
            computed = self._compute_frames(requests, eye_counts)
            frames = self._draw_computed(computed, queue, max_in_flight)
            for frame in frames:
                yield beside(frame, next(frames)) if eye_counts.popleft() > 1 else frame
        except KeyboardInterrupt:
            for source in self._sources:
                source.interrupt()
            raise
        finally:
            for source in self._sources:  # the caller may stop before the last frame
                source.abandon()

    def _separate_eyes(self, request: FrameRequest) -> list[FrameRequest]:
        """Return a request for each eye if sources compute others Gaussians for each; or itself."""
        if request.right is None or not any(source.follows_camera for source in self._sources):
            return [request]
        return [replace(request, camera=eye, right=None) for eye in (request.camera, request.right)]

    def _max_frames_in_flight(self) -> int:
        """Return how many frames may be in flight, for which all sources hold their arrays."""
        if all(source.hold_frames(self._frames_in_flight - 1) for source in self._sources):
            return self._frames_in_flight
        for source in self._sources:
            source.hold_frames(0)
        return 1

    def _compute_frames(
        self, requests: Iterable[FrameRequest], eye_counts: deque[int]
    ) -> Iterator[tuple[FrameRequest, int]]:
        """Yield each request with its number once it is computed, and the next one has begun.

        Args:
            requests: The frames.
            eye_counts: Takes how many frames each of them becomes.
        """
        before: tuple[FrameRequest, int] | None = None
        for request in requests:
            self._finish_sources()
            number = self._start_frame(request)
            # Once begun, a source of several files tells of the file of this moment.
            first, *others = self._separate_eyes(request)
            eye_counts.append(1 + len(others))
            if before is not None:
                yield before
            before = first, number
            for eye in others:
                self._finish_sources()
                number = self._start_frame(eye)
                yield before
                before = eye, number
        self._finish_sources()
        if before is not None:
            yield before

    def _draw_computed(
        self, computed: Iterator[tuple[FrameRequest, int]], queue: FrameQueue, max_in_flight: int
    ) -> Iterator[Frame]:
        """Yield the frames of computed requests in order, of which ``max_in_flight`` may be in flight."""
        submitted_requests: deque[tuple[FrameRequest, int]] = deque()

        def take(left: int) -> Iterator[Frame]:
            while len(queue) > left:
                yield self._post_process(queue.take(), *submitted_requests.popleft())

        while True:
            try:
                frame = next(computed, None)
                if frame is None:
                    break
                camera = self._drawn_camera(frame[0].camera)
                right = self._drawn_camera(frame[0].right)
                if not queue.try_submit(camera, right):
                    yield from take(0)
                    queue.waits, max_in_flight = True, 1
                    queue.submit(camera, right)
            except Exception:
                yield from take(0)  # the error is of a later frame
                raise
            submitted_requests.append(frame)
            yield from take(0 if frame[0].right else max_in_flight - 1)
        yield from take(0)

    def _start_frame(self, request: FrameRequest) -> int:
        """Begin to compute a frame, and return its number."""
        number = self._started_count if request.number is None else request.number
        self._started_count += 1
        camera = self._drawn_camera(request.camera)
        for source, values in zip(self._sources, _padded_values(request.values), strict=False):
            source.start(camera, values, number)
        return number

    def _drawn_camera(self, camera: AnyCamera) -> AnyCamera:
        """Return the camera of a frame before post-process models enlarge it."""
        if camera is None or self._enlargement == 1:
            return camera
        return _reduced(camera, self._enlargement)

    def _finish_sources(self) -> None:
        for source in self._sources:
            source.finish()

    def _post_process(self, frame: Frame, request: FrameRequest, number: int) -> Frame:
        """Return a frame whose colours the post-process models have changed."""
        if request.right is not None and self._post_processors:
            alone = replace(request, right=None)
            eyes = [self._post_process(eye, alone, number) for eye in eye_frames(frame)]
            return beside(*eyes)
        post_values = _padded_values(request.values[len(self._sources) :])
        for model, values in zip(self._post_processors, post_values, strict=False):
            try:
                frame = model(frame, values)
            except GsgenError as error:
                raise locate_in_frame(error, model.name, number) from error
        if self._enlargement > 1 and frame.rgba is not None:
            camera = request.camera
            rgba = frame.rgba[: camera.height, : camera.width]
            frame = replace(frame, rgba=rgba, alpha=rgba[..., 3])
        return frame


def _reduced(camera: Camera, divisor: int) -> Camera:
    """Return the camera whose pixels are ``divisor`` times as wide and high.

    Its image covers that of the camera; the last row and column may show more.

    Raises:
        SceneInvalid: A side of a panorama, which cannot show more, is not a multiple.
    """
    width, height = -(-camera.width // divisor), -(-camera.height // divisor)
    is_multiple = (width * divisor, height * divisor) == (camera.width, camera.height)
    if camera.kind == "panorama" and not is_multiple:
        message = (
            f"is {camera.width} × {camera.height}, expected multiples of {divisor}, by which "
            "post-process models enlarge it"
        )
        raise SceneInvalid(message, where="panorama", hint="Give --width and --height.")
    return replace(
        camera,
        fx=camera.fx / divisor,
        fy=camera.fy / divisor,
        cx=camera.cx / divisor,
        cy=camera.cy / divisor,
        width=width,
        height=height,
    )


def _padded_values(values: Sequence[Values]) -> Iterator[Values]:
    """Yield the given sets of input values in order, and then empty mappings without end."""
    yield from values
    yield from repeat({})


def compose_scene(
    sources: Sequence[Source],
    sh_degree: int | None = None,
    antialias: Literal["classic", "mip"] | None = None,
) -> Scene:
    """Join sources of Gaussians into one scene, which follows the changes of the sources."""
    return Scene(
        [source.splats(sh_degree, antialias) for source in sources],
        color_space=_common_space(sources),
        meshes=[mesh for source in sources for mesh in source.meshes],
        pools=[
            replace(
                pooled_set,
                degree=pooled_set.degree if sh_degree is None else sh_degree,
                antialias=antialias or pooled_set.antialias,
            )
            for source in sources
            for pooled_set in source.pools
        ],
    )


def _common_space(sources: Sequence[Source]) -> Literal["srgb", "linear"]:
    color_spaces = {source.color_space for source in sources if len(source.data) or source.pools}
    if len(color_spaces) > 1:
        raise ConfigInvalid(
            "have linear and sRGB colours, expected one colour space, as they are blended",
            where="scenes",
            hint="Draw the scenes separately, or train them in one colour space.",
        )
    return color_spaces.pop() if color_spaces else "srgb"


@final
class GeneratorPlayer:
    """Runs one ONNX generator, and draws the Gaussians of every frame.

    ::

        with GeneratorPlayer("avatar.onnx") as player:
            frame = player.render(camera, time=0.3)
            for frame in player.play(camera, poses=walk):
                screen.show(frame.srgb8)

    Inputs keep their value from frame to frame, beginning with the manifest's defaults.

    Args:
        model: The ONNX file. Confine files from others.
        post: Post-process models that the colours go through, in this order.
        provider: ONNX Runtime's execution provider: cpu, webgpu, cuda, or auto for the fastest.
        sizes: Symbol → size of an open dimension of the model.
        confined: Run the models in a child process with limits on time, memory, files and network.
        renderer: Draws the frames; a new one by default.
        background: Red, green, blue and alpha behind the scene.
        outputs: Outputs of each frame.

    Attributes:
        source: The generator: its inputs, and its current Gaussians.
        manifest: Manifest of the generator.

    Raises:
        ModelUnreadable: A file is not an ONNX model.
        SceneInvalid: A file is not a generator, or not a post-process model.
        DeviceUnavailable: No graphics device can be opened.
        GsgenError: See ``FrameSession``.
    """

    def __init__(
        self,
        model: str | os.PathLike[str],
        *,
        post: Sequence[str | os.PathLike[str]] = (),
        provider: str = "auto",
        sizes: Mapping[str, int] | None = None,
        confined: bool = False,
        renderer: Renderer | None = None,
        background: Sequence[float] = _TRANSPARENT_RGBA,
        outputs: Collection[Output] = COLOR_OUTPUT_ONLY,
    ) -> None:
        models = [Path(model), *map(Path, post)]
        self._confined_models: ConfinedModels | None = None
        if confined:
            from gsgen.sdk.binding.confined.models import ConfinedModels as Processes

            self._confined_models = Processes(models, has_gpu=provider != "cpu")
        self._post_processors: list[PostProcessor] = []
        try:
            self.source = GeneratorSource(models[0], provider, sizes, self._confined_models)
            self._post_processors.extend(
                PostProcessor(path, provider, confined=self._confined_models) for path in models[1:]
            )
            self._player = Player(
                [self.source],
                post=self._post_processors,
                renderer=renderer,
                background=background,
                outputs=outputs,
            )
        except BaseException:
            self.close()
            raise

    @property
    def manifest(self) -> GeneratorManifest:
        """The manifest of the ONNX generator that is played."""
        return self.source.manifest

    @property
    def statistics(self) -> PlayStatistics:
        """Waiting, frames in flight and growth of buffers in the last :meth:`play`."""
        return self._player.statistics

    def render(
        self,
        camera: Camera,
        *,
        time: float | None = None,
        pose: np.ndarray | None = None,
        values: Values | None = None,
    ) -> Frame:
        """Compute and draw one frame of the ONNX generator.

        Args:
            camera: Camera, and the size of the image.
            time: In the declared range; None leaves it unchanged.
            pose: Joint rotations, [J, 3] axis-angle or [J, 4] quaternions; None leaves it unchanged.
            values: Other inputs: tensor name or role → value.

        Raises:
            UnknownName: The model has no such input.
            InputInvalid: A value does not fit; the message names the model, input and frame.
            RunFailed: ONNX Runtime failed.
        """
        return self._player.render(FrameRequest(camera, (_merge_outputs(time, pose, values),)))

    def play(
        self,
        cameras: Camera | Iterable[Camera],
        *,
        times: Iterable[float] | None = None,
        poses: Iterable[np.ndarray] | None = None,
        values: Iterable[Values] | None = None,
    ) -> Iterator[Frame]:
        """Yield frame after frame of an ONNX generator, computing one while another is drawn.

        Args:
            cameras: One per frame, or one for all.
            times: One per frame; None leaves the time unchanged.
            poses: One per frame; see :meth:`render`.
            values: One mapping per frame; see :meth:`render`.

        The shortest argument ends the sequence; one camera alone is one frame.

        Raises:
            GsgenError: See :meth:`render`; raised when the frame's turn comes.
        """
        arguments = (times, poses, values)
        if isinstance(cameras, Camera):
            has_frames = any(argument is not None for argument in arguments)
            cameras = repeat(cameras) if has_frames else [cameras]
        columns = [repeat(None) if argument is None else argument for argument in arguments]
        return self._player.play(
            FrameRequest(camera, (_merge_outputs(*parts),))
            for camera, *parts in zip(cameras, *columns, strict=False)
        )

    def close(self) -> None:
        """Release the sessions of all models; a second call has no effect."""
        if hasattr(self, "source"):  # else its model could not be opened
            self.source.close()
        for model in self._post_processors:
            model.close()
        if self._confined_models is not None:
            self._confined_models.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _merge_outputs(
    time: float | None, pose: np.ndarray | None, values: Values | None
) -> dict[str, object]:
    value_by_role = {"time": time, "pose": pose}
    values_by_role = {name: value for name, value in value_by_role.items() if value is not None}
    return values_by_role | dict(values or {})
