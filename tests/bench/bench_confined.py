"""Processor time of a frame of a confined model, in multiples of one in the process.

    python tests/bench/bench_confined.py

A model decodes 100,000 Gaussians with the CPU provider. Frames go through `GeneratorSource`, as
commands draw them: inputs, run, comparison with the last frame and copy. Both ways take turns, and
the time of the child counts. The bar: 1.05.
"""

import os
import tempfile
import time
from pathlib import Path

import numpy as np

from gsgen.runtime.sources.source import GeneratorSource
from gsgen.sdk.binding.confined.models import ConfinedModels
from support.measures import print_line
from support.models.decoder import write_decoder

GAUSSIANS, FRAMES, ROUNDS = 100_000, 20, 15
"""Gaussians of the model; frames of a turn; turns of each way."""


def processor_seconds(process_id: int) -> float:
    """Return the processor time of the threads of a process, by the scheduler's nanoseconds."""
    tasks = Path(f"/proc/{process_id}/task").iterdir()
    return 1e-9 * sum(int((task / "schedstat").read_text().split()[0]) for task in tasks)


def children() -> list[int]:
    """Return the ids of the children of this process, whichever thread started them."""
    tasks = Path("/proc/self/task").iterdir()
    return [int(word) for task in tasks for word in (task / "children").read_text().split()]


def used_seconds() -> float:
    """Return the processor time of this process and its children."""
    return sum(map(processor_seconds, (os.getpid(), *children())))


def main() -> None:
    """Measure both ways in turns, and print the ratio."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_decoder(Path(folder) / "decoder.onnx", GAUSSIANS)
        with ConfinedModels([path]) as confined:
            sources = [GeneratorSource(path), GeneratorSource(path, confined=confined)]
            seconds = np.zeros((ROUNDS, 2))
            walls = np.zeros((ROUNDS, 2))
            for turn in range(ROUNDS):
                for way, source in enumerate(sources):
                    start, wall_start = used_seconds(), time.perf_counter()
                    for frame in range(FRAMES):
                        moment = (turn * FRAMES + frame + 1) / (ROUNDS * FRAMES)
                        source.update(None, {"time": moment})
                    seconds[turn, way] = used_seconds() - start
                    walls[turn, way] = time.perf_counter() - wall_start
            rows = [np.asarray(source.data.rows) for source in sources]
            assert rows[0].tobytes() == rows[1].tobytes()
            for source in sources:
                source.close()
    trusted, confined_time = 1000 * seconds.min(axis=0) / FRAMES
    wall, confined_wall = 1000 * walls.min(axis=0) / FRAMES
    print_line(
        f"{GAUSSIANS:,} Gaussians, ms of a frame, least of {ROUNDS} turns of {FRAMES} frames"
    )
    print_line(f"  processor: trusted {trusted:.2f}, confined {confined_time:.2f}")
    print_line(f"  wall:      trusted {wall:.2f}, confined {confined_wall:.2f}")
    ratio = float(np.median(seconds[:, 1] / seconds[:, 0]))
    print_line(f"processor time, confined / trusted: {ratio:.3f} (median of turns; bar 1.05)")


if __name__ == "__main__":
    main()
