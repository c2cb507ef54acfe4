"""A player computes the next frame while it draws the present one, and uploads what changed."""

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.moving import drifting_model
from gsgen.contract.errors import GsgenError, UnknownName
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.playback.player import FrameRequest, GeneratorPlayer, Player
from gsgen.runtime.renderer.frame_images import FrameReadback
from gsgen.runtime.renderer.frame_plan import Plan
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.generator_worker import _OutputBuffer
from gsgen.runtime.sources.source import GeneratorSource
from gsgen.sdk.binding import FrameSession, InputInvalid
from support.rendering.watched_device import watched

CAMERA = Camera.orbit((0, 0, 0), 4, width=48, height=32)
TIMES = (0.0, 0.5, 1.0, 0.25)
LONG_FRAMES = 30  # seconds that a test waits for what must happen at once


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(Device.open(), rasteriser="tiles")


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("models")
    for name in ("drift", "growing", "appearance_id", "fade_column", "ignored_time", "avatar"):
        find(name).write(folder)
    fading = drifting_model().replace_text(
        "color = Identity (colors)", "color = Add (colors, time)"
    )
    fading.write(folder / "all_changing.onnx")
    return folder


@pytest.fixture
def drift(models: Path, renderer: Renderer) -> Iterator[GeneratorPlayer]:
    with GeneratorPlayer(
        models / "drift.onnx", provider="cpu", renderer=renderer
    ) as generator_player:
        yield generator_player


def test_played_frames_equal_single_runs(drift: GeneratorPlayer) -> None:
    alone = [drift.render(CAMERA, time=time).rgba for time in TIMES]
    played = [frame.rgba for frame in drift.play(CAMERA, times=TIMES)]
    assert len(played) == len(TIMES)
    assert not np.array_equal(alone[0], alone[1])
    for first, other in zip(alone, played, strict=True):
        assert np.array_equal(first, other)


def test_frames_of_a_confined_player_equal_those_of_the_process(
    drift: GeneratorPlayer, models: Path, renderer: Renderer
) -> None:
    expected = [frame.rgba for frame in drift.play(CAMERA, times=TIMES)]
    with GeneratorPlayer(
        models / "drift.onnx", provider="cpu", renderer=renderer, confined=True
    ) as player:
        actual = [frame.rgba for frame in player.play(CAMERA, times=TIMES)]
    assert all(np.array_equal(a, b) for a, b in zip(actual, expected, strict=True))


def test_the_next_frame_is_computed_while_one_is_drawn(
    drift: GeneratorPlayer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither ends before the other has begun: without overlap, one would wait for ever."""
    inferring, drawing = ([threading.Event() for _ in TIMES] for _ in range(2))
    run, submit, collect = FrameSession.run, Plan.submit, FrameReadback.collect
    events: list[str] = []

    def began(name: str) -> int:
        events.append(name)
        return events.count(name) - 1

    def watched_run(self: FrameSession, *args: object, **kwargs: object) -> object:
        frame = began("run")
        inferring[frame].set()
        if frame > 0:
            assert drawing[frame - 1].wait(LONG_FRAMES), "nobody draws the frame before"
        return run(self, *args, **kwargs)

    def watched_submit(self: Plan, *args: object, **kwargs: object) -> None:
        drawing[began("submit")].set()
        submit(self, *args, **kwargs)

    def watched_collect(self: FrameReadback, *args: object, **kwargs: object) -> object:
        frame = began("collect")
        if frame + 1 < len(TIMES):
            assert drawing[frame + 1].is_set(), "the next frame is not in flight"
        if frame + 2 < len(TIMES):
            assert inferring[frame + 2].wait(LONG_FRAMES), (
                "nobody computes the frame after the next"
            )
        return collect(self, *args, **kwargs)

    list(drift.play(CAMERA, times=[0.75]))  # so that no frame below is as the one before
    monkeypatch.setattr(FrameSession, "run", watched_run)
    monkeypatch.setattr(Plan, "submit", watched_submit)
    monkeypatch.setattr(FrameReadback, "collect", watched_collect)
    assert len(list(drift.play(CAMERA, times=TIMES))) == len(TIMES)
    assert [events.count(name) for name in ("run", "submit", "collect")] == [4, 4, 4]


def test_sequential_playback_has_no_overlap(
    drift: GeneratorPlayer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the test above would see of a player that waits."""
    events: list[str] = []
    for owner, name in ((FrameSession, "run"), (Plan, "submit"), (Plan, "collect")):

        def noted(
            *args: object,
            original: object = getattr(owner, name),
            name: str = name,
            **kwargs: object,
        ) -> object:
            events.append(name)
            return original(*args, **kwargs)

        monkeypatch.setattr(owner, name, noted)
    for time in TIMES:
        drift.render(CAMERA, time=time)
    assert events[-6:] == ["run", "submit", "collect"] * 2


class Uploads:
    """Bytes that reach the rows and the appearance of Gaussians, and runs of the model."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.bytes = {"rows": 0, "appearance": 0}
        self.runs = 0
        write, run = Device.write, FrameSession.run

        def watched_write(device: Device, buffer: object, data: object, *kwargs: int) -> None:
            if buffer.label in self.bytes:
                self.bytes[buffer.label] += data.nbytes
            write(device, buffer, data, *kwargs)

        def watched_run(session: FrameSession, *args: object, **kwargs: object) -> object:
            self.runs += 1
            return run(session, *args, **kwargs)

        monkeypatch.setattr(Device, "write", watched_write)
        monkeypatch.setattr(FrameSession, "run", watched_run)


ROW, COLOR = 40, 16  # bytes of a Gaussian; three colours are filled up to a word


@pytest.mark.parametrize(
    ("model", "values", "runs", "rows", "appearance"),
    [
        ("drift", [{"time": t} for t in (0.2, 0.4, 0.6)], 3, 15, 0),
        ("all_changing", [{"time": t} for t in (0.2, 0.4, 0.6)], 3, 15, 15),
        ("drift", [{"time": 0.3}] * 3, 1, 5, 0),
        ("drift", [{}] * 3, 0, 0, 0),
        ("appearance_id", [{"look": k} for k in (1, 2, 3)], 3, 0, 15),
        ("ignored_time", [{"time": t} for t in (0.2, 0.4, 0.6)], 0, 0, 0),
        ("fade_column", [{}] * 3, 3, 15, 0),  # the camera moves
    ],
)
def test_unchanged_outputs_are_neither_computed_nor_uploaded(
    models: Path,
    renderer: Renderer,
    monkeypatch: pytest.MonkeyPatch,
    model: str,
    values: list[dict],
    runs: int,
    rows: int,
    appearance: int,
) -> None:
    cameras = [Camera.orbit((0, 0, 0), 4, azimuth=a, width=48, height=32) for a in range(4)]
    path = models / f"{model}.onnx"
    with GeneratorPlayer(path, provider="cpu", renderer=renderer) as player:
        list(player.play(cameras[:1] * 3))  # buffers for all frames in flight are made
        uploads = Uploads(monkeypatch)
        result = watched(renderer.device, monkeypatch)
        frames = list(player.play(cameras[1:], values=values))
    assert len(frames) == 3
    assert uploads.runs == runs
    assert uploads.bytes == {"rows": rows * ROW, "appearance": appearance * COLOR}
    assert result == []


def test_a_count_that_changes_alone_uploads_nothing(
    tmp_path: Path, renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows stay, and fewer or more of them are live."""
    counted = (
        find("growing")
        .draw()
        .replace_text("seen = Mul (opacity, mask)", "seen = Mul (opacity, opacity)")
    )
    counted = counted.replace_text("shift = Mul (speed, time)", "shift = Sub (speed, speed)")
    path = tmp_path / "counted.onnx"
    counted.write(path)
    with GeneratorPlayer(path, provider="cpu", renderer=renderer) as player:
        complete_frame = player.render(CAMERA, time=1.0)
        uploads = Uploads(monkeypatch)
        visible_counts = [
            frame.visible for frame in player.play(CAMERA, times=(0.5, 0.9, 0.65, 1.0))
        ]
        again = player.render(CAMERA, time=1.0)
    assert visible_counts == [2, 4, 3, 5]
    assert uploads.runs == 4
    assert uploads.bytes == {"rows": 0, "appearance": 0}
    assert np.array_equal(complete_frame.rgba, again.rgba)


def test_rows_behind_the_count_are_not_drawn_though_their_values_stay(
    models: Path, renderer: Renderer
) -> None:
    path = models / "growing.onnx"
    with GeneratorPlayer(path, provider="cpu", renderer=renderer) as player:
        played = [frame.rgba for frame in player.play(CAMERA, times=(1.0, 0.5, 1.0, 0.7))]
        assert player.source.data.count == 3
    for image, time in zip(played, (1.0, 0.5, 1.0, 0.7), strict=True):
        with GeneratorPlayer(path, provider="cpu", renderer=renderer) as fresh:
            assert np.array_equal(fresh.render(CAMERA, time=time).rgba, image)


def test_errors_name_model_input_and_frame(drift: GeneratorPlayer, models: Path) -> None:
    name = models / "drift.onnx"
    frames = drift.play(CAMERA, times=(0.0, 0.5, 7.0, 0.2))
    assert [next(frames).visible for _ in range(2)] == [5, 5]
    with pytest.raises(InputInvalid) as raised:
        next(frames)
    assert str(raised.value) == f"{name}, frame 2, input time: the value is 7, expected 0 … 1"
    with pytest.raises(UnknownName) as unknown:
        drift.render(CAMERA, pose=np.zeros((4, 3)))
    assert str(unknown.value).startswith(f"{name}, frame 3: unknown input 'pose'")
    assert drift.render(CAMERA, time=0.5).visible == 5  # it goes on


def test_a_film_that_is_left_early_leaves_no_trace(drift: GeneratorPlayer) -> None:
    expected = drift.render(CAMERA, time=0.5).rgba
    frames = drift.play(CAMERA, times=(0.1, 7.0, 0.2))
    next(frames)
    frames.close()  # what is wrong with the second frame concerns nobody
    frames = drift.play(CAMERA, times=(0.3, 0.9))
    next(frames)
    frames.close()
    assert np.array_equal(drift.render(CAMERA, time=0.5).rgba, expected)


def test_several_sources_play_together(models: Path, renderer: Renderer) -> None:
    paths = [models / name for name in ("drift.onnx", "avatar.onnx")]
    sources = [GeneratorSource(path) for path in paths]
    player = Player(sources, renderer=renderer)
    pose = np.full((4, 3), 0.2)
    shots = [FrameRequest(CAMERA, ({"time": t}, {"pose": t * pose})) for t in TIMES]
    alone = [player.render(shot).rgba for shot in shots]
    played = [frame.rgba for frame in player.play(shots)]
    assert all(np.array_equal(*pair) for pair in zip(alone, played, strict=True))
    assert not np.array_equal(alone[0], alone[1])
    with pytest.raises(GsgenError, match=r"avatar\.onnx, frame 8, input pose: the value has shape"):
        player.render(FrameRequest(CAMERA, ({}, {"pose": np.zeros((3, 3))})))
    with pytest.raises(GsgenError, match=r"drift\.onnx, frame 42, input time: the value is 7"):
        player.render(FrameRequest(CAMERA, ({"time": 7},), number=42))
    for source in sources:
        source.close()


def test_cameras_and_values_end_with_the_shortest(drift: GeneratorPlayer) -> None:
    cameras = [Camera.orbit((0, 0, 0), 4, azimuth=a, width=48, height=32) for a in (0, 9)]
    assert len(list(drift.play(cameras))) == 2
    assert len(list(drift.play(CAMERA))) == 1
    assert len(list(drift.play(cameras, times=TIMES))) == 2
    assert len(list(drift.play(CAMERA, values=[{"time": 0.5}] * 3))) == 3
    assert list(drift.play([])) == []


def test_other_kinds_of_model_are_refused(tmp_path: Path, renderer: Renderer) -> None:
    path = find("post_process").write(tmp_path)
    before = threading.active_count()
    with pytest.raises(SceneInvalid, match="is a post-process, expected a gaussian-generator"):
        GeneratorPlayer(path, provider="cpu", renderer=renderer)
    assert threading.active_count() == before


def test_closing_twice_does_no_harm_and_ends_the_thread(models: Path, renderer: Renderer) -> None:
    before = threading.active_count()
    player = GeneratorPlayer(models / "drift.onnx", provider="cpu", renderer=renderer)
    assert threading.active_count() == before + 1
    player.render(CAMERA)
    player.close()
    player.close()
    assert threading.active_count() == before
    with pytest.raises(GsgenError, match="closed"):
        player.render(CAMERA)


def test_cells_of_a_generator_are_summed_by_weights(
    tmp_path: Path, renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = find("weighted_sum").write(tmp_path)
    with FrameSession(path, provider="cpu") as session:
        frame = session.run(copy=True)
        outputs, weighted = session.manifest.outputs, session.manifest.weighted_sum
        data = SplatData(
            frame[outputs.gaussians.name],
            frame[outputs.appearance.name],
            outputs.appearance.space,
            count=frame.count,
            cells=frame[outputs.cells.name],
            per_cell=outputs.cells.per_cell,
        )
    expected = renderer.render(Scene([SplatSet(data, weighted=weighted)]), CAMERA)
    sorted_ = renderer.render(Scene([data]), CAMERA)
    with GeneratorPlayer(path, provider="cpu", renderer=renderer) as player:
        assert np.array_equal(player.render(CAMERA).rgba, expected.rgba)
        assert not np.array_equal(expected.rgba, sorted_.rgba)
        uploads = Uploads(monkeypatch)
        uploads.bytes["cells"] = 0
        player.render(CAMERA)
    assert set(uploads.bytes.values()) == {0}


def test_held_outputs_stay_for_as_many_more_frames() -> None:
    retained, rows = _OutputBuffer(), np.zeros((4, 10), np.float32)
    results = []
    for number in range(7):
        results.append(retained.take(rows + number, None, retained=1))
        for back in range(min(number, 2) + 1):
            assert np.all(results[number - back] == number - back)
    assert len(set(map(id, results))) == 3


def test_live_rows_of_outputs_are_compared_bit_by_bit() -> None:
    rows = np.arange(40, dtype=np.float32).reshape(4, 10)
    output_buffer = _OutputBuffer()
    first = output_buffer.take(rows, 3)
    assert first is not None
    assert output_buffer.take(rows.copy(), 3) is None
    other = rows.copy()
    other[3] = 7  # behind the count
    assert output_buffer.take(other, 3) is None
    assert output_buffer.take(other, 2) is None
    assert np.array_equal(output_buffer.take(other, 4), other)  # more than were there
    zero = other.copy()
    zero[0, 0] = -0.0  # equal, and not the same
    second = output_buffer.take(zero, 4)
    assert second is not None
    assert np.signbit(second[0, 0])
    zero[1, 1] = np.nan
    third = output_buffer.take(zero, 4)
    assert third is not None
    assert output_buffer.take(zero.copy(), 4) is None  # NaN is itself
    assert output_buffer.take(zero, 0) is None
    assert np.signbit(second[0, 0])  # what is drawn stays while the next is written


def test_a_constant_output_is_copied_once() -> None:
    rows = np.ones((4, 10), np.float32)
    output_buffer = _OutputBuffer()
    assert np.array_equal(output_buffer.take(rows, 3, is_constant=True)[:3], rows[:3])
    assert output_buffer.take(rows, 3, is_constant=True) is None
    assert np.array_equal(output_buffer.take(rows, 4, is_constant=True), rows)  # more rows are live


def test_a_long_output_is_compared_to_its_end() -> None:
    for dtype in (np.float32, np.float16):
        rows = np.ones((30_000, 10), dtype)
        output_buffer = _OutputBuffer()
        output_buffer.take(rows, None)
        rows[-1, -1] = 2
        assert np.array_equal(output_buffer.take(rows, None), rows)
        assert output_buffer.take(rows, None) is None
