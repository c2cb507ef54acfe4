"""Rules (GC) of scene files with segments: files, frames, seams, the loop, sound and captions."""

__all__ = ["SCENE", "SCENE_RULES"]

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.rule import rule, rules_in
from gsgen.runtime.playback.sound_tracks import SOUND_SUFFIX, read_sound
from gsgen.runtime.scene_checks.inspected_scene import (
    InspectedScene,
    InspectedSegment,
    Moments,
    Statistics,
)
from gsgen.runtime.sources.key_frames import SceneSound

SCENE: Final = "scene"
"""The kind of file that these rules check."""

_scene_rule = partial(rule, over="scene", kinds=(SCENE,))
_shown_rule = partial(_scene_rule, level=Level.VALUES, needs=("GC001", "GC002"))

# Changes of the statistics that quantisation makes, relative to those of a frame.
_NOISE: Final = 0.02
# Steps that frames may be apart at a seam: a segment that goes on to its end shows the next frame
# there, one that holds its last frame is one step before it.
_MAX_STEPS, _MAX_STEPS_HELD = 0.5, 1.75
# A frame is another one's copy, or is held, within this share of a step.
_SAME: Final = 0.25
_MAX_CAPTIONS: Final = 1 << 24  # characters that are read
_CUE: Final = re.compile(r"^((?:\d+:)?\d\d:\d\d\.\d{3})[ \t]+-->", re.MULTILINE)


@_scene_rule("GC001", Severity.ERROR)
def scene_file_whole(inspected: InspectedScene) -> Iterator[Violation]:
    """A scene file has fields of the format alone, and the files that it names are there.

    Why:
        Players refuse an unknown field, and stop at a file that is missing: of a segment, in the
        midst of the film.

    Hint:
        Correct the field that is named; copy the folder of the segments along with the scene file.
    """
    if inspected.fault is not None:
        yield Violation.at("scene file", str(inspected.fault), "fields of the format")
    scene = inspected.scene
    if scene is None:
        return
    sound = [scene.sound.path, scene.sound.captions] if scene.sound else []
    parts = [path for model in scene.models for path in model.paths]
    parts += [mesh.path for mesh in scene.meshes] + [post.path for post in scene.posts]
    for path in filter(None, [*parts, *sound]):
        is_there = path.exists() or ":/" in path.as_posix()
        if not (path.is_file() if path in sound else is_there):
            yield Violation.at(f"file {_name(inspected, path)}", "missing", "a file")


def _name(inspected: InspectedScene, path: Path) -> str:
    """Return a path as the scene file gives it: absolute, or from its folder."""
    folder = inspected.path.parent
    return (path.relative_to(folder) if path.is_relative_to(folder) else path).as_posix()


@_scene_rule("GC002", Severity.ERROR, level=Level.VALUES, needs=("GC001",))
def segments_alike(inspected: InspectedScene) -> Iterator[Violation]:
    """Segments hold Gaussians of one kind, and none more of them than the capacity.

    Why:
        A player has buffers of the capacity, and one pipeline for the colours of all segments.

    Hint:
        Export all segments with the same options; let "capacity" be the most Gaussians of one.
    """
    for clip in inspected.clips:
        for entry in clip.segments:
            if entry.error is not None:
                yield Violation.at(entry.where, str(entry.error), "Gaussians like the others")


@_scene_rule("GC003", Severity.ERROR, needs=("GC001",))
def segments_last_their_frames(inspected: InspectedScene) -> Iterator[Violation]:
    """A segment lasts as long as its frames at their rate, and does not loop by itself.

    Why:
        Its frames are shown too slowly or too fast, and what follows, such as sound, comes too
        early or too late. The end of a segment that loops goes back to its own start.

    Hint:
        Let "seconds" be frames / fps of the segment's manifest. Export segments without "loop";
        the timeline of the scene file has it.
    """
    for clip in inspected.clips:
        for entry in clip.segments:
            time = entry.time
            if time is not None and time.loop:
                yield Violation.at(entry.where, "loops by itself", "an end that the next continues")
            if time is None or not time.frames or not time.fps:
                continue
            seconds, expected = entry.segment.seconds, time.frames / time.fps
            if abs(seconds - expected) > 0.5 / time.fps:
                actual = f"{seconds:g} s for {time.frames} frames at {time.fps:g} a second"
                yield Violation.at(entry.where, actual, f"{expected:g} s")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Seam:
    """The end of a segment and the start of the next, with what both show.

    Attributes:
        after: The next segment; the first one where the timeline loops.
        name: The segment before it, in short.
        first: What the segment before it shows.
        second: What the next one shows.
        closes: Whether it is the seam of a loop.
    """

    after: InspectedSegment
    name: str
    first: Moments
    second: Moments
    closes: bool

    @property
    def step(self) -> float:
        """The largest step between two frames of one segment beside the seam."""
        return max(
            _distance(self.first.before_last, self.first.last),
            _distance(self.first.last, self.first.end),
            _distance(self.second.first, self.second.second),
        )

    @property
    def noise(self) -> float:
        """A distance that quantisation may make."""
        return _NOISE * float(np.linalg.norm(self.second.first))

    @property
    def repeats(self) -> bool:
        """Whether the next segment begins with the last frame of the one before, in a motion."""
        before = _distance(self.first.before_last, self.first.last)
        after = _distance(self.second.first, self.second.second)
        step = min(filter(None, (before, after)), default=0.0)  # a still has none
        distance = _distance(self.first.last, self.second.first)
        return step > self.noise and distance <= _SAME * step


def _distance(first: Statistics, second: Statistics) -> float:
    return float(np.linalg.norm(first - second))


def _seams(inspected: InspectedScene) -> Iterator[_Seam]:
    """Yield the seams of all clips whose two segments were shown."""
    loops = inspected.scene is not None and inspected.scene.span and inspected.scene.span.loop
    for clip in inspected.clips:
        segments = clip.segments
        pairs = [(*pair, False) for pair in pairwise(segments)]
        if loops and len(segments) > 1:
            pairs.append((segments[-1], segments[0], True))
        for before, after, closes in pairs:
            if before.moments is not None and after.moments is not None:
                yield _Seam(
                    after=after,
                    name=before.where.rpartition(".")[2],
                    first=before.moments,
                    second=after.moments,
                    closes=closes,
                )


@_shown_rule("GC004", Severity.WARNING)
def frames_once(inspected: InspectedScene) -> Iterator[Violation]:
    """A segment does not begin with the last frame of the one before it.

    Why:
        The motion stops for a frame at each seam, and the film gets longer than its sound.

    Hint:
        Let a segment end in the first frame of the next, at the end of its time, but count this
        frame among those of the next alone.
    """
    for seam in _seams(inspected):
        if seam.repeats:
            actual = f"begins with the last frame of {seam.name}"
            yield Violation.at(seam.after.where, actual, "the next frame", certainty="possible")


@_shown_rule("GC005", Severity.WARNING)
def seams_continue(inspected: InspectedScene) -> Iterator[Violation]:
    """The end of a segment continues in the start of the next one.

    Why:
        A frame that no segment has, or an end that is another one's, is a jump in the film.

    Hint:
        Let a segment end in the first frame of the next, and leave out no frame between them.
    """
    yield from _jumps(seam for seam in _seams(inspected) if not seam.closes)


@_shown_rule("GC006", Severity.WARNING)
def loop_closes(inspected: InspectedScene) -> Iterator[Violation]:
    """Where the timeline loops, the end of the last segment continues in the start of the first.

    Why:
        The film jumps whenever it begins again.

    Hint:
        Export the frames with --loop, so that the last segment ends in the first frame; or let the
        timeline not loop.
    """
    yield from _jumps(seam for seam in _seams(inspected) if seam.closes)


def _jumps(seams: Iterator[_Seam]) -> Iterator[Violation]:
    """Yield the seams at which frames are further apart than beside them."""
    for seam in seams:
        step = seam.step
        is_still = not _distance(seam.first.first, seam.first.end)
        if seam.repeats or (is_still and not _distance(seam.second.first, seam.second.end)):
            continue  # another rule says it, or there is no step between frames
        is_held = _distance(seam.first.last, seam.first.end) <= _SAME * step
        steps = _MAX_STEPS_HELD if is_held else _MAX_STEPS
        jump = _distance(seam.first.end, seam.second.first)
        if jump > steps * step + seam.noise:
            actual = (
                f"is {jump / max(step, seam.noise):.2g} frames' steps from the end of {seam.name}"
            )
            yield Violation.at(seam.after.where, actual, f"at most {steps:g}", certainty="possible")


@_scene_rule("GC007", Severity.WARNING, needs=("GC001",))
def sound_in_time(inspected: InspectedScene) -> Iterator[Violation]:
    """Sound and captions are within the timeline, which lasts as long as the segments.

    Why:
        What begins after the end is never heard, and what ends later is cut off. Segments are
        stretched to the timeline, sound is not.

    Hint:
        Give "start" in seconds of the timeline; cut the recording; leave "seconds" of the timeline
        out.
    """
    scene = inspected.scene
    if scene is None or scene.sound is None:
        return
    if scene.span is None:
        yield Violation.at("sound", "no timeline", "segments, key frames or a timeline")
        return
    sound, span = scene.sound, scene.span
    for clip in inspected.clips:
        seconds = sum(segment.seconds for segment in clip.model.segments)
        if abs(seconds - span.seconds) > 1 / span.fps:
            actual = f"{span.seconds:g} s for segments of {seconds:g}"
            yield Violation.at("timeline", actual, "no stretching of segments beside sound")
    begin, length = sound.start, 0.0
    if sound.path.suffix.lower() == SOUND_SUFFIX:
        try:
            samples, rate = read_sound(sound.path)
            length = len(samples) / rate
        except ConfigInvalid as error:
            yield Violation.at("sound", error.message, "a WAV of PCM")
    if begin >= span.seconds or (length and begin + length <= 0):
        actual = f"from {begin:g} to {begin + length:g} s"
        yield Violation.at("sound", actual, f"a part within 0 to {span.seconds:g} s")
    elif begin + length > span.seconds + 1 / span.fps:
        yield Violation.at("sound", f"ends at {begin + length:g} s", f"{span.seconds:g} s at most")
    yield from _late_captions(sound, span.seconds)


def _late_captions(sound: SceneSound, seconds: float) -> Iterator[Violation]:
    """Yield what is wrong with captions: no WebVTT, or a cue that begins after the end."""
    if sound.captions is None:
        return
    with sound.captions.open(encoding="utf-8-sig", errors="replace") as file:
        text = file.read(_MAX_CAPTIONS)
    cues = [_seconds_of(cue) + sound.start for cue in _CUE.findall(text)]
    if not text.startswith("WEBVTT") or not cues:
        yield Violation.at("captions", f"{len(cues)} cues", "WebVTT with a cue")
    elif max(cues) >= seconds:
        actual = f"a cue that begins at {max(cues):g} s of the timeline"
        yield Violation.at("captions", actual, f"cues before its end, {seconds:g} s")


def _seconds_of(time: str) -> float:
    """Return the seconds of a time of WebVTT, [hours:]minutes:seconds."""
    *hours, minutes, seconds = map(float, time.split(":"))
    return 3600 * sum(hours) + 60 * minutes + seconds


SCENE_RULES: Final = tuple(rules_in(sys.modules[__name__]))
"""All rules, in order of their ids."""
