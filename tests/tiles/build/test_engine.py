"""Engines: every task once, errors as they are, and workers that die."""

import os
import signal
from pathlib import Path

import pytest

from gsgen.contract.errors import ConfigInvalid, InputUnreadable
from gsgen.tiles.build.engines.engine import EngineFailed
from gsgen.tiles.build.engines.opening import open_engine

ENGINES = ["serial", "processes", "dask"]


def square(number: int) -> int:
    return number * number


def refuse(number: int) -> int:
    if number == 2:
        raise InputUnreadable("is broken", where="file 2", hint="mend it")
    return number


def die_once(path: str) -> str:
    marker = Path(path)
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return path


def kill_worker(number: int) -> int:
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


@pytest.fixture(params=ENGINES)
def engine(request):
    if request.param == "dask":
        pytest.importorskip("distributed")
    return request.param


def test_every_task_has_its_result(engine):
    with open_engine(engine, 2) as running:
        for count in (0, 1, 7):
            results = dict(running.run(square, range(count)))
            assert results == {index: index * index for index in range(count)}


def test_an_error_of_a_task_keeps_its_fields(engine):
    with open_engine(engine, 1) as running, pytest.raises(InputUnreadable) as caught:
        list(running.run(refuse, range(4)))
    assert str(caught.value) == "file 2: is broken\n  mend it"


@pytest.mark.parametrize("engine", ENGINES[1:], indirect=True)
def test_a_task_whose_worker_was_killed_is_run_again(engine, tmp_path):
    tasks = [str(tmp_path / str(index)) for index in range(3)]
    with open_engine(engine, 2) as running:
        assert dict(running.run(die_once, tasks)) == dict(enumerate(tasks))


@pytest.mark.parametrize("engine", ENGINES[1:], indirect=True)
def test_workers_that_die_again_and_again_end_the_build(engine):
    with open_engine(engine, 1) as running, pytest.raises(EngineFailed, match="died"):
        list(running.run(kill_worker, range(3)))


def test_unknown_or_missing_engine_is_named(monkeypatch):
    for name in ("threads", "cloud", "local"):  # before, between and after known names
        with pytest.raises(ConfigInvalid, match=f"unknown engine '{name}'"):
            open_engine(name)
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(ConfigInvalid, match=r"gsgen\[cluster\]|needs distributed"):
        open_engine("dask")
