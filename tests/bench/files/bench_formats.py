"""What splat files cost: PLY beside reading its bytes, and every codec in megabytes a second.

Run by ``make bench``. Times are those of this process, so that other work on the machine shows
less; ratios are against a baseline of the same run.
"""

import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gsgen.formats import (
    Splats,
    open_splats,
    read_ply,
    write_compressed_ply,
    write_glb,
    write_ply,
    write_sog,
    write_splat,
    write_spz,
)
from support.measures import print_figure
from support.splat_files import ksplat, scene, sog_files, zipped

COUNT = int(os.environ.get("GSGEN_BENCH_SPLATS", 1_000_000))
SMALL_COUNT = 100_000
MAX_RATIO = 1.2
_ROUNDS = 5
_IN_MEMORY = 236  # bytes of a splat of degree 3


def seconds(run: Callable[[], object], rounds: int = _ROUNDS) -> float:
    """The median time of this process that ``run`` takes, the first run aside."""
    run()
    times = []
    for _ in range(rounds):
        start_time = time.process_time()
        run()
        times.append(time.process_time() - start_time)
    return statistics.median(times)


def random_splats(count: int) -> Splats:
    rng = np.random.default_rng(0)

    def draw(*shape: int) -> np.ndarray:
        return rng.standard_normal((count, *shape), dtype=np.float32)

    return Splats(
        position=draw(3),
        rotation=draw(4),
        log_scale=draw(3) - 4,
        logit_opacity=draw(),
        sh=draw(16, 3) / 4,
    )


def bench_ply_beside_reading_its_bytes(tmp_path: Path) -> None:
    """A PLY file of a million splats loads in 1.2 times what reading and one copy takes."""
    file = tmp_path / "many.ply"
    write_ply(file, random_splats(COUNT))

    def baseline() -> object:
        return np.frombuffer(file.read_bytes(), np.uint8).copy()

    bare, loading = seconds(baseline), seconds(lambda: read_ply(file))
    size = file.stat().st_size / 1e6
    print_figure(
        f"read_ply of {COUNT:,} splats, {size:.0f} MB: {loading:.3f} s, "
        f"{loading / bare:.2f} × of reading its bytes and one copy ({bare:.3f} s; bar {MAX_RATIO})"
    )
    assert loading <= MAX_RATIO * bare


def bench_all_codecs(tmp_path: Path) -> None:
    """Megabytes a second, of splats as they are in memory and not of the packed file."""
    splats = random_splats(SMALL_COUNT)
    whole = _IN_MEMORY * SMALL_COUNT / 1e6
    writers: dict[str, Callable[[Path], object]] = {
        "PLY": lambda file: write_ply(file, splats),
        "compressed PLY": lambda file: write_compressed_ply(file, splats),
        "SPZ 2": lambda file: write_spz(file, splats, version=2),
        "SPZ 3": lambda file: write_spz(file, splats, version=3),
        "SPZ 4": lambda file: write_spz(file, splats, version=4),
        "SPLAT": lambda file: write_splat(file, splats),
        "GLB": lambda file: write_glb(file, splats),
        "SOG": lambda file: write_sog(file, splats),
    }
    print_figure(f"{SMALL_COUNT:,} splats of degree 3, {whole:.0f} MB in memory")
    for name, write in writers.items():
        file = tmp_path / "bench"
        writing = seconds(lambda: write(file), 2)  # noqa: B023 -- called at once
        reading = seconds(lambda: open_splats(file), 3)  # noqa: B023
        size = file.stat().st_size / 1e6
        print_figure(
            f"{name:<15} writes {whole / writing:6.0f} MB/s, reads {whole / reading:6.0f} MB/s, "
            f"{size:5.1f} MB"
        )
    for name, content, count in (
        ("KSPLAT level 1", ksplat(scene(5000, 2), 1, bucket_size=256), 5000),
        ("SOG", zipped(sog_files(SMALL_COUNT, bands=3, width=320)), SMALL_COUNT),
    ):
        file = tmp_path / "read"
        file.write_bytes(content)
        reading = seconds(lambda: open_splats(file), 3)  # noqa: B023
        size_in_millions = _IN_MEMORY * count / 1e6
        print_figure(f"{name:<15} reads {size_in_millions / reading:6.0f} MB/s ({count:,} splats)")
