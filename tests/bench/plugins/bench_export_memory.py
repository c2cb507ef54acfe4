"""The peak memory and the time of exports at the size of published checkpoints.

Each export is a process of its own, as a user starts it. Run by ``make bench``.
"""

import resource
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from gsgen.reference_plugins.synthetic import (
    AnchorOptions,
    HexPlaneOptions,
    PersonOptions,
    write_gauhuman,
    write_hexplane,
    write_scaffold,
)
from support.measures import print_figure

MAX_MEMORY = 4.0e9  # bytes
_PAUSE = 0.02  # seconds between two looks at the processes


def write_4dgaussians(folder: Path) -> list[str]:
    options = HexPlaneOptions(
        count=300_000, channels=16, resolution=(64, 64, 64, 150), multires=(1, 2), width=128
    )
    return ["hexplane-4dgs", "--checkpoint", str(write_hexplane(folder, options))]


def write_anchors(folder: Path) -> list[str]:
    """Write as many anchors as the mean scene of MipNeRF360 has: 5.4 million Gaussians."""
    options = AnchorOptions(anchors=541_000, per_anchor=10, width=32, is_single_file=True)
    return ["scaffold-gs", "--checkpoint", str(write_scaffold(folder, options))]


def write_person(folder: Path) -> list[str]:
    options = PersonOptions(count=40_000, kind="smplx", vertices=10_475, nets=True, width=128)
    return ["gauhuman", "--checkpoint", str(write_gauhuman(folder, options))]


@pytest.mark.parametrize("dtype", ["float32", "float16"])
@pytest.mark.parametrize("write", [write_anchors, write_4dgaussians, write_person])
def bench_export_memory(write, dtype: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    words = ["export", *write(tmp_path / "run"), "-o", str(tmp_path / "out.onnx")]
    start_time, used = time.perf_counter(), child_seconds()
    with (tmp_path / "log").open("w") as log:
        command = [sys.executable, "-m", "gsgen.cli", *words, "--dtype", dtype]
        process = subprocess.Popen(command, stdout=log, stderr=log)
        total_memory, own = watch_memory(process)
    seconds, used = time.perf_counter() - start_time, child_seconds() - used
    assert process.returncode == 0, (tmp_path / "log").read_text()
    size = (tmp_path / "out.onnx").stat().st_size
    print_figure(
        f"{words[1]} {dtype}: peak {total_memory / 1e9:.2f} GB with child processes (bar "
        f"{MAX_MEMORY / 1e9:g}; the export alone {own / 1e9:.2f}), {seconds:.0f} s, "
        f"{used:.0f} CPU-s, {size / 1e6:.0f} MB"
    )
    assert total_memory <= MAX_MEMORY


def watch_memory(process: subprocess.Popen[bytes]) -> tuple[int, int]:
    """Return the peaks of a process with its descendants and of the process alone, in bytes.

    The kernel's own figure for children begins with the size of the process that starts them.
    """
    total_memory = own = 0
    while process.poll() is None:
        sizes = [resident_bytes(pid) for pid in descendants(process.pid)]
        own = max(own, sizes[0][1])
        total_memory = max(total_memory, own, sum(size for size, _ in sizes))
        time.sleep(_PAUSE)
    return total_memory, own


def descendants(pid: int) -> list[int]:
    """Return the process and all processes that it started, which still run."""
    pids = [pid]
    for file in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):  # the thread has ended
            pids += [child for word in file.read_text().split() for child in descendants(int(word))]
    return pids


def resident_bytes(pid: int) -> tuple[int, int]:
    """Return the resident memory of a process, and its peak; 0 if the process has ended.

    Of pages that several processes share, each has a part: a process that was just forked has all
    pages of its parent, and would count them twice.
    """
    try:
        shares = _kilobytes(Path(f"/proc/{pid}/smaps_rollup"))
        return 1024 * shares.get("Pss", 0), 1024 * _kilobytes(Path(f"/proc/{pid}/status"))["VmHWM"]
    except (OSError, KeyError):  # the process has ended
        return 0, 0


def _kilobytes(file: Path) -> dict[str, int]:
    """Return the sizes that a file of /proc lists in kB, by name."""
    words = [line.split() for line in file.read_text().splitlines() if line.endswith(" kB")]
    return {name.rstrip(":"): int(size) for name, size, _ in words}


def child_seconds() -> float:
    """Return the processor time of all child processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
