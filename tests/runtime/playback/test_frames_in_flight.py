"""Films with frames in flight: pictures, errors and their order are those of frames one by one."""

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Literal

import numpy as np
import pytest

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.errors import CapacityExceeded, MemoryFull, SceneInvalid
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.spatial_order import MIN_ORDERED_ROWS
from gsgen.runtime.playback.player import FrameRequest, Player
from gsgen.runtime.renderer import renderer as renderers
from gsgen.runtime.renderer.frame_images import FrameReadback
from gsgen.runtime.renderer.frame_plan import Plan
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import OUTPUTS, Frame
from gsgen.runtime.scene.scene import SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.source import Source, Values
from support.rendering.near_ties import plane
from support.rendering.small_bindings import assert_same_images
from support.rendering.splat_scenes import camera, cloud, turned
from support.rendering.watched_device import watched

Arrays = tuple[np.ndarray, np.ndarray, int]
"""Rows, appearance and count of a frame."""


class Steps(Source):
    """A source whose rows, colours and count are others in each frame, in arrays of their own."""

    name = "steps"

    def __init__(self, frames: Sequence[SplatData], transform: np.ndarray | None = None) -> None:
        self._frames = [(data.rows, data.appearance, data.count) for data in frames]
        self._transform = np.eye(4) if transform is None else transform
        self._next: int | None = None
        self.holds, self.interrupted, self.abandoned = True, 0, 0
        first = frames[0]
        self.data = SplatData(first.rows, first.appearance, first.space, count=first.count)

    def start(self, camera: Camera | None, values: Values, frame: int = 0) -> None:
        self._next = frame

    def finish(self) -> None:
        if self._next is None:
            return
        number, self._next = self._next, None
        if number >= len(self._frames):
            raise SceneInvalid(f"frame {number} cannot be computed")
        rows, appearance, count = self._frames[number]
        old = self.data
        self.data.update(
            None if rows is old.rows else rows,
            None if appearance is old.appearance else appearance,
            count,
        )

    def hold_frames(self, frames: int) -> bool:
        return self.holds or frames == 0

    def abandon(self) -> None:
        self._next = None
        self.abandoned += 1

    def interrupt(self) -> None:
        self.interrupted += 1

    def splats(
        self, sh_degree: int | None, antialias: Literal["classic", "mip"] | None
    ) -> SplatSet:
        return SplatSet(self.data, self._transform)

    def shape(self, name: str) -> tuple[int, ...]:
        raise KeyError(name)

    def close(self) -> None:
        """There is nothing to close."""


def requests(count: int, view_camera: Camera | None = None) -> list[FrameRequest]:
    return [FrameRequest(view_camera or camera(), number=number) for number in range(count)]


def frames_of_sudden_growth() -> list[SplatData]:
    """Films of specks of which most touch a tile, until all of them touch nearly every tile."""
    sizes = (0.01, 0.01, 0.01, 0.7, 0.7, 0.01, 0.9, 2.0, 0.01, 0.01)
    return [cloud(400, seed, size=size, thin=0.1) for seed, size in enumerate(sizes)]


def frames_of_growing_count() -> list[SplatData]:
    """The same large Gaussians, of which few are live at first; then other colours alone."""
    data, other = cloud(400, 3, size=0.5), cloud(400, 4)
    counts = (1, 1, 2, 400, 400, 3, 400)
    frames = [SplatData(data.rows, data.appearance, "rgb", count=count) for count in counts]
    return [*frames, SplatData(data.rows, other.appearance, "rgb"), frames[-1]]


def suddenly_at_one_depth() -> list[SplatData]:
    """Clouds, and planes that only a deep sort puts in order."""
    return [cloud(300, 5), cloud(300, 6), plane(seed=7), plane(seed=8), cloud(300, 9)]


def ties_of_arranged_rows() -> list[SplatData]:
    """A still cloud, which is arranged along a curve, and then a plane seen straight on."""
    still = cloud(MIN_ORDERED_ROWS, 10, size=0.01)
    ties = SplatData(still.rows.copy(), still.appearance, "rgb")
    ties.rows[:, 2] = 4
    return [still, still, still, ties, ties, still]


FILMS: dict[str, Callable[[], Steps]] = {
    "sudden": lambda: Steps(frames_of_sudden_growth()),
    "appearing": lambda: Steps(frames_of_growing_count()),
    "deep": lambda: Steps(suddenly_at_one_depth(), turned(1e-7, (1, 2, 0))),
    "tied": lambda: Steps(ties_of_arranged_rows()),
}


@pytest.fixture
def little_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(renderers, "FIRST_PAIR_CAPACITY", 16)


def assert_same(frame: Frame, other: Frame) -> None:
    assert_same_images(frame, other)
    assert (frame.visible, frame.pairs) == (other.visible, other.pairs)


@pytest.mark.usefixtures("little_room")
@pytest.mark.parametrize("in_flight", [2, 3])
@pytest.mark.parametrize("name", FILMS)
def test_pictures_are_those_of_frames_one_by_one(device: Device, name: str, in_flight: int) -> None:
    """Also of frames whose buffers were too small, which are drawn again from their own arrays."""
    alone, source = FILMS[name](), FILMS[name]()
    shots = requests(len(alone._frames))
    one_by_one = Player([alone], renderer=Renderer(device, rasteriser="tiles"), outputs=OUTPUTS)
    expected = [one_by_one.render(shot) for shot in shots]
    film = Player(
        [source],
        renderer=Renderer(device, rasteriser="tiles"),
        outputs=OUTPUTS,
        frames_in_flight=in_flight,
    )
    for played, rendered in zip(film.play(shots), expected, strict=True):
        assert_same(played, rendered)
    assert film.statistics.redrawn > 0
    assert film.statistics.frames == len(shots)
    assert film.statistics.in_flight == in_flight
    rows, appearance, count = source._frames[-1]
    assert source.data.rows is rows  # what was drawn again left no trace
    assert source.data.appearance is appearance
    assert source.data.count == count
    again = film.renderer.render(film.scene, shots[-1].camera, outputs=OUTPUTS)
    assert_same(again, expected[-1])


@pytest.mark.usefixtures("little_room")
def test_sizes_and_bands_may_change_in_flight(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    cameras = [camera(61, 47), camera(61, 47), camera(80, 64), camera(80, 64), camera(40, 300)]
    cameras += [camera(40, 300), camera(61, 47), camera(61, 47)]
    shots = [FrameRequest(view_camera, number=number) for number, view_camera in enumerate(cameras)]
    player = Player(
        [Steps(frames_of_sudden_growth())], renderer=Renderer(device, rasteriser="tiles")
    )
    expected = [player.render(shot) for shot in shots]
    film = Player([Steps(frames_of_sudden_growth())], renderer=Renderer(device, rasteriser="tiles"))
    banded: list[int] = []

    def rows(_renderer: Renderer, _scene: object, view_camera: Camera, _images: int) -> int:
        banded.append(view_camera.height)
        return 128 if view_camera.height == 300 else view_camera.height

    monkeypatch.setattr(Renderer, "_band_rows", rows)
    for played, rendered in zip(film.play(shots), expected, strict=True):
        np.testing.assert_array_equal(played.rgba, rendered.rgba)
    assert 300 in banded


def test_a_frame_is_submitted_before_the_one_before_it_is_read(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    film = Player([Steps(frames_of_sudden_growth())], renderer=Renderer(device, rasteriser="tiles"))
    list(film.play(requests(10)))  # buffers have room for all
    events: list[str] = []
    for owner, name in ((Plan, "submit"), (FrameReadback, "collect")):

        def noted(
            *args: object,
            original: object = getattr(owner, name),
            name: str = name,
            **kwargs: object,
        ) -> object:
            events.append(name)
            return original(*args, **kwargs)

        monkeypatch.setattr(owner, name, noted)
    list(film.play(requests(5)))
    assert events == ["submit", *["submit", "collect"] * 4, "collect"]
    events.clear()
    film._frames_in_flight = 1
    list(film.play(requests(3)))
    assert events == ["submit", "collect"] * 3


def test_a_read_waits_for_its_own_frame_alone(device: Device) -> None:
    """Where it waited for all submitted work, the second read would have nothing to wait for."""
    renderer, source = Renderer(device, rasteriser="tiles"), Steps([cloud(60_000, size=0.3)] * 2)
    film = Player([source], renderer=renderer)
    view = camera(640, 480, fx=500, fy=500)
    expected = film.render(FrameRequest(view, number=0)).rgba
    renderer.collect(renderer.submit(film.scene, view))
    waited = np.zeros(2)
    for _ in range(3):
        first = renderer.submit(film.scene, view)
        time.sleep(0.1)  # on a busy machine wgpu may begin to wait late, and then for both
        second = renderer.submit(film.scene, view)
        for number, submitted in enumerate((first, second)):
            start_time = time.perf_counter()
            frame = renderer.collect(submitted)
            waited[number] += time.perf_counter() - start_time
            assert frame is not None
            np.testing.assert_array_equal(frame.rgba, expected)
    assert waited[0] < waited[1]


def test_no_buffer_is_made_once_frames_are_in_flight(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    film = Player([Steps(frames_of_sudden_growth())], renderer=Renderer(device, rasteriser="tiles"))
    frames = film.play(requests(9) + requests(9))
    for _ in range(9):
        next(frames)
    result = watched(device, monkeypatch)
    assert len(list(frames)) == 9
    assert "create_buffer" not in result


def test_a_source_that_cannot_hold_its_arrays_is_waited_for(device: Device) -> None:
    source = Steps(frames_of_sudden_growth())
    source.holds = False
    film = Player([source], renderer=Renderer(device, rasteriser="tiles"))
    list(film.play(requests(4)))
    assert film.statistics.in_flight == 1


def failing(shots: Sequence[FrameRequest]) -> Iterator[FrameRequest]:
    yield from shots
    raise SceneInvalid("no more requests")


def test_frames_before_an_error_come_first(device: Device) -> None:
    film = Player([Steps(frames_of_sudden_growth())], renderer=Renderer(device, rasteriser="tiles"))
    expected = [film.render(shot) for shot in requests(10)]
    frames = film.play(requests(11))
    for rendered in expected:
        np.testing.assert_array_equal(next(frames).rgba, rendered.rgba)
    with pytest.raises(SceneInvalid, match="frame 10 cannot be computed"):
        next(frames)
    assert list(frames) == []
    # The request before the failing one waits for its successor, as it always did.
    frames = film.play(failing(requests(5)))
    for rendered in expected[:4]:
        np.testing.assert_array_equal(next(frames).rgba, rendered.rgba)
    with pytest.raises(SceneInvalid, match="no more requests"):
        next(frames)


def test_frames_before_one_that_cannot_be_drawn_come_first(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    film = Player([Steps(frames_of_sudden_growth())], renderer=Renderer(device, rasteriser="tiles"))
    expected = [film.render(shot) for shot in requests(2)]
    submit = Renderer.submit

    def refusing(renderer: Renderer, *args: object, **kwargs: object) -> object:
        if film.statistics.frames + 1 == len(expected):
            raise CapacityExceeded("too many splats")
        return submit(renderer, *args, **kwargs)

    monkeypatch.setattr(Renderer, "submit", refusing)
    frames = film.play(requests(6))
    for rendered in expected:
        np.testing.assert_array_equal(next(frames).rgba, rendered.rgba)
    with pytest.raises(CapacityExceeded, match="too many splats"):
        next(frames)


def test_without_memory_a_frame_waits_for_those_in_flight(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    film = Player([Steps(frames_of_sudden_growth())], renderer=Renderer(device, rasteriser="tiles"))
    expected = [film.render(shot).rgba for shot in requests(6)]
    submit, calls = Renderer.submit, list[int]()

    def refusing(renderer: Renderer, *args: object, **kwargs: object) -> object:
        calls.append(0)
        if len(calls) == 3:
            raise MemoryFull("the memory is full")
        return submit(renderer, *args, **kwargs)

    monkeypatch.setattr(Renderer, "submit", refusing)
    played = [frame.rgba for frame in film.play(requests(6))]
    np.testing.assert_array_equal(played, expected)
    assert len(calls) == 3  # from then on, each frame is waited for


def test_film_can_be_closed_with_frames_in_flight(device: Device) -> None:
    source = Steps(frames_of_sudden_growth())
    film = Player([source], renderer=Renderer(device, rasteriser="tiles"))
    expected = [film.render(shot).rgba for shot in requests(10)]
    for close_frames in (
        lambda frames: frames.close(),
        lambda frames: frames.throw(KeyboardInterrupt),
    ):
        frames = film.play(requests(10))
        next(frames)
        next(frames)
        before = source.abandoned
        try:
            close_frames(frames)
        except KeyboardInterrupt:
            assert source.interrupted == 1
        assert source.abandoned > before
        assert list(frames) == []
        played = [frame.rgba for frame in film.play(requests(10))]
        np.testing.assert_array_equal(played, expected)
    assert source.interrupted == 1


def test_statistics_report_waiting_and_growth(
    device: Device, little_room: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    film = Player([Steps(frames_of_sudden_growth())], renderer=Renderer(device, rasteriser="tiles"))
    list(film.play(requests(10)))
    statistics = film.statistics
    assert (statistics.frames, statistics.in_flight) == (10, 2)
    assert 2 <= statistics.growths <= film.renderer.growths
    assert statistics.redrawn >= 2
    assert statistics.waited > 0
    list(film.play(requests(10)))  # now there is room
    assert film.statistics is not statistics
    assert (film.statistics.growths, film.statistics.redrawn) == (0, 0)
    with pytest.raises(ConfigInvalid, match="is 0, expected at least 1"):
        Player([Steps(frames_of_sudden_growth())], renderer=film.renderer, frames_in_flight=0)
