"""A confined session computes what one in the process computes, and ends at its limits."""

import gc
import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from gsgen.contract.errors import HostProcessFailed, UnknownName
from gsgen.contract.process.limits import Limits
from gsgen.sdk.binding import FrameSession, InputInvalid, RunFailed, SessionClosed, Stop
from gsgen.sdk.binding.confined.models import ConfinedModels
from support.models.endless import endless
from support.models.hostile import HOSTILE

SECONDS = 1.0  # limit of a frame


def process_ids() -> set[int]:
    """Return the ids of the children of this process."""
    return {
        int(pid)
        for pid in Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()
    }


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("models")


@pytest.fixture(scope="module")
def endless_model(folder: Path) -> Path:
    """A generator whose frames never end where the time is beyond 0.5."""
    return endless(folder, after=0.5)


@pytest.fixture(scope="module")
def confined(folder: Path, models: dict[str, Path]) -> Iterator[ConfinedModels]:
    """One process for the models that behave."""
    paths = [models["drift-float32"], models["look-float16"], models["look-row"]]
    before = process_ids()
    with ConfinedModels(paths) as processes:
        yield processes
    assert process_ids() <= before


@pytest.mark.parametrize("name", ["drift-float32", "look-float16", "look-row"])
def test_frames_of_a_confined_session_equal_those_in_the_process(
    models: dict[str, Path], confined: ConfinedModels, name: str
) -> None:
    with (
        FrameSession(models[name], provider="cpu") as plain,
        FrameSession(models[name], provider="cpu", confined=confined) as session,
    ):
        facts = ("manifest", "provider", "reason", "device", "nodes", "captured", "cause")
        assert all(getattr(session, fact) == getattr(plain, fact) for fact in facts)
        assert session.inputs == plain.inputs
        for inputs in (*plain.samples(), {}):
            for each_session in (plain, session):
                each_session.write(inputs)
            expected, actual = plain.run(), session.run()
            assert list(actual) == list(expected)
            for output in expected:
                assert actual[output].dtype == expected[output].dtype
                assert actual[output].tobytes() == expected[output].tobytes()
            assert actual.count == expected.count


def test_named_models_share_a_process_and_another_gets_its_own(
    models: dict[str, Path], confined: ConfinedModels, endless_model: Path
) -> None:
    before = process_ids()
    with FrameSession(models["drift-float32"], provider="cpu", confined=confined):
        assert process_ids() == before
        with FrameSession(endless_model, provider="cpu", confined=confined):
            assert len(process_ids() - before) == 1
        assert process_ids() == before


def test_errors_of_values_and_sizes_are_those_of_the_process(
    models: dict[str, Path], confined: ConfinedModels
) -> None:
    path = models["drift-float32"]
    with FrameSession(path, provider="cpu", confined=confined) as session:
        with pytest.raises(InputInvalid):
            session.run({"time": 7.0})
        with pytest.raises(UnknownName):
            session.run({"tim": 0.0})
        with pytest.raises(RunFailed, match="OrtValue"):
            session.run().handle("gaussians")
    with pytest.raises(SessionClosed):
        session.run()
    with pytest.raises(UnknownName, match="provider"):
        FrameSession(path, provider="tpu", confined=confined)


def test_a_frame_that_never_ends_fails_at_the_time_limit(endless_model: Path) -> None:
    before = process_ids()
    with ConfinedModels([endless_model], Limits(seconds=SECONDS)) as processes:
        session = FrameSession(endless_model, provider="cpu", confined=processes)
        start = time.monotonic()
        with pytest.raises(RunFailed, match=r"a frame takes more than 1 s") as caught:
            session.run({"time": 1.0})
        assert time.monotonic() - start < SECONDS + 1
        assert caught.value.where == str(endless_model)
        assert process_ids() == before
        with pytest.raises(RunFailed):
            session.run({"time": 0.0})


def test_an_interrupted_frame_fails_and_the_session_goes_on(endless_model: Path) -> None:
    stop = Stop()
    with FrameSession(endless_model, provider="cpu", confined=True, stop=stop) as session:
        threading.Timer(0.2, stop.now).start()
        with pytest.raises(RunFailed, match="terminate flag"):
            session.run({"time": 1.0})
        stop.reset()
        assert session.run({"time": 0.0}).count > 0


def test_a_frame_that_begins_while_stopped_fails(endless_model: Path) -> None:
    """A request to stop may come before the frame does, by another thread."""
    stop = Stop()
    with FrameSession(endless_model, provider="cpu", confined=True, stop=stop) as session:
        stop.now()
        with pytest.raises(RunFailed, match="terminate flag"):
            session.run({"time": 1.0})
        stop.reset()
        assert session.run({"time": 0.0}).count > 0


def test_a_process_killed_from_outside_is_a_fault_of_the_host(models: dict[str, Path]) -> None:
    before = process_ids()
    with FrameSession(models["drift-float32"], provider="cpu", confined=True) as session:
        (child,) = process_ids() - before
        os.kill(child, signal.SIGKILL)
        with pytest.raises(HostProcessFailed, match="killed by SIGKILL") as caught:
            session.run()
        assert caught.value.exit_code == 2


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_model_ends_at_a_limit_with_one_line(tmp_path: Path, name: str) -> None:
    path = HOSTILE[name](tmp_path)
    start = time.monotonic()
    with (
        ConfinedModels([path], Limits(seconds=4)) as processes,
        pytest.raises(RunFailed, match=r"time limit|memory limit") as caught,
    ):
        FrameSession(path, provider="cpu", confined=processes)
    assert time.monotonic() - start < 12
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_processes_end_with_their_last_session(models: dict[str, Path]) -> None:
    before = process_ids()
    path = models["drift-float32"]
    session = FrameSession(path, provider="cpu", confined=ConfinedModels([path]))
    gc.collect()
    assert session.run().count > 0
    session.close()
    del session
    gc.collect()
    assert process_ids() <= before


def test_a_session_whose_process_was_closed_says_so(models: dict[str, Path]) -> None:
    with ConfinedModels([models["drift-float32"]]) as processes:
        session = FrameSession(models["drift-float32"], provider="cpu", confined=processes)
    with pytest.raises(SessionClosed, match="was closed"):
        session.run()
