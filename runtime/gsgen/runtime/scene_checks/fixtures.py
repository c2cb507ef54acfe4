"""Fixtures: example scene files of segments, valid or breaking one rule of the family GC.

Registered under the entry point group ``gsgen.fixtures``.
"""

import io
import sys
import wave
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from gsgen.conformance.fixtures.builders.clouds import still
from gsgen.conformance.fixtures.builders.fixture import Fixture, fixtures_in, invalid
from gsgen.conformance.fixtures.builders.folder_sketch import FolderSketch
from gsgen.conformance.fixtures.builders.moving import drifting_model
from gsgen.contract.spec.manifest import Input
from gsgen.contract.spec.severity import Level

__all__ = ["scene_fixtures"]

_ROWS, _FRAMES, _FPS, _SEGMENTS = 24, 4, 8.0, 3
_CAPTIONS = "WEBVTT\n\n00:00.250 --> 00:01.000\nHello\n"


def scene_fixtures() -> list[Fixture]:
    """Return all example scene files, valid and invalid."""
    return fixtures_in(sys.modules[__name__])


_scene = partial(invalid, level=Level.VALUES, suffix="/scene.json")


def _segment(first: float, *, rows: int = _ROWS, **changes: Any) -> bytes:
    """Return a model of frames ``first`` to first + 4, the first one of the next segment."""
    drifting = drifting_model(rows)
    center, speed = (drifting.weights[name] for name in ("center", "speed"))
    time = Input(name="time", role="time", shape=(1,), range=(0.0, 1.0), default=0.0)
    time = replace(time, frames=_FRAMES, fps=_FPS, **changes)
    moved = drifting.with_weights(center=center + speed * np.float32(first / _FRAMES))
    return moved.with_manifest(inputs=(time,)).build().SerializeToString()


def _sketch(*firsts: float, **timeline: Any) -> FolderSketch:
    """Return a scene of segments that begin with these frames."""
    firsts = firsts or tuple(float(_FRAMES * number) for number in range(_SEGMENTS))
    paths = [f"clip/from-{first:g}.onnx" for first in firsts]
    segments = [{"path": path, "seconds": _FRAMES / _FPS} for path in paths]
    document: dict[str, Any] = {
        "gsgen_scene": "1.0",
        "models": [{"segments": segments, "capacity": _ROWS}],
    }
    if timeline:
        document["timeline"] = timeline
    files = {path: _segment(first) for path, first in zip(paths, firsts, strict=True)}
    return FolderSketch(document, files)


def _with_sound(seconds: float, captions: str = _CAPTIONS) -> FolderSketch:
    """Return a scene with a recording of some seconds, and captions."""
    buffer = io.BytesIO()
    with wave.open(buffer, "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(8000)
        file.writeframes(bytes(2 * round(8000 * seconds)))
    sketch = _sketch()
    sketch.document["sound"] = {"path": "speech.wav", "captions": "speech.vtt"}
    sketch.files |= {"speech.wav": buffer.getvalue(), "speech.vtt": captions.encode()}
    return sketch


@_scene("")
def scene_of_segments() -> FolderSketch:
    """Fixture: a scene file of three segments, each of which ends in the first frame of the next."""
    return _sketch()


@_scene("")
def scene_that_holds_frames() -> FolderSketch:
    """Fixture: a scene file of stills of one frame each, which do not share Gaussians."""
    sketch = _sketch()
    for number, path in enumerate(list(sketch.files)):
        spec = still(_ROWS)
        rows = np.array(spec.weights["rows"])
        rows[:, 0] += number
        sketch.files[path] = spec.with_weights(rows=rows).build().SerializeToString()
    return sketch


@_scene("")
def scene_with_sound() -> FolderSketch:
    """Fixture: a scene file of three segments with a recording as long as they are, and captions."""
    return _with_sound(_SEGMENTS * _FRAMES / _FPS)


@_scene("GC001")
def scene_without_file() -> FolderSketch:
    """Fixture: a scene file whose second segment is missing."""
    sketch = _sketch()
    del sketch.files[f"clip/from-{_FRAMES}.onnx"]
    return sketch


@_scene("GC001")
def scene_with_unknown_field() -> FolderSketch:
    """Fixture: a scene file with a field that the format does not have."""
    sketch = _sketch()
    sketch.document["segments"] = sketch.document["models"][0]["segments"]
    return sketch


@_scene("GC002")
def scene_above_capacity() -> FolderSketch:
    """Fixture: a scene file whose last segment has more Gaussians than the capacity."""
    sketch = _sketch()
    last = sketch.document["models"][0]["segments"][-1]["path"]
    sketch.files[last] = _segment(2 * _FRAMES, rows=_ROWS + 1)
    return sketch


@_scene("GC003")
def scene_of_slow_segment() -> FolderSketch:
    """Fixture: a scene file with a segment of four frames that lasts as long as six."""
    sketch = _sketch()
    sketch.document["models"][0]["segments"][1]["seconds"] = 6 / _FPS
    return sketch


@_scene("GC004")
def scene_of_shared_frames() -> FolderSketch:
    """Fixture: a scene file whose segments begin with the last frame of the one before."""
    return _sketch(*((_FRAMES - 1.0) * number for number in range(_SEGMENTS)))


@_scene("GC005")
def scene_with_gap() -> FolderSketch:
    """Fixture: a scene file that lacks a frame between two segments."""
    return _sketch(0.0, _FRAMES + 1.0, 2 * _FRAMES + 1.0)


@_scene("GC006")
def scene_loop_jumps() -> FolderSketch:
    """Fixture: a scene file that loops, whose last segment does not end in the first frame."""
    return _sketch(loop=True)


@_scene("GC007")
def scene_sound_cut_off() -> FolderSketch:
    """Fixture: a scene file whose recording is longer than its segments."""
    return _with_sound(_SEGMENTS * _FRAMES / _FPS + 1)


@_scene("GC007")
def scene_late_caption() -> FolderSketch:
    """Fixture: a scene file with a caption after the end of its segments."""
    return _with_sound(1.0, _CAPTIONS + "\n00:09.000 --> 00:10.000\nNever\n")
