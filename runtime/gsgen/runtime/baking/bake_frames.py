"""Bakes frames of an ONNX generator into splat files, with few frames in memory at a time."""

__all__ = ["bake", "bake_source"]

import os
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Final, final

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.process.atomic_files import refuse_itself
from gsgen.contract.spec.layout import DecodedGaussians, decode, decode_rows
from gsgen.contract.spec.spherical_harmonics import MAX_DEGREE
from gsgen.formats import Splats
from gsgen.formats.shared.files import make_folder
from gsgen.runtime.baking.fidelity import generator_images, psnr_of_file, renderer_or_none
from gsgen.runtime.baking.frame_splats import FrameConverter
from gsgen.runtime.baking.frame_values import FrameValues
from gsgen.runtime.baking.report import BakedFrame, BakeReport
from gsgen.runtime.baking.sh_fit import best_degree, color_errors, fit_sh
from gsgen.runtime.baking.targets import OutputFiles
from gsgen.runtime.baking.view_samples import ViewSamples, cameras_around, sample_views
from gsgen.runtime.playback.input_tracks import Track
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.sources.source import GeneratorSource

if TYPE_CHECKING:
    from gsgen.runtime.renderer.renderer import Renderer

_CAMERA_ROLES: Final = frozenset({"view", "projection", "camera_position", "viewport"})
_HELD_OUT_STEP: Final = 5  # every fifth camera chooses the degree and takes no part in the fit
_TEST_CAMERAS: Final = 4
_MAX_QUEUED_FRAMES: Final = (
    1  # frames that wait for the writer, or are written, while the next is converted
)
MIN_VIEWS: Final = 20
"""Fewest cameras for a fit of SH degree 3, which has 16 coefficients."""

Progress = Callable[[str], None]


def bake(
    model: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    time: float | Float[np.ndarray, " f"] | None = None,
    values: Mapping[str, object] | None = None,
    camera: Camera | None = None,
    format: str | None = None,
    views: int = 30,
    max_degree: int = MAX_DEGREE,
    psnr: bool | None = None,
    provider: str = "cpu",
    sizes: Mapping[str, int] | None = None,
    progress: Progress = lambda text: None,
) -> BakeReport:
    """Write frames of an ONNX generator as plain splat files.

    Only rows that are drawn are written (live, finite, opacity at least 1/255), in their order.

    Args:
        model: The ONNX file.
        output: The file to write; with ``%04d`` for the frame's number where there are several.
        time: One time, or one per frame.
        values: Tensor name or role → one value, or one per frame along a first axis.
        camera: Bake what this camera sees. None fits SH to the colours around the scene.
        format: Name of the format; None for the one that the suffix names.
        views: Cameras around the scene; every fifth is held out to choose the SH degree.
        max_degree: Highest SH degree of fitted colours.
        psnr: Render the file and the generator and measure the PSNR; None does so where colours
            or rows depend on the camera.
        provider: Execution provider of the model: cpu, webgpu, cuda or auto.
        sizes: Symbol → size of an open dimension.
        progress: Called with a short text as the bake goes on.

    Raises:
        ConfigInvalid: An option or a value is invalid.
        UnknownName: The generator has no such input, or no format has this name.
        ModelUnreadable: The file is not an ONNX model.
        SceneInvalid: The model is not a generator.
        FormatError: A file cannot be written.
    """
    tracks = [] if time is None else [Track("time", np.asarray(time), "time")]
    tracks += [
        Track(input_name, np.asarray(value), f"values[{input_name!r}]")
        for input_name, value in (values or {}).items()
    ]
    with closing(GeneratorSource(Path(model), provider, sizes)) as source:
        return bake_source(
            source,
            Path(output),
            tracks=tracks,
            cameras=[] if camera is None else [camera],
            format=format,
            views=views,
            max_degree=max_degree,
            psnr=psnr,
            progress=progress,
        )


def bake_source(
    source: GeneratorSource,
    output: Path,
    *,
    tracks: Sequence[Track] = (),
    cameras: Sequence[Camera] = (),
    format: str | None = None,
    views: int = 30,
    max_degree: int = MAX_DEGREE,
    psnr: bool | None = None,
    progress: Progress = lambda text: None,
    inputs: Sequence[Path] = (),
) -> BakeReport:
    """Write frames of an ONNX generator that is already open as plain splat files.

    The frames have the input values of ``tracks``, and what ``cameras`` see: one camera per frame,
    one for all, or none to fit SH. No frame overwrites the model or one of the files ``inputs``.
    """
    started = perf_counter()
    values = FrameValues(source, tracks)
    frames = _frame_count(values.frames, len(cameras))
    if not 0 <= max_degree <= MAX_DEGREE:
        raise ConfigInvalid(f"is {max_degree}, expected 0 to {MAX_DEGREE}", where="max_degree")
    if views < MIN_VIEWS:
        raise ConfigInvalid(
            f"the number of cameras is {views}, expected {MIN_VIEWS} or more",
            where="views",
            hint="Degree 3 has 16 coefficients, and every fifth camera is held out.",
        )
    files = OutputFiles.of(output, frames, format)
    for number in range(frames):
        refuse_itself(files.path(number), [Path(source.name), *inputs])
    codec = files.codec
    write = codec.frame_writer() if frames > 1 and codec.frame_writer else codec.write
    assert write is not None  # OutputFiles has checked it
    job = _BakeJob(
        source=source, values=values, cameras=cameras, files=files, write=write, views=views,
        max_degree=max_degree, psnr=psnr, frames=frames, progress=progress,
        converter=FrameConverter(
            antialiased=source.antialias == "mip", color_space=source.color_space
        ),
    )  # fmt: skip
    written_frames = job.write_all()
    return BakeReport(
        model=source.name,
        format=codec.name,
        frames=written_frames,
        view_dependence=job.view_dependence,
        fit_error=job.fit_error,
        test_cameras=job.test_cameras,
        notes=tuple(job.notes),
        seconds=perf_counter() - started,
    )


def _frame_count(frames: int, cameras: int) -> int:
    if cameras > 1 and frames > 1 and cameras != frames:
        raise ConfigInvalid(
            f"has {cameras} cameras, expected 1 or {frames}, as the other inputs",
            where="--camera",
            hint="Pick one camera with FILE#NUMBER.",
        )
    return max(frames, cameras, 1)


@final
@dataclass(slots=True, kw_only=True, eq=False)
class _BakeJob:
    """The state of writing frames of an ONNX generator as splat files."""

    source: GeneratorSource
    values: FrameValues
    cameras: Sequence[Camera]
    files: OutputFiles
    write: Callable[[Path, Splats], None]
    views: int
    max_degree: int
    psnr: bool | None
    frames: int
    progress: Progress
    converter: FrameConverter
    started: int = -1  # the frame that the model computes, or has computed
    decoded: DecodedGaussians | None = None
    version: tuple[int, int] = (-1, -1)  # of the decoded colours, and the live count
    view_dependence: str = "none"
    fit_error: tuple[float, ...] = ()
    test_cameras: int = 0
    notes: dict[str, None] = field(default_factory=dict)  # in order, each once
    degree: int | None = None  # chosen in the first frame, the same in all
    renderer: "Renderer | None" = None

    def write_all(self) -> tuple[BakedFrame, ...]:
        """Write all frames: a thread writes one while the next one is converted.

        Where no camera is sampled, the model computes the frame after that meanwhile.
        """
        written_frames: list[BakedFrame] = []
        queue: deque[Future[BakedFrame]] = deque()
        with ThreadPoolExecutor(1, thread_name_prefix="gsgen writing") as writer:
            for number in range(self.frames):
                frame_label = f"frame {number + 1} of {self.frames}" if self.frames > 1 else "frame"
                splats, skipped = self._convert_frame(number, frame_label)
                self.progress(f"{frame_label}: writing {self.files.path(number).name}")
                queue.append(writer.submit(self._write, number, splats, skipped))
                while len(queue) > (0 if self._is_measured_frame(number) else _MAX_QUEUED_FRAMES):
                    written_frames.append(queue.popleft().result())
                if self._is_measured_frame(number):
                    psnr = self._measured_psnr(number, Path(written_frames[-1].file), frame_label)
                    written_frames[-1] = replace(written_frames[-1], psnr=psnr)
            written_frames.extend(future.result() for future in queue)
        return tuple(written_frames)

    def _convert_frame(self, number: int, frame_label: str) -> tuple[Splats, int]:
        """Compute a frame; return its drawn Gaussians, and the number of Gaussians not drawn."""
        self.progress(f"{frame_label}: running the model")
        gaussians = self._decode_gaussians(number, frame_label)
        mask, nonfinite_count = self.converter.drawn_mask(gaussians)
        if nonfinite_count:
            self._add_note(
                f"frame {number}: {nonfinite_count:,} Gaussians are not finite and were left out"
            )
        splats = self.converter.convert(gaussians, mask)
        self._note_losses(splats)
        return splats, len(gaussians) - len(splats)

    def _write(self, number: int, splats: Splats, skipped: int) -> BakedFrame:
        path, codec = self.files.path(number), self.files.codec
        make_folder(path)
        self.write(path, splats)
        return BakedFrame(
            file=str(path),
            count=len(splats),
            skipped=skipped,
            sh_degree=min(splats.degree, codec.most_degree),
            bytes=path.stat().st_size,
            time=self.values.time(self._value_index(number)),
        )

    # ---- The Gaussians of a frame

    def _decode_gaussians(self, number: int, frame_label: str) -> DecodedGaussians:
        """Return a frame's Gaussians without padding rows, with colours that a file can hold."""
        source = self.source
        if self.cameras or not _camera_inputs(source):
            if self.cameras:
                self._note_camera()
            return self._compute_frame(number)
        values = self._values(number)
        if number == 0:
            source.survey([(0, values)])  # the sphere of cameras stays the same in all frames
        samples = sample_views(
            source,
            cameras_around(source, self.views),
            values,
            number,
            lambda view: self.progress(f"{frame_label}: camera {view + 1} of {self.views}"),
        )
        self._note_dependence(samples)
        if samples.colors is None:
            return samples.union
        self.progress(f"{frame_label}: fitting SH")
        return replace(samples.union, sh=self._fit_colors(samples), rgb=None)

    def _compute_frame(self, number: int) -> DecodedGaussians:
        """Return a frame's Gaussians without padding rows, and begin to compute the next frame."""
        source = self.source
        if self.started != number:
            source.start(self._camera(number), self._values(number), number)
        source.finish()
        gaussians = self._decode_frame()
        # The model runs for other cameras when PSNR is measured.
        if number + 1 < self.frames and not self._is_measured_frame(number):
            self.started = number + 1
            source.start(self._camera(number + 1), self._values(number + 1), number + 1)
        return gaussians

    def _decode_frame(self) -> DecodedGaussians:
        """Copy a frame's Gaussians without padding rows; copy colours only if they changed."""
        data = self.source.data
        rows, version = data.rows[: data.count], (data.appearance_version, data.count)
        if self.decoded is None or self.version != version:
            self.decoded = decode(rows, data.appearance[: data.count], data.space)
            self.version = version
            return self.decoded
        position, opacity, covariance = decode_rows(rows)
        return replace(self.decoded, position=position, opacity=opacity, covariance=covariance)

    def _value_index(self, number: int) -> int:
        return number if self.values.frames > 1 else 0

    def _values(self, number: int) -> Mapping[str, object]:
        return self.values.values_of_frame(self._value_index(number))

    def _camera(self, number: int) -> Camera | None:
        return self.cameras[number % len(self.cameras)] if self.cameras else None

    def _fit_colors(self, samples: ViewSamples) -> np.ndarray:
        """Fit SH to the sampled colours; the first frame chooses the degree by held-out error."""
        assert samples.colors is not None
        is_held_out = np.arange(self.views) % _HELD_OUT_STEP == _HELD_OUT_STEP // 2
        positions = samples.union.position
        sets = [
            (
                samples.eye_positions[chosen_views],
                samples.colors[chosen_views],
                samples.opacity[chosen_views],
            )
            for chosen_views in (~is_held_out, is_held_out)
        ]
        if self.degree is None:
            self.fit_error = tuple(
                color_errors(positions, *sets[1], fit_sh(positions, *sets[0], degree))
                for degree in range(self.max_degree + 1)
            )
            self.degree = best_degree(self.fit_error)
        return fit_sh(positions, *sets[0], self.degree)

    # ---- Notes

    def _add_note(self, text: str) -> None:
        self.notes[text] = None

    def _note_camera(self) -> None:
        self.view_dependence = "camera" if _camera_inputs(self.source) else "none"
        if self.view_dependence == "none":
            self._add_note(
                "the model does not depend on a camera: poses of --camera change nothing"
            )

    def _note_dependence(self, samples: ViewSamples) -> None:
        parts = ["rows"] * samples.rows_change + ["colors"] * (samples.colors is not None)
        dependences = {*self.view_dependence.split(" and "), *parts} - {"none"}
        self.view_dependence = " and ".join(sorted(dependences, reverse=True)) or "none"
        if samples.rows_change:
            self._add_note(
                "Gaussians depend on the camera: opacities, positions and covariances are means over "
                f"{self.views} cameras around the scene; --camera bakes what one camera sees"
            )

    def _note_losses(self, splats: Splats) -> None:
        codec = self.files.codec
        if splats.degree > codec.most_degree:
            self._add_note(
                f"{codec.title} holds SH up to degree {codec.most_degree}: the rest is lost"
            )
        if splats.antialiased and "antialiased" not in codec.keeps_flags:
            self._add_note(
                f"{codec.title} does not store antialiasing: draw it with `--antialias mip`"
            )
        if splats.color_space != "srgb" and "color_space" not in codec.keeps_flags:
            self._add_note(f"{codec.title} does not store the colour space: colours are linear")
        if self.source.weighted is not None:
            self._add_note("the model is blended by weighted sums, and splat files by sorting")

    # ---- PSNR

    def _is_measured_frame(self, number: int) -> bool:
        """Return whether a frame's PSNR is measured; only the first, middle and last can be."""
        if number not in {0, self.frames // 2, self.frames - 1}:
            return False
        is_exact = self.view_dependence in ("none", "camera") and self.source.weighted is None
        return self.psnr if self.psnr is not None else not is_exact

    def _measured_psnr(self, number: int, path: Path, frame_label: str) -> float | None:
        """Measure the PSNR of a written frame; None, and a note, where nothing can be drawn."""
        if self.renderer is None:
            self.renderer, reason = renderer_or_none()
            if self.renderer is None:
                self._add_note(f"PSNR was not measured: {reason}")
                return None
        self.progress(f"{frame_label}: measuring PSNR")
        source, camera = self.source, self._camera(number)
        cameras = [camera] if camera else cameras_around(source, _TEST_CAMERAS, offset=0.2)
        self.test_cameras = len(cameras)
        images = generator_images(source, cameras, self._values(number), number, self.renderer)
        return psnr_of_file(
            path, cameras, images, source.antialias, source.color_space, self.renderer
        )


def _camera_inputs(source: GeneratorSource) -> list[str]:
    """Return the names of camera inputs that outputs may depend on, by the manifest."""
    return [
        spec.name
        for spec in source.inputs
        if spec.role in _CAMERA_ROLES and source.manifest.depends(spec)
    ]
