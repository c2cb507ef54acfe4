"""Fuzz the readers of splat files: damaged files have to be read or refused, within bounds.

Run by ``make fuzz-formats``. Each format is read in a process of its own, so that one that dies
is seen. What failed is kept in out/fuzz-formats.
"""

__all__ = ["ANY", "Trial", "main", "read", "whole_files"]

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from fuzz.splat_files import draw
from gsgen.formats import FormatError, codec_named, open_splats
from gsgen.formats.shared.notices import FormatWarning
from support.splat_files import samples

MEMORY = 256 << 20
"""Bytes that reading one small file may take."""
SECONDS = 10
_ENVIRONMENT = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
FOLDER = Path("out/fuzz-formats")
ANY = "any"
"""Stands for all formats, told by their content."""


@dataclass(frozen=True, slots=True)
class Trial:
    """What reading one file came to: the kind of its refusal, or what went wrong."""

    kind: str
    failure: str = ""


class _Late(BaseException):
    """Reading took too long; no reader catches it."""


def whole_files(folder: Path) -> dict[str, list[bytes]]:
    """Return what is damaged, by format."""
    actual = samples(folder)
    return actual | {ANY: [content for files in actual.values() for content in files]}


def read(format: str, file: Path) -> Trial:
    """Read ``file`` as its format, and say what came of it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", FormatWarning)
            (open_splats if format == ANY else codec_named(format).read)(file)
    except FormatError as error:
        return Trial(type(error).__name__, _fault(error, file))
    except Exception as error:
        return Trial("raised", f"{type(error).__name__}: {error}")
    return Trial("read")


def _fault(error: FormatError, file: Path) -> str:
    """Return what is wrong with an error: it has to name the file, in a few lines."""
    if "more memory than is available" in error.message:
        return f"memory ran out: {error}"
    if not (error.path or "").startswith(str(file.parent)):
        return f"names no file: {error}"
    if len(str(error).splitlines()) > 3 or len(str(error)) > 2000:
        return f"is too long: {error}"
    return ""


def main() -> int:
    """Run as the command line says; 1 where something failed."""
    arguments = _arguments()
    if arguments.worker:
        return _work(arguments.worker, arguments.count, arguments.seed, arguments.first)
    with tempfile.TemporaryDirectory() as folder:
        names = arguments.format or [*whole_files(Path(folder))]
    failed = 0
    for name in names:
        failed += _run(name, arguments.count, arguments.seed)
    return 1 if failed else 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m fuzz.formats", description=__doc__)
    parser.add_argument("--count", type=int, default=5000, help="files of each format")
    parser.add_argument("--seed", type=int, default=0, help="another seed, other files")
    parser.add_argument("--format", action="append", help="only this one; repeatable")
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    parser.add_argument("--first", type=int, default=0, help=argparse.SUPPRESS)
    return parser.parse_args()


def _run(format: str, count: int, seed: int) -> int:
    """Read the mutants of one format in other processes; return how many failed."""
    start_time, first, kinds = time.monotonic(), 0, Counter[str]()
    failures: dict[int, str] = {}
    peak = 0
    while first < count:
        words = ["--worker", format, "--count", count, "--seed", seed, "--first", first]
        command = [sys.executable, "-m", "fuzz.formats", *map(str, words)]
        completed = subprocess.run(command, capture_output=True, text=True, env=_ENVIRONMENT)
        for line in completed.stdout.splitlines():
            document = json.loads(line)
            first = document["case"] + 1
            kinds[document["kind"]] += 1
            peak = max(peak, document["peak"])
            if document["failure"]:
                failures[document["case"]] = document["failure"]
        if first < count:  # it died over this one
            failures[first] = f"ended with {completed.returncode}: {completed.stderr[-500:]}"
            kinds["died"] += 1
            first += 1
    _save_failures(format, seed, failures)
    most = ", ".join(f"{kind} {number}" for kind, number in kinds.most_common())
    _say(
        f"{format}: {count} files in {time.monotonic() - start_time:.0f} s, {len(failures)} failed, "
        f"{peak / (1 << 20):.0f} MiB at most; {most}"
    )
    for index, failure in [*failures.items()][:5]:
        _say(f"  {format} {index}: {failure[-300:]}")
    return len(failures)


def _save_failures(format: str, seed: int, failures: dict[int, str]) -> None:
    if not failures:
        return
    FOLDER.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        whole = whole_files(Path(folder))[format]
    for index, failure in failures.items():
        (FOLDER / f"{format}-{seed}-{index}").write_bytes(draw(format, seed, index, whole))
        (FOLDER / f"{format}-{seed}-{index}.txt").write_text(failure)


def _work(format: str, count: int, seed: int, first: int) -> int:
    """Read mutants, and write a line of JSON about each."""
    with tempfile.TemporaryDirectory() as folder:
        whole = whole_files(Path(folder))[format]
        file = Path(folder) / "mutant"
        file.write_bytes(whole[0])
        read(format, file)  # what is loaded once is not the files' doing
        base = _resident()
        limit = _reserved() + MEMORY
        resource.setrlimit(resource.RLIMIT_DATA, (limit, resource.RLIM_INFINITY))
        signal.signal(signal.SIGALRM, _late)
        for index in range(first, count):
            file.write_bytes(draw(format, seed, index, whole))
            _tell(index, _timed(format, file), _resident() - base)
    return 0


def _timed(format: str, file: Path) -> Trial:
    signal.alarm(SECONDS)
    try:
        return read(format, file)
    except _Late:
        return Trial("late", f"took more than {SECONDS} s")
    finally:
        signal.alarm(0)


def _late(*_: object) -> None:
    raise _Late


def _tell(index: int, trial: Trial, peak: int) -> None:
    failure = trial.failure
    if peak > MEMORY:
        failure = failure or f"{peak >> 20} MiB of memory"
    message = {"case": index, "kind": trial.kind, "failure": failure, "peak": peak}
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


def _resident() -> int:
    """Return the largest resident size in bytes that the process had since it was started.

    Not `ru_maxrss`, which begins with the size of the process that started this one.
    """
    return _status_bytes("VmHWM")


def _reserved() -> int:
    """Return the bytes of private memory that the process has, as RLIMIT_DATA counts them."""
    return _status_bytes("VmData")


def _status_bytes(name: str) -> int:
    for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1]) * 1024
    raise RuntimeError(f"no {name} in /proc/self/status")


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
