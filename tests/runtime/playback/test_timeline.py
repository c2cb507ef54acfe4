"""Times of camera files drive the time input of generators."""

import json
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures import find
from gsgen.runtime.camera_files import open_cameras
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.playback.camera_options import Viewpoint, viewpoint
from gsgen.runtime.playback.frame_sequence import FrameSequence
from gsgen.runtime.playback.input_tracks import Track
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.sources.opening import open_source

TIMES = [0.0, 0.1, 0.9, 0.35]
POSE = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 6], [0, 0, 0, 1]]


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(Device.open(), rasteriser="tiles")


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return find("drift").write(tmp_path_factory.mktemp("moving"))


def write_transforms(folder: Path, times: list[float | None]) -> Path:
    frames = [
        {"transform_matrix": POSE, **({} if time is None else {"time": time})} for time in times
    ]
    path = folder / "transforms.json"
    path.write_text(json.dumps({"camera_angle_x": 0.7, "w": 24, "h": 24, "frames": frames}))
    return path


def write_camera_path(folder: Path, times: list[float | None]) -> Path:
    flat = np.array(POSE).ravel().tolist()
    frames = [
        {"camera_to_world": flat, "fov": 40, **({} if time is None else {"render_time": time})}
        for time in times
    ]
    path = folder / "camera_path.json"
    size = {"render_width": 24, "render_height": 24, "seconds": 0.5, "fps": 24}
    path.write_text(json.dumps(size | {"camera_path": frames}))
    return path


def times_of(
    renderer: Renderer, model: Path, view: Viewpoint, **options: object
) -> tuple[list[float], FrameSequence]:
    """The time of the model in each frame of a sequence."""
    source = open_source(model)
    sequence = FrameSequence([source], view, renderer=renderer, **options)
    name = source.time.name if source.time else ""
    values = [sequence.frame_request(number).values[0] for number in range(sequence.frames)]
    return [float(np.ravel(value.get(name, -1))[0]) for value in values], sequence


@pytest.mark.parametrize("write", [write_transforms, write_camera_path])
def test_times_of_cameras_are_those_of_the_frames(
    write: object, renderer: Renderer, moving: Path, tmp_path: Path
) -> None:
    path = write(tmp_path, TIMES)  # type: ignore[operator]
    assert [entry.time for entry in open_cameras(path).cameras] == TIMES
    cases: list[tuple[str, dict[str, object], list[float]]] = [
        ("", {}, TIMES),
        ("#2", {}, [0.9]),
        ("#::2", {}, [0.0, 0.9]),
        ("#1:", {}, TIMES[1:]),
        ("", {"frames": 6}, [*TIMES, *TIMES[:2]]),
        ("", {"frames": 2}, TIMES[:2]),
        ("", {"time": 0.5}, [0.5] * 4),
        ("", {"tracks": [Track("time", np.array([0.2, 0.4, 0.6, 0.8]), "")]}, [0.2, 0.4, 0.6, 0.8]),
    ]
    for selection, options, expected in cases:
        view = viewpoint(f"{path}{selection}")
        actual, sequence = times_of(renderer, moving, view, **options)
        assert actual == pytest.approx(expected), (selection, options)
        assert sequence.notes == ()


def test_a_camera_path_sets_the_frame_rate(
    renderer: Renderer, moving: Path, tmp_path: Path
) -> None:
    path = write_camera_path(tmp_path, TIMES)
    assert times_of(renderer, moving, viewpoint(str(path)))[1].fps == 8  # 4 frames in 0.5 s
    assert times_of(renderer, moving, viewpoint(str(path)), fps=3)[1].fps == 3


def test_times_without_a_use_are_noted(renderer: Renderer, moving: Path, tmp_path: Path) -> None:
    still = find("still_sh0").write(tmp_path)
    view = viewpoint(str(write_transforms(tmp_path, TIMES)))
    _, sequence = times_of(renderer, still, view)
    assert sequence.notes == (
        "not used: the times of the cameras, because no scene has a time input",
    )
    some = viewpoint(str(write_transforms(tmp_path, [0.0, None, 0.9])))
    assert some.times == ()
    assert "the times, which only 2 of 3 have" in some.notes[0]
    assert viewpoint(str(write_transforms(tmp_path, [None, None]))).notes == ()
