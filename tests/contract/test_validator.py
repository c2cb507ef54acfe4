"""Several files: how processes end when the user stops them."""

import multiprocessing
import time
from pathlib import Path

import pytest

from gsgen.contract._worker_pool import validate_in_processes
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.validation.report import Entry
from gsgen.contract.validation.settings import Settings

DURATION = 20.0


def write_slowly(path: Path, settings: Settings) -> Entry:
    """Return at once for the first file; write a file after a while for others."""
    if path.name != "first":
        time.sleep(DURATION)
        path.write_text("the worker ended by itself")
    return path  # type: ignore[return-value]


def test_workers_and_no_other_children_end_when_the_user_interrupts(tmp_path: Path) -> None:
    other = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(DURATION,))
    other.start()
    others = multiprocessing.active_children()

    def interrupt(text: str) -> None:
        raise KeyboardInterrupt

    paths = [tmp_path / "first", tmp_path / "second"]
    with pytest.raises(KeyboardInterrupt):
        validate_in_processes(write_slowly, installed_rules, paths, Settings(), 2, interrupt)
    for process in set(multiprocessing.active_children()).difference(others):
        process.join()
    assert not paths[1].exists()
    assert other.is_alive()
    other.terminate()
    other.join()
