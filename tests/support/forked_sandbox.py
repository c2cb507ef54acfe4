"""Sandbox processes forked from one that has imported ONNX Runtime, for tests of what models do.

To start Python and import ONNX Runtime takes a third of a second, a fork a hundredth. The child
does the same work under the same limits. Tests of the sandbox itself start real processes.
"""

__all__ = ["run_forked", "share_with_forks"]

import atexit
import json
import os
import select
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from itertools import count
from pathlib import Path
from typing import Any

from gsgen.contract.probing import sandbox

_start_process = sandbox._run_child
_lock = threading.Lock()
_server: "subprocess.Popen[str] | None" = None
_owner = 0  # the process that started the server; its forks use the same
_lock_of_forks: Any = None
_numbers = count()


def share_with_forks() -> None:
    """Start the server now, so that forks of this process use it, too, one at a time."""
    global _lock_of_forks
    _lock_of_forks = tempfile.TemporaryFile()  # noqa: SIM115 - for as long as the process
    _running_server()


def run_forked(folder: Path, seconds: float, worker: str) -> int | None:
    """Run a sandbox job as ``sandbox._run_child`` does, in a fork of a prepared process."""
    if not worker.startswith("gsgen."):  # a test's own worker
        return _start_process(folder, seconds, worker)
    request = {
        "folder": str(folder),
        "seconds": seconds,
        "worker": worker,
        "cwd": str(Path.cwd()),
        "environment": dict(os.environ),
        "name": f"{os.getpid()}-{next(_numbers)}",
    }
    with _lock, _alone_of_forks():
        server = _running_server()
        assert server.stdin is not None
        assert server.stdout is not None
        try:
            server.stdin.write(json.dumps(request) + "\n")
            server.stdin.flush()
            while True:
                name, status = json.loads(server.stdout.readline())
                if name == request["name"]:  # and no answer to a fork that was interrupted
                    return None if status is None else int(status)
        except BaseException:
            _end_server()
            raise


@contextmanager
def _alone_of_forks() -> Iterator[None]:
    """Keep other forks of the process that shares its server from asking it meanwhile."""
    if _lock_of_forks is None:
        yield
        return
    import fcntl

    fcntl.lockf(_lock_of_forks, fcntl.LOCK_EX)
    try:
        yield
    finally:
        fcntl.lockf(_lock_of_forks, fcntl.LOCK_UN)


def _running_server() -> "subprocess.Popen[str]":
    global _server, _owner
    # A fork cannot ask for the state of a process that is not its child.
    if _server is None or (os.getpid() == _owner and _server.poll() is not None):
        _owner = os.getpid()
        environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        _server = subprocess.Popen(
            [sys.executable, "-P", __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
            start_new_session=True,
        )
        atexit.register(_end_server)
    return _server


def _end_server() -> None:
    global _server
    if _server is not None and os.getpid() == _owner:
        _server.communicate()  # closes its stdin, at which it ends
        _server = None


def _serve() -> None:
    """Fork a child for each request, and print its exit status; end at the end of stdin."""
    import onnxruntime  # noqa: F401 - so that the children need not

    for line in sys.stdin:
        request: dict[str, Any] = json.loads(line)
        main = import_module(request["worker"]).main
        child = os.fork()
        if child == 0:
            _work(request, main)
        status = _wait(child, request["seconds"])
        sys.stdout.write(json.dumps([request["name"], status]) + "\n")
        sys.stdout.flush()


def _wait(child: int, seconds: float) -> int | None:
    descriptor = os.pidfd_open(child)
    try:
        # stdin is readable at its end, or where a fork that waits for the answer was interrupted.
        ready, _, _ = select.select([descriptor, sys.stdin], [], [], seconds)
        if descriptor not in ready:
            os.killpg(child, 9)
        _, status = os.waitpid(child, 0)
    finally:
        os.close(descriptor)
    return os.waitstatus_to_exitcode(status) if ready else None


def _work(request: dict[str, Any], main: Any) -> None:
    """Do a request as the child, and never return."""
    code = 1
    try:
        os.setsid()
        folder = Path(request["folder"])
        with (folder / "log").open("wb") as log, open(os.devnull, "rb") as nothing:
            os.dup2(nothing.fileno(), 0)
            for stream in (1, 2):
                os.dup2(log.fileno(), stream)
        os.environ.clear()
        os.environ.update(request["environment"])
        os.chdir(request["cwd"])
        code = main(folder)
    except BaseException:
        os.write(2, traceback.format_exc().encode())
    finally:
        os._exit(code)


if __name__ == "__main__":
    _serve()
