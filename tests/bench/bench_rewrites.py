"""What the rewrites gain on ONNX Runtime's CPU, against torch's plain export and eager torch.

All three run on one core in the same process, by turns; times are CPU time, so that other work on
the machine does not count. The floor is what the products of the networks and the bytes of inputs,
weights and outputs would take at the speed of a large matrix product and of a large copy, both
measured in the same run.
"""

import copy
import time
from collections.abc import Callable
from dataclasses import dataclass
from math import prod
from pathlib import Path

import numpy as np
import onnx_ir as ir
import onnxruntime
import pytest
import torch

from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings
from gsgen.sdk import GaussianGenerator, export
from gsgen.sdk.exporting.embed_manifest import rewrite_and_embed
from gsgen.sdk.passes.framework.base import RewriteTarget
from gsgen.sdk.rewriting.model_io import save_model
from gsgen.sdk.rewriting.rewrite import graph_stats
from support.measures import print_figure
from support.models.reference_models import Avatar, HexPlane, ScaffoldDecoder
from support.models.traced import traced

BENCH_ROUNDS = 9
# Ours over the plain export, and over eager torch.
BAR_PLAIN, BAR_EAGER = 0.75, 1.1
CASES: dict[str, tuple[Callable[[], GaussianGenerator], int, int | None]] = {
    # 100,000 anchors of 10 Gaussians, features of 32, three networks of two layers.
    "scaffold": (lambda: ScaffoldDecoder(100_000, 10, 32), 1_000_000, None),
    # 60,000 Gaussians, six planes of 32 channels and 64 cells a side, five heads.
    "hexplane": (lambda: HexPlane(60_000, 32, 64), 60_000, 3),
}


@dataclass(frozen=True)
class Case:
    """A module, and its graph before and after."""

    module: torch.nn.Module
    inputs: list[torch.Tensor]
    names: list[str]
    before: Path
    after: Path
    model: ir.Model


def built(name: str, folder: Path) -> Case:
    """Export a module as torch does, and as we do."""
    make, rows, degree = CASES[name]
    result = traced(make(), name, rows, degree)
    model, probes = result.model, result.probes
    before, after = folder / f"{name}.onnx", folder / f"{name}_rewritten.onnx"
    save_model(model, before)
    original = copy.copy(ir.load(before))
    start_time = time.process_time()
    rewrite_and_embed(model, result.manifest, load_target("core"))
    print_figure(f"{name}: rewritten in {time.process_time() - start_time:.1f} s of CPU time")
    save_model(model, after)
    inputs = [torch.from_numpy(np.array(entry)) for entry in probes[3].inputs.values()]
    return Case(result.module, inputs, list(probes[3].inputs), before, after, original)


def session(path: Path) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def cpu_seconds(action: Callable[[], object]) -> float:
    start_time = time.process_time()
    action()
    return time.process_time() - start_time


def by_turns(actions: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Run all actions in turn, several times; return the shortest time of each."""
    durations = {name: [cpu_seconds(action) for _ in range(1)] for name, action in actions.items()}
    for _ in range(BENCH_ROUNDS):
        for name, action in actions.items():
            durations[name].append(cpu_seconds(action))
    return {name: min(times[1:]) for name, times in durations.items()}


def speeds() -> tuple[float, float]:
    """Return multiply-adds ×2 a second of a product, and bytes a second of a copy, on one core."""
    a, b = torch.rand(1024, 1024), torch.rand(1024, 1024)
    large_array = torch.rand(1 << 25)
    target = torch.empty_like(large_array)
    product = min(cpu_seconds(lambda: a @ b) for _ in range(5))
    moved = min(cpu_seconds(lambda: target.copy_(large_array)) for _ in range(5))
    return 2 * 1024**3 / product, 2 * large_array.nbytes / moved


def floor_of(case: Case, outputs: list[np.ndarray]) -> tuple[float, float]:
    """Return operations of all products, and bytes of inputs, weights and outputs."""
    operations = 0.0
    for node in case.model.graph.all_nodes():
        if node.op_type in ("Gemm", "MatMul"):
            left, result = node.inputs[0], node.outputs[0]
            assert left is not None
            inner = left.shape[-1] if left.shape is not None else 0
            operations += 2 * int(inner) * prod(int(size) for size in result.shape or (0,))
    weights = sum(
        value.const_value.nbytes
        for value in case.model.graph.initializers.values()
        if value.const_value is not None
    )
    return operations, weights + sum(output.nbytes for output in outputs)


@pytest.mark.parametrize("name", CASES)
def bench_rewritten_graph_on_the_cpu(name: str, tmp_path: Path) -> None:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        case = built(name, tmp_path)
        feeds = {k: v.numpy() for k, v in zip(case.names, case.inputs, strict=True)}
        original, ours = session(case.before), session(case.after)
        with torch.no_grad():
            expected = [entry.numpy() for entry in case.module(*case.inputs)]
            for a, b in zip(expected, ours.run(None, feeds), strict=True):
                room = 1e-4 * np.abs(a).max(axis=0) + 1e-6 if a.ndim > 1 else 0
                assert (np.abs(a - b) <= room).all()
            seconds = by_turns(
                {
                    "plain": lambda: original.run(None, feeds),
                    "ours": lambda: ours.run(None, feeds),
                    "eager": lambda: case.module(*case.inputs),
                }
            )
        rate, bandwidth = speeds()
    finally:
        torch.set_num_threads(threads)
    operations, size = floor_of(case, expected)
    min_seconds = operations / rate + size / bandwidth
    message = ", ".join(f"{name} {1000 * second:.0f} ms" for name, second in seconds.items())
    plain_ratio, to_eager = (seconds["ours"] / seconds[array] for array in ("plain", "eager"))
    print_figure(f"{name}, one core: {message}")
    print_figure(
        f"ours / plain {plain_ratio:.2f} (bar {BAR_PLAIN}), ours / eager {to_eager:.2f} (bar {BAR_EAGER})"
    )
    print_figure(
        f"{operations / 1e9:.2f} GFLOP at {rate / 1e9:.0f} GFLOP/s and {size / 1e6:.0f} MB at "
        f"{bandwidth / 1e9:.1f} GB/s: floor {1000 * min_seconds:.0f} ms, ours {seconds['ours'] / min_seconds:.1f} × that"
    )
    assert plain_ratio <= BAR_PLAIN
    assert to_eager <= BAR_EAGER


@pytest.mark.parametrize("make", [ScaffoldDecoder, HexPlane, Avatar])
def bench_assignment(make: Callable[[], GaussianGenerator], tmp_path: Path) -> None:
    """Print which nodes no GPU takes, before the rewrites and after them."""
    static = Settings(level=Level.STATIC)
    goal = RewriteTarget.of(load_target("core"))
    for rewrite in (False, True):
        path = tmp_path / f"{rewrite}.onnx"
        export(make(), path, rewrite=rewrite, settings=static)
        actual = graph_stats(path, goal)
        print_figure(
            f"{make.__name__}, {'rewritten' if rewrite else 'as torch exports it'}: {actual.nodes} nodes, "
        )
        print_figure(f"  not captured by some release: {len(actual.uncaptured)}")
        for line in actual.uncaptured:
            print_figure(f"    {line}")
    assert actual.uncaptured == ()
