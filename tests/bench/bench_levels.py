"""What the levels cost: static beside ``onnx.checker``, and ONNX Runtime's part of behaviour.

Run by ``make bench``. Figures are ratios against a baseline of the same run, in the same process.
"""

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.sandbox import Execution, execute
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation import engine
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from support.measures import print_figure

NODES = 500
_ROUNDS = 20
# From so many megabytes of weights on, and from networks so wide on, there is a bar.
_BAR_FROM = 64
_WIDE, _SHARE = 128, 0.7


def long_chain(nodes: int) -> ModelSpec:
    """A generator whose centres go through a chain of ``nodes`` nodes more."""
    base = find("swing").draw()
    first, remaining = "moved = Add (center, shift)", []
    for k in range(0, nodes, 2):
        source = "plain" if k == 0 else f"step_{k}"
        remaining.append(f"half_{k} = Mul ({source}, one)")
        remaining.append(f"step_{k + 2} = Add (half_{k}, nil)")
    chain = " ".join(remaining)
    text = f"plain = Add (center, shift) {chain} moved = Identity (step_{nodes})"
    numbers = {"one": np.ones(3, np.float32), "nil": np.zeros(3, np.float32)}
    return base.replace_text(first, text).with_weights(**numbers)


def weighing(spec: ModelSpec, megabytes: int) -> ModelSpec:
    """Let the model look a part of its colours up in a table of that size."""
    if not megabytes:
        return spec
    rows = megabytes * 10**6 // 12
    table = np.random.default_rng(0).random((rows, 3), np.float32)
    lookup_model = spec.replace_text(
        "color = Identity (colors)", "some = Gather (table, places) color = Mul (some, small)"
    )
    places = np.arange(5, dtype=np.int32)
    return lookup_model.with_weights(table=table, places=places, small=np.float32([0.1]))


def network(rows: int, width: int) -> ModelSpec:
    """A generator whose centres are moved by a small network, as anchor-based methods have one."""
    base = find("swing").draw()
    rng = np.random.default_rng(0)

    def normal(*shape: int) -> np.ndarray:
        return (rng.standard_normal(shape) / np.sqrt(shape[0])).astype(np.float32)

    text = (
        "wide = Add (feature, wave) a = MatMul (wide, first) b = Relu (a) "
        "c = MatMul (b, second) d = Relu (c) e = MatMul (d, third) f = Tanh (e) "
        "shift = Mul (f, speed) moved = Add (center, shift)"
    )
    remaining = {
        name: np.resize(value, (rows, *value.shape[1:]))
        for name, value in base.weights.items()
        if value.ndim == 2 and len(value) == 5
    }
    spec = base.replace_text("shift = Mul (speed, wave) moved = Add (center, shift)", text)
    spec = replace(spec, outputs=spec.outputs.replace("[5,", f"[{rows},"))
    outputs = base.manifest.outputs
    gaussians = replace(outputs.gaussians, capacity=rows)
    layers = {"first": normal(width, width), "second": normal(width, width)}
    return (
        spec.with_weights(
            **remaining, **layers, third=normal(width, 3), feature=normal(rows, width)
        )
        .with_weights(live=np.int32([rows]), center=rng.uniform(-1, 1, (rows, 3)).astype("f4"))
        .with_outputs(gaussians=gaussians)
    )


def taken(action: Callable[[], object]) -> float:
    start_time = time.perf_counter()
    action()
    return time.perf_counter() - start_time


def compared(path: Path, settings: Settings) -> dict[str, list[float]]:
    """Time ours and theirs in turns, so that a busy machine is busy for all."""
    loaded = onnx.load(path)
    actions: dict[str, Callable[[], object]] = {
        "ours": lambda: validate(path, settings),
        "theirs": lambda: onnx.checker.check_model(onnx.load(path)),
        "inferred": lambda: onnx.checker.check_model(onnx.load(path), full_check=True),
        "parsed": lambda: onnx.checker.check_model(loaded),
    }
    times: dict[str, list[float]] = {name: [] for name in actions}
    for _ in range(_ROUNDS):
        for name, action in actions.items():
            times[name].append(taken(action))
    return times


@pytest.mark.parametrize("megabytes", [0, 8, 64])
def bench_static_beside_the_checker(tmp_path: Path, megabytes: int) -> None:
    """From a file to a verdict on both sides: theirs reads, parses and checks, and so does ours.

    Ours never reads weights, theirs copies them; without weights there is only Python against
    C++, and 80 rules against one. So it is a matter of the weights, and all sizes are printed.
    """
    path = tmp_path / "long.onnx"
    weighing(long_chain(NODES), megabytes).write(path)
    settings = Settings(level=Level.STATIC)
    report = validate(path, settings)
    assert report.verdict == "conforms", [str(finding) for finding in report.findings]
    times = compared(path, settings)
    best = {name: 1000 * min(values) for name, values in times.items()}
    middle = {name: statistics.median(values) for name, values in times.items()}
    print_figure(f"static on {NODES} nodes and {megabytes} MB of weights: {best['ours']:.1f} ms")
    for name, words in (
        ("theirs", "onnx.load and check_model"),
        ("inferred", "the same with shape inference (full_check), which ours does, too"),
        ("parsed", "check_model of what was parsed before"),
    ):
        ratio, median_ratio = best["ours"] / best[name], middle["ours"] / middle[name]
        print_figure(
            f"  {ratio:.2f} × (of medians {median_ratio:.2f} ×) {best[name]:.1f} ms, {words}"
        )
    if megabytes >= _BAR_FROM:
        print_figure("  bar 1.3 × onnx.load and check_model")
        assert best["ours"] <= 1.3 * best["theirs"]


@pytest.mark.parametrize(("rows", "width"), [(5, 8), (100_000, 64), (100_000, 128)])
def bench_share_of_onnx_runtime_in_behaviour(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows: int, width: int
) -> None:
    """How much of a validation is making sessions and running them, with and without the start."""
    recorded: list[Execution] = []

    @contextmanager
    def noted(
        path: Path, names: Sequence[str], probes: Sequence[Probe], limits: Limits
    ) -> Iterator[Execution]:
        with execute(path, names, probes, limits) as execution:
            recorded.append(execution)
            yield execution

    monkeypatch.setattr(engine, "execute", noted)
    path = tmp_path / "network.onnx"
    network(rows, width).write(path)
    settings = Settings(level=Level.BEHAVIOUR)
    validate(path, settings)
    report = validate(path, settings)
    assert report.verdict == "conforms", [str(finding) for finding in report.findings]
    session_seconds, child = recorded[-1].session_seconds, report.runtime_seconds
    start = empty_child_seconds()
    print_figure(
        f"behaviour, {rows} rows moved by a network of width {width}: {report.seconds:.2f} s, "
        f"{len(recorded[-1].runs)} runs; ONNX Runtime {session_seconds:.2f} s, its process {child:.2f} s"
    )
    bar = f" (bar {_SHARE:.0%})" if width >= _WIDE else ""
    print_figure(
        f"  share of ONNX Runtime {session_seconds / report.seconds:.0%}; "
        f"{session_seconds / (report.seconds - start):.0%} without the {start:.2f} s that a process takes to start{bar}"
    )
    if width >= _WIDE:
        assert session_seconds >= _SHARE * report.seconds


def empty_child_seconds() -> float:
    """Return how long a process takes that imports ONNX Runtime and does nothing."""
    words = [
        sys.executable,
        "-P",
        "-c",
        "import numpy, onnxruntime, gsgen.contract.probing.sandbox_worker",
    ]
    return min(taken(lambda: subprocess.run(words, check=True)) for _ in range(3))
