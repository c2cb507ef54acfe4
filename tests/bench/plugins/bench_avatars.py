"""What a frame of the avatar plugins costs, against eager torch of the same module.

One thread for both, bodies of the size of SMPL and SMPL-X. Run by ``make bench``.
"""

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch

from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins.people.gauhuman import GauHuman
from gsgen.reference_plugins.people.gauhuman_checkpoint import read_gauhuman
from gsgen.reference_plugins.people.lhm import LHM
from gsgen.reference_plugins.people.lhm_checkpoint import read_lhm
from gsgen.reference_plugins.people.r3_avatar import R3Avatar
from gsgen.reference_plugins.people.r3_avatar_checkpoint import read_r3
from gsgen.reference_plugins.synthetic import PersonOptions, write_gauhuman, write_lhm, write_r3
from gsgen.sdk import GaussianGenerator, export
from gsgen.sdk.authoring.packed_module import Packed, PackedGenerator
from support.measures import print_figure, process_seconds
from support.models import needed_tensors

MAX_EAGER_RATIO = 1.0
SIZE_BAR = 1.05
ROUNDS = 31
SMPL, SMPLX = 6_890, 10_475


def feeds(generator: GaussianGenerator) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    results: dict[str, np.ndarray] = {}
    for declared in generator.inputs:
        assert declared.shape is not None
        value = rng.normal(0, 0.3, declared.shape).astype(np.float32)
        if declared.role == "root_rotation":
            value = np.eye(3, dtype=np.float32)
        results[declared.name] = np.zeros(1, np.int32) if declared.role == "frame_index" else value
    return results


def measure(
    generator: GaussianGenerator,
    folder: Path,
    needed: int,
    eager_form: GaussianGenerator | None = None,
) -> float:
    """Export, run both by turns, print, hold both against their bars; return seconds a frame.

    Args:
        generator: What is exported.
        folder: Where to.
        needed: Bytes of the tensors that it cannot do without.
        eager_form: The module in torch's fastest form, all constants computed beforehand.
    """
    original = eager_form or generator
    path = folder / "model.onnx"
    export(generator, path, settings=Settings(level=Level.STATIC))
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options)
    inputs = feeds(generator)
    tensors = [torch.from_numpy(value) for value in inputs.values()]
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.no_grad():
            rows = original(*tensors).position.shape[0]
            packed = PackedGenerator(original, Packed(torch.float32, rows))
            packed(*tensors)
            session.run(None, inputs)
            eager, graph = [], []
            for _ in range(ROUNDS):  # by turns, so that both meet the same machine
                eager.append(process_seconds(lambda: packed(*tensors)))
                graph.append(process_seconds(lambda: session.run(None, inputs)))
    finally:
        torch.set_num_threads(threads)
    outputs = session.run(None, inputs)
    target = np.empty(sum(output.nbytes for output in outputs) // 4, np.float32)
    min_seconds = min(process_seconds(lambda: target.fill(1)) for _ in range(ROUNDS))
    weights = sum(len(weight.raw_data) for weight in onnx.load(path).graph.initializer)
    ratio, size = min(graph) / min(eager), path.stat().st_size
    print_figure(
        f"{rows:,} Gaussians: graph {1e3 * min(graph):.2f} ms, eager {1e3 * min(eager):.2f} ms, "
    )
    print_figure(
        f"ratio {ratio:.2f} (bar {MAX_EAGER_RATIO}); {min(graph) / min_seconds:.1f} × writing the outputs, "
    )
    print_figure(f"{1e9 * min(graph) / rows:.0f} ns a Gaussian; file {size / 1e6:.1f} MB, ")
    print_figure(
        f"{size / needed:.3f} × the tensors that it needs (bar {SIZE_BAR}), {weights} B stored"
    )
    assert ratio <= MAX_EAGER_RATIO
    assert size <= SIZE_BAR * needed
    return min(graph)


def bench_gauhuman(tmp_path: Path) -> None:
    options = PersonOptions(count=40_000, vertices=SMPL, nets=True, width=128)
    read = read_gauhuman(write_gauhuman(tmp_path / "run", options))
    parts = (read.canonical, read.body, read.nets)
    minimum_bytes = needed_tensors.of_gauhuman(*parts)
    measurement = measure(
        GauHuman(*parts), tmp_path, minimum_bytes, GauHuman(*parts, bake="always")
    )
    baked = GauHuman(*parts, bodies=5, bake="always")
    few_bodies = measure(GauHuman(*parts, bodies=5), tmp_path, minimum_bytes, baked)
    print_figure(f"5 instances cost {few_bodies / measurement:.2f} × one")


def bench_lhm(tmp_path: Path) -> None:
    read = read_lhm(write_lhm(tmp_path / "run", PersonOptions(count=40_000, vertices=SMPLX)))
    measure(LHM(read), tmp_path, needed_tensors.of_lhm(read), LHM(read, bake="always"))


def bench_r3_avatar(tmp_path: Path) -> None:
    options = PersonOptions(
        count=23_000, vertices=SMPL, nets=True, width=128, channels=32, resolution=(64, 64, 64, 50)
    )
    read = read_r3(write_r3(tmp_path / "run", options))
    generator = R3Avatar(read, range(4))
    measure(generator, tmp_path, needed_tensors.of_r3(read, generator.near.shape[0]))
