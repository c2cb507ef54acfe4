"""What a session adds to ONNX Runtime, each frame; baselines are measured in the same run.

Printed, and asserted against the project's bars; run by ``make bench``, never by ``make test``.
"""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest

from gsgen.sdk.binding import FrameSession
from gsgen.sdk.binding.bound.bound_session import BoundSession
from support.measures import print_figure
from support.models.decoder import write_decoder
from support.models.small_models import good_rows, save_moving

GAUSSIANS = 100_000
FRAMES = 10_000


@pytest.fixture(scope="module")
def decoder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model that decodes 100,000 Gaussians each frame."""
    return write_decoder(tmp_path_factory.mktemp("decoder") / "decoder.onnx", GAUSSIANS)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_moving(tmp_path_factory.mktemp("tiny") / "tiny.onnx", good_rows(5))


def alternating_seconds(actions: list[Callable[[], object]], times: int) -> np.ndarray:
    """Return the seconds of each action, one row a turn.

    They take turns, so that load hits all alike, and in changing order, since the first of a turn
    meets colder caches.
    """
    durations = np.zeros((times, len(actions)))
    for number, turn in enumerate(durations):
        for index in range(len(actions)):
            k = (index + number) % len(actions)
            start_time = time.perf_counter()
            actions[k]()
            turn[k] = time.perf_counter() - start_time
    return durations


def bare_frame(session: FrameSession) -> Callable[[], object]:
    """Return what runs a frame of an open session by ONNX Runtime's own calls."""
    assert isinstance(session._bound, BoundSession)
    bound, now = session._bound, np.zeros(1, np.float32)
    value, run, binding = bound.inputs["time"].value, bound.session, bound._binding

    def frame() -> None:
        now[0] = 0.3
        value.update_inplace(now)
        run.run_with_iobinding(binding)

    return frame


def bare_session_frame(path: Path, threads: int = 1) -> Callable[[], object]:
    """Return what runs a frame on the CPU with ONNX Runtime alone, all buffers bound once."""
    settings = onnxruntime.SessionOptions()
    settings.intra_op_num_threads = threads
    session = onnxruntime.InferenceSession(str(path), settings, providers=["CPUExecutionProvider"])
    binding, now = session.io_binding(), np.zeros(1, np.float32)
    binding.bind_ortvalue_input("time", onnxruntime.OrtValue.ortvalue_from_numpy(now))
    kinds = {"tensor(float)": np.float32, "tensor(int32)": np.int32}
    for output in session.get_outputs():
        array = np.zeros(output.shape, kinds[output.type])
        value = onnxruntime.OrtValue.ortvalue_from_numpy(array)
        binding.bind_ortvalue_output(output.name, value)

    def frame() -> None:
        now[0] = 0.3
        session.run_with_iobinding(binding)

    return frame


class Inside:
    """Stands before ONNX Runtime's session, and notes the seconds that a run takes inside."""

    def __init__(self, session: Any) -> None:
        self.session, self.seconds = session, 0.0

    def run_with_iobinding(self, binding: Any) -> None:
        start_time = time.perf_counter()
        self.session.run_with_iobinding(binding)
        self.seconds = time.perf_counter() - start_time


def bench_overhead_on_a_decoder(decoder: Path) -> None:
    """What is ours is told from ONNX Runtime's part within each frame: load spoils no difference."""
    with FrameSession(decoder, provider="cpu", threads=1) as session:
        alone = bare_frame(session)
        actions = [alone, lambda: session.run({"time": 0.3})["gaussians"], alone]
        entry, ours, again = np.median(alternating_seconds(actions, 30), axis=0)
        assert isinstance(session._bound, BoundSession)
        inside = Inside(session._bound.session)
        session._bound.session = inside
        frames = np.zeros((60, 2))
        for frame in frames:
            start_time = time.perf_counter()
            session.run({"time": 0.3})["gaussians"]
            frame[:] = time.perf_counter() - start_time, inside.seconds
    whole, bare = frames.T
    more = np.median((whole - bare) / bare)
    print_figure(f"100 k Gaussians decoded on the CPU: {1e3 * np.median(bare):.2f} ms a frame, ")
    print_figure(
        f"of which {1e6 * np.median(whole - bare):.1f} µs are ours, {100 * more:+.3f} % (bar +3 %)"
    )
    print_figure(
        f"taking turns: {1e3 * ours:.2f} ms against {1e3 * entry:.2f} and {1e3 * again:.2f} bare"
    )
    assert more <= 0.03


@pytest.mark.parametrize("provider", ["cpu", "webgpu"])
def bench_overhead_on_a_tiny_model(tiny: Path, provider: str) -> None:
    with FrameSession(tiny, provider=provider, threads=1) as session:
        actions = [bare_frame(session), lambda: session.run({"time": 0.3})]
        alone, ours = 1e6 * np.median(alternating_seconds(actions, 2000), axis=0)
    print_figure(
        f"5 Gaussians, {provider}: update and run bare {alone:.1f} µs, FrameSession {ours:.1f} µs"
    )
    print_figure(f"so {ours - alone:.1f} µs a frame are ours")


def bench_first_frame(decoder: Path) -> None:
    def create() -> None:
        bare_session_frame(decoder)()

    def ours() -> None:
        with FrameSession(decoder, provider="cpu", threads=1) as session:
            session.run()

    baseline, durations = np.median(alternating_seconds([create, ours], 5), axis=0)
    print_figure(f"first frame, from the file: bare {1e3 * baseline:.0f} ms, ")
    print_figure(
        f"FrameSession {1e3 * durations:.0f} ms with its warm-up, ratio {durations / baseline:.2f}"
    )


# In a process of its own: a child of a large process would begin with its parent's peak.
_GROWTH = """
import sys
from gsgen.sdk.binding import FrameSession

def resident():
    return int(open("/proc/self/statm").read().split()[1]) * 4

with FrameSession(sys.argv[1], provider=sys.argv[2], threads=1) as session:
    def frames(count):
        for k in range(count):
            frame = session.run({"time": (k % 100) / 100})
            frame["gaussians"], frame.count
    frames(1000)
    before = resident()
    frames(int(sys.argv[3]))
    print(before, resident())
"""


@pytest.mark.parametrize("provider", ["cpu", "webgpu"])
def bench_memory_over_ten_thousand_frames(tiny: Path, provider: str) -> None:
    completed = subprocess.run(
        [sys.executable, "-c", _GROWTH, str(tiny), provider, str(FRAMES)],
        check=True,
        capture_output=True,
        text=True,
    )
    before, after = map(int, completed.stdout.split())
    print_figure(
        f"{provider}: resident {before / 1000:.1f} MB, and {after - before} kB more after "
    )
    print_figure(f"{FRAMES:,} frames (bar 1000 kB)")
    assert after - before <= 1000
