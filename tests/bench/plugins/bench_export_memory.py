"""The peak memory and the time of exports at the size of published checkpoints.

Each export is a process of its own, as a user starts it. Run by ``make bench``.
"""

import json
import subprocess
import sys
import time
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

BAR = 4.0e9  # bytes
# Runs `gsgen` with its arguments, and prints the peak of the process and of its largest child.
PROGRAM = """
import atexit, json, resource, runpy, sys
usage = lambda who: 1024 * resource.getrusage(who).ru_maxrss
peaks = lambda: [usage(resource.RUSAGE_SELF), usage(resource.RUSAGE_CHILDREN)]
atexit.register(lambda: print(json.dumps(peaks())))
sys.argv[0] = "gsgen"
runpy.run_module("gsgen.cli", run_name="__main__")
"""


def write_4dgaussians(folder: Path) -> list[str]:
    options = HexPlaneOptions(
        count=300_000, channels=16, resolution=(64, 64, 64, 150), multires=(1, 2), width=128
    )
    return ["hexplane-4dgs", "--checkpoint", str(write_hexplane(folder, options))]


def write_anchors(folder: Path) -> list[str]:
    """Write as many anchors as the mean scene of MipNeRF360 has: 5.4 million Gaussians."""
    options = AnchorOptions(anchors=541_000, per_anchor=10, width=32, united=True)
    return ["scaffold-gs", "--checkpoint", str(write_scaffold(folder, options))]


def write_person(folder: Path) -> list[str]:
    options = PersonOptions(count=40_000, kind="smplx", vertices=10_475, nets=True, width=128)
    return ["gauhuman", "--checkpoint", str(write_gauhuman(folder, options))]


@pytest.mark.parametrize("dtype", ["float32", "float16"])
@pytest.mark.parametrize("write", [write_anchors, write_4dgaussians, write_person])
def bench_export_memory(write, dtype: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    words = ["export", *write(tmp_path / "run"), "-o", str(tmp_path / "out.onnx")]
    began = time.perf_counter()
    ran = subprocess.run(
        [sys.executable, "-c", PROGRAM, *words, "--dtype", dtype],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    seconds = time.perf_counter() - began
    assert ran.returncode == 0, ran.stderr
    own, child = json.loads(ran.stdout.splitlines()[-1])
    size = (tmp_path / "out.onnx").stat().st_size
    sys.stdout.write(
        f"\n  {words[1]} {dtype}: peak {(own + child) / 1e9:.2f} GB (bar {BAR / 1e9:g}; export "
        f"{own / 1e9:.2f}, largest child {child / 1e9:.2f}), {seconds:.0f} s, {size / 1e6:.0f} MB"
    )
    assert own + child <= BAR
