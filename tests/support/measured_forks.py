"""`gsgen` in forks of a small process that has imported the validator, each of them measured.

To start Python and import the validator takes half a second, a fork a hundredth. The process has
no more in memory than `gsgen validate` has at its start, and models run in real children.
"""

__all__ = ["measuring_forks"]

import atexit
import gc
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_SECONDS = 300  # that a command may take


@contextmanager
def measuring_forks() -> Iterator[Callable[..., tuple[int, str, str, float, int]]]:
    """Yield what runs `gsgen` with the words that it is given.

    It returns the exit code, stdout, stderr, processor time in seconds with that of the imports,
    and the largest resident size in bytes.
    """
    server = subprocess.Popen(
        [sys.executable, "-P", __file__],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"COLUMNS": "200"},
    )

    def run(*words: str | Path) -> tuple[int, str, str, float, int]:
        assert server.stdin is not None
        assert server.stdout is not None
        with tempfile.TemporaryDirectory() as folder:
            request = {"words": [str(word) for word in words], "folder": folder}
            server.stdin.write(json.dumps(request) + "\n")
            server.stdin.flush()
            code, seconds, peak = json.loads(server.stdout.readline())
            out, err = (Path(folder, name).read_text("utf-8") for name in ("out", "err"))
        return code, out, err, seconds, peak

    try:
        yield run
    finally:
        server.communicate()  # closes its stdin, at which it ends


def _serve() -> None:
    """Fork `gsgen` for each request, and print its exit code, its time and its memory."""
    import gsgen.contract.validator  # noqa: F401 - so that the children need not
    from gsgen.cli import main
    from gsgen.contract._extensions import find_commands
    from gsgen.contract.rules.catalogue import installed_rules

    find_commands()["validate"].load()
    installed_rules()
    gc.freeze()
    imports = time.process_time()
    for line in sys.stdin:
        request: dict[str, Any] = json.loads(line)
        child = os.fork()
        if child == 0:
            _work(request, main)
        timer = threading.Timer(_SECONDS, os.kill, (child, 9))
        timer.start()
        _, status, used = os.wait4(child, 0)
        timer.cancel()
        timer.join()
        code, seconds = os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime
        peak = max(_own_peak(), used.ru_maxrss) * 1024  # forks share memory of this process
        print(json.dumps([code, imports + seconds, peak]), flush=True)


def _own_peak() -> int:
    """Return the largest resident size of this process in KiB, without that of who started it.

    ``ru_maxrss`` has the size from before this program replaced the copy of its starter.
    """
    status = Path("/proc/self/status").read_text("ascii")
    (peak,) = [line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")]
    return int(peak)


def _work(request: dict[str, Any], main: Callable[[], None]) -> None:
    """Run `gsgen` as the child, and never return."""
    code = 1
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    for stream, name in ((1, "out"), (2, "err")):
        with Path(request["folder"], name).open("wb") as file:
            os.dup2(file.fileno(), stream)
    sys.argv = ["gsgen", *request["words"]]
    try:
        main()
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        traceback.print_exc()
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


if __name__ == "__main__":
    _serve()
