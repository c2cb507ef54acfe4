"""Runs functions, and the child processes of gsgen, in forks of this process.

A child process starts Python and imports its libraries: 0.3 s of processor time, which a run over
thousands of models pays thousands of times. A fork has them, and confines itself alike.
"""

import importlib
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TypeVar

from onnx import ModelProto

from gsgen.contract.model import shape_inference
from gsgen.contract.probing import sandbox

_FORK = multiprocessing.get_context("fork")
Item, Result = TypeVar("Item"), TypeVar("Result")


def results_of_forks(
    function: Callable[[Item], Result], items: Sequence[Item], seconds: float
) -> Iterator[Result | str]:
    """Yield a function's result for each item, from one fork as long as it lives.

    The item at which it ends, or that takes longer than ``seconds``, gets a text that says so, and
    another fork goes on with the next one.
    """
    done = 0
    while done < len(items):
        receiver, sender = _FORK.Pipe(duplex=False)
        process = _FORK.Process(target=_send_results, args=(function, items[done:], sender))
        process.start()
        sender.close()
        try:
            while done < len(items):
                done += 1
                if not receiver.poll(seconds):
                    yield f"still running after {seconds:g} s"
                    break
                yield receiver.recv()
        except EOFError:
            process.join()
            yield f"ended with status {process.exitcode}"
        finally:
            process.kill()
            process.join()
            receiver.close()


def _send_results(
    function: Callable[[Item], Result], items: Sequence[Item], sender: Connection
) -> None:
    for item in items:
        sender.send(function(item))


@contextmanager
def forked_children() -> Iterator[None]:
    """Let the children that run models and infer shapes be forks within the block."""
    run_child, propagate = sandbox._run_child, shape_inference._propagate_in_subprocess
    sandbox._run_child, shape_inference._propagate_in_subprocess = _run_forked, _propagate_in_fork
    try:
        yield
    finally:
        sandbox._run_child, shape_inference._propagate_in_subprocess = run_child, propagate


def _run_forked(folder: Path, seconds: float, worker: str) -> sandbox._ProcessEnd:
    process = _FORK.Process(target=_work, args=(folder, worker))
    process.start()
    process.join(seconds)
    status = process.exitcode
    process.kill()
    process.join()
    return sandbox._ProcessEnd(status, "")


def _work(folder: Path, worker: str) -> None:
    log = os.open(folder / "log", os.O_WRONLY | os.O_CREAT)
    os.dup2(log, 1)
    os.dup2(log, 2)
    raise SystemExit(importlib.import_module(worker).main(folder))


def _propagate_in_fork(proto: ModelProto) -> ModelProto | None:
    (result,) = results_of_forks(_propagated, [proto], shape_inference._MAX_SECONDS)
    return None if isinstance(result, str) else result


def _propagated(proto: ModelProto) -> ModelProto | None:
    try:
        return shape_inference._propagate_data(proto, strict=False)
    except shape_inference._INFERENCE_ERRORS:
        return None
