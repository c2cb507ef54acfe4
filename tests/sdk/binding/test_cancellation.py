"""A run is ended from another thread, whether the session is open already or not."""

import threading
from pathlib import Path

import pytest

from gsgen.sdk.binding import FrameSession, RunFailed, Stop
from support.models.endless import endless

MAX_SECONDS = 0.2


def test_a_run_is_ended_and_the_session_goes_on(tmp_path: Path) -> None:
    stop = Stop()
    with FrameSession(endless(tmp_path, after=0.5), provider="cpu", stop=stop) as session:
        threading.Timer(MAX_SECONDS, stop.now).start()
        with pytest.raises(RunFailed, match="terminate flag"):
            session.run({"time": 1.0})
        with pytest.raises(RunFailed, match="terminate flag"):
            session.run({"time": 0.0})  # until somebody says otherwise
        stop.reset()
        assert session.run({"time": 0.0}).count > 0


def test_a_session_that_never_opens_is_ended(tmp_path: Path) -> None:
    stop = Stop()
    threading.Timer(MAX_SECONDS, stop.now).start()
    with pytest.raises(RunFailed, match="terminate flag"):
        FrameSession(endless(tmp_path, after=-1.0), provider="cpu", stop=stop)
