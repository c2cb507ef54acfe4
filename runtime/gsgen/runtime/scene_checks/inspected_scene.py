"""The input of the rules of scene files: their fields, and what their segments show at seams."""

__all__ = ["InspectedClip", "InspectedScene", "InspectedSegment", "Moments", "inspect_scene"]

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, final

import numpy as np
from jaxtyping import Complex128

from gsgen.contract.errors import GsgenError
from gsgen.contract.model.model_file import open_model
from gsgen.contract.process.atomic_files import MODEL_SUFFIX
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.layout import OPACITY, POSITION
from gsgen.contract.spec.manifest import GeneratorManifest, Input
from gsgen.contract.spec.manifest_io import loads
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.key_frames import DEFAULT_FPS
from gsgen.runtime.sources.opening import open_source
from gsgen.runtime.sources.scene_file import SceneFile, SceneModel, read_scene
from gsgen.runtime.sources.segmented_source import Segment, SegmentedSource
from gsgen.runtime.sources.source import Source

Statistics = Complex128[np.ndarray, "channels frequencies"]

# Wave vectors of the statistics, in radians for each root mean square radius of the first frame.
_FREQUENCIES: Final = np.random.default_rng(0).normal(size=(3, 64))
_SCALES: Final = (0.7, 2.5)
_ROWS_AT_ONCE: Final = 1 << 14  # each takes 5 KB
_NEARLY: Final = 1 - 1e-6  # of a segment's time: at its end, the next one begins


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Moments:
    """Statistics of the Gaussians that a segment shows, at the beginning of frames and at its end.

    Attributes:
        first: Frame 0.
        second: Frame 1, or the end of a segment of one frame.
        before_last: Frame F − 2, or the first one.
        last: Frame F − 1.
        end: Just before the next segment.
    """

    first: Statistics
    second: Statistics
    before_last: Statistics
    last: Statistics
    end: Statistics


@final
@dataclass(slots=True, eq=False, kw_only=True)
class InspectedSegment:
    """A segment, with the time input of its model, and what it shows.

    Attributes:
        where: Its location in the scene file.
        segment: Its file and its seconds.
        time: The time input of a generator; None for a still.
        error: Why it cannot be opened or shown; None if it can.
        moments: What it shows; None at level static, or with an error.
    """

    where: str
    segment: Segment
    time: Input | None = None
    error: GsgenError | None = None
    moments: Moments | None = None


@final
@dataclass(slots=True, eq=False, kw_only=True)
class InspectedClip:
    """A model of several segments."""

    model: SceneModel
    segments: list[InspectedSegment]


@final
@dataclass(slots=True, eq=False, kw_only=True)
class InspectedScene:
    """A scene file, as input of the rules GC.

    Attributes:
        path: The file.
        scene: Its contents; None with a fault.
        fault: Why it cannot be read; None if it can.
        clips: Its models of several segments.
        unshown_reason: Why segments were not shown; empty if they were.
    """

    path: Path
    scene: SceneFile | None = None
    fault: GsgenError | None = None
    clips: list[InspectedClip] = field(default_factory=list)
    unshown_reason: str = ""


def inspect_scene(
    path: Path, limits: Limits, *, shows: bool, progress: Callable[[str], None]
) -> InspectedScene:
    """Read a scene file; with ``shows``, run its segments around their seams, in a confined process."""
    try:
        scene = read_scene(path)
    except GsgenError as error:
        return InspectedScene(path=path, fault=error)
    clips = [_inspect_clip(model) for model in scene.models if model.segments]
    inspected = InspectedScene(path=path, scene=scene, clips=clips)
    if not shows or not clips:
        return inspected
    from gsgen.sdk.binding.confined.models import CAN_CONFINE, ConfinedModels

    if not CAN_CONFINE:
        inspected.unshown_reason = "this system cannot run models in a confined process"
        return inspected
    fps = scene.span.fps if scene.span else DEFAULT_FPS
    for clip in clips:
        models = [path for path in clip.model.paths if path.suffix.lower() == MODEL_SUFFIX]
        with ConfinedModels(models, limits) as confined:

            def open_file(path: Path) -> Source:
                return open_source(path, confined=confined)  # it is closed below

            _show(clip, fps, open_file, progress)
    return inspected


def _inspect_clip(model: SceneModel) -> InspectedClip:
    segments = []
    for number, segment in enumerate(model.segments):
        entry = InspectedSegment(where=f"{model.where}.segments[{number}]", segment=segment)
        segments.append(entry)
        if segment.path.suffix.lower() == MODEL_SUFFIX:
            try:
                text = open_model(segment.path).manifest_text
                manifest = loads(text) if text else None
            except GsgenError as error:
                entry.error = error
                continue
            if isinstance(manifest, GeneratorManifest):
                entry.time = next((i for i in manifest.inputs if i.role == "time"), None)
    return InspectedClip(model=model, segments=segments)


def _show(
    clip: InspectedClip,
    fps: float,
    open_file: Callable[[Path], Source],
    progress: Callable[[str], None],
) -> None:
    """Show the moments of all segments as a player does, one segment after the other."""
    name, model = clip.model.where, clip.model
    try:
        source = SegmentedSource(name, model.segments, model.capacity, open_file)
    except GsgenError as error:
        clip.segments[0].error = error
        return
    try:
        measure = _statistics_around(source.data)
        start = 0.0
        for number, entry in enumerate(clip.segments):
            progress(f"segment {number + 1} of {len(clip.segments)}")
            statistics = []
            try:
                for share in _shares(entry, fps):
                    source.update(None, {"time": start + entry.segment.seconds * share})
                    statistics.append(measure(source.data))
                first, second, before_last, last, end = statistics
                entry.moments = Moments(
                    first=first, second=second, before_last=before_last, last=last, end=end
                )
            except GsgenError as error:
                entry.error = error
                source.abandon()
            start += entry.segment.seconds
    finally:
        source.close()


def _shares(entry: InspectedSegment, fps: float) -> Iterator[float]:
    """Yield the shares of a segment's time that its :class:`Moments` are of."""
    frames = 1
    if entry.time is not None:
        frames = entry.time.frames or max(1, round(entry.segment.seconds * fps))
    for frame in (0, 1, frames - 2, frames - 1):
        yield min(max(frame, 0) / frames, _NEARLY)
    yield _NEARLY


def _statistics_around(first: SplatData) -> Callable[[SplatData], Statistics]:
    """Return a function that computes statistics of Gaussians, in units of the first frame's size.

    They are the characteristic functions of opacity and of opacity times each colour, at fixed
    wave vectors w: Σ o (1, c) exp(i w·x). Their distance is a maximum mean discrepancy (Gretton et
    al., "A Kernel Two-Sample Test", 2012, with the random features of Rahimi and Recht, 2007): it
    depends on no order of the rows, and errors of single rows, as of quantisation, average out.
    """
    points = first.rows[: first.count, POSITION].astype(np.float64)
    center = points.mean(axis=0) if len(points) else np.zeros(3)
    radius = float(np.sqrt(((points - center) ** 2).sum(axis=1).mean())) if len(points) else 0.0
    waves = np.concatenate([_FREQUENCIES * scale for scale in _SCALES], axis=1) / (radius or 1.0)

    def statistics(data: SplatData) -> Statistics:
        result = np.zeros((4, waves.shape[1]), complex)
        for first in range(0, data.count, _ROWS_AT_ONCE):
            part = slice(first, min(first + _ROWS_AT_ONCE, data.count))
            rows = data.rows[part].astype(np.float64)
            color = data.appearance[part, :3].astype(np.float64)
            weight = rows[:, OPACITY, None] * np.pad(color, ((0, 0), (1, 0)), constant_values=1)
            result += weight.T @ np.exp(1j * ((rows[:, POSITION] - center) @ waves))
        return result

    return statistics
