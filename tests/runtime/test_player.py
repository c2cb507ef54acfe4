"""A player computes the next frame while it draws the present one, and uploads what changed."""

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures import find
from gsgen.contract.errors import GsgenError, UnknownName
from gsgen.runtime.camera import Camera
from gsgen.runtime.device import Device
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.plan import Plan
from gsgen.runtime.player import GeneratorPlayer, Player, Shot
from gsgen.runtime.renderer import Renderer
from gsgen.runtime.sources import GeneratorSource
from gsgen.sdk.binding import FrameSession, InputInvalid

CAMERA = Camera.orbit((0, 0, 0), 4, width=48, height=32)
TIMES = (0.0, 0.5, 1.0, 0.25)
LONG = 30  # seconds that a test waits for what must happen at once


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(Device.open())


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("models")
    for name in (
        "drift",
        "growing",
        "appearance_id",
        "fade_column",
        "ignored_time",
        "avatar",
    ):
        find(name).write(folder)
    return folder


@pytest.fixture
def drift(models: Path, renderer: Renderer) -> Iterator[GeneratorPlayer]:
    with GeneratorPlayer(models / "drift.onnx", provider="cpu", renderer=renderer) as made:
        yield made


def test_frames_are_those_that_come_one_by_one(drift: GeneratorPlayer) -> None:
    alone = [drift.render(CAMERA, time=time).rgba for time in TIMES]
    played = [frame.rgba for frame in drift.play(CAMERA, times=TIMES)]
    assert len(played) == len(TIMES)
    assert not np.array_equal(alone[0], alone[1])
    for one, other in zip(alone, played, strict=True):
        assert np.array_equal(one, other)


def test_the_next_frame_is_computed_while_one_is_drawn(
    drift: GeneratorPlayer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither ends before the other has begun: without overlap, one would wait for ever."""
    inferring, drawing = ([threading.Event() for _ in TIMES] for _ in range(2))
    run, submit, collect = FrameSession.run, Plan.submit, Plan.collect
    events: list[str] = []

    def began(name: str) -> int:
        events.append(name)
        return events.count(name) - 1

    def watched_run(self: FrameSession, *args: object, **rest: object) -> object:
        frame = began("run")
        inferring[frame].set()
        if frame > 0:
            assert drawing[frame - 1].wait(LONG), "nobody draws the frame before"
        return run(self, *args, **rest)

    def watched_submit(self: Plan, *args: object, **rest: object) -> None:
        drawing[began("submit")].set()
        submit(self, *args, **rest)

    def watched_collect(self: Plan) -> object:
        frame = began("collect")
        if frame + 1 < len(TIMES):
            assert inferring[frame + 1].wait(LONG), "nobody computes the next frame"
        return collect(self)

    drift.render(CAMERA, time=0.75)  # so that no frame below is as the one before
    monkeypatch.setattr(FrameSession, "run", watched_run)
    monkeypatch.setattr(Plan, "submit", watched_submit)
    monkeypatch.setattr(Plan, "collect", watched_collect)
    assert len(list(drift.play(CAMERA, times=TIMES))) == len(TIMES)
    assert [events.count(name) for name in ("run", "submit", "collect")] == [4, 4, 4]


def test_one_by_one_nothing_overlaps(
    drift: GeneratorPlayer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the test above would see of a player that waits."""
    events: list[str] = []
    for owner, name in ((FrameSession, "run"), (Plan, "submit"), (Plan, "collect")):

        def watched(
            *args: object,
            plain: object = getattr(owner, name),
            name: str = name,
            **rest: object,
        ) -> object:
            events.append(name)
            return plain(*args, **rest)

        monkeypatch.setattr(owner, name, watched)
    for time in TIMES:
        drift.render(CAMERA, time=time)
    assert events[-6:] == ["run", "submit", "collect"] * 2
