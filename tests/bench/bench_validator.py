"""What validation costs, as ratios against a baseline measured in the same run.

Printed and asserted against the project's bars; run by ``make bench``, never by ``make test``.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import onnx.parser
import pytest

from gsgen.conformance.fixtures import find
from gsgen.contract.reporters.json_report import to_json
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.formats import PackedRows
from gsgen.reference_plugins.static.static import from_content
from support.measures import print_figure
from support.models.static_scenes import write_scene
from support.processor_time import cpu_seconds

MEBIBYTE = 1 << 20
MILLION = 1_000_000


def best(action: Callable[[], object], times: int = 5) -> float:
    """Return the shortest of several runs, in seconds."""
    durations = []
    for _ in range(times):
        start_time = time.perf_counter()
        action()
        durations.append(time.perf_counter() - start_time)
    return min(durations)


def million(dtype: type, degree: int) -> PackedRows:
    rng = np.random.default_rng(0)
    rows = np.zeros((MILLION, 10), dtype)
    rows[:, :3] = rng.normal(size=(MILLION, 3))
    rows[:, 3] = rng.uniform(0.1, 1, MILLION)
    root = rng.normal(size=(MILLION, 3, 3)).astype(np.float32) * 0.2
    full = root @ root.transpose(0, 2, 1)
    rows[:, 4:] = full[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    color = (0.1 * rng.standard_normal((MILLION, 3 * (degree + 1) ** 2), np.float32)).astype(dtype)
    return PackedRows(rows, color)


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model of 232 MB: a million Gaussians, SH of degree 3, float32."""
    path = tmp_path_factory.mktemp("large") / "large.onnx"
    write_scene(from_content(million(np.float32, 3)), path)
    return path


@pytest.fixture(scope="module")
def half(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("half") / "half.onnx"
    write_scene(from_content(million(np.float16, 3)), path)
    return path


@pytest.mark.parametrize("words", [("--help",), ("validate", "--level", "static")])
def bench_cold_start(words: tuple[str, ...], tmp_path: Path) -> None:
    path = tmp_path / "small.onnx"
    rows = million(np.float32, 0)
    small = PackedRows(rows.gaussians[:100], rows.appearance[:100])
    write_scene(from_content(small), path)
    command = [sys.executable, "-m", "gsgen.cli", *words]
    command += [str(path)] if words[0] == "validate" else []
    seconds = best(lambda: subprocess.run(command, check=True, capture_output=True), 7)
    print_figure(f"cold start, gsgen {' '.join(words)}: {seconds:.2f} s (bar 0.6)")
    assert seconds <= 0.6


@pytest.mark.parametrize(("compiled", "bar"), [(True, 1.7), (False, 2.2)])
def bench_start_of_static_beside_the_import_of_onnx(
    tmp_path: Path, *, compiled: bool, bar: float
) -> None:
    """An installed package has bytecode; a checkout that may not write any is compiled anew."""
    path = find("still_sh0").write(tmp_path)
    command = [sys.executable, "-m", "gsgen.cli", "validate", "--level", "static", str(path)]
    imported = [sys.executable, "-c", "import onnx"]
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    if compiled:
        environment["PYTHONPYCACHEPREFIX"] = str(tmp_path)
    else:
        environment["PYTHONDONTWRITEBYTECODE"] = "1"
    for warm_up in (imported, command):
        cpu_seconds(warm_up, environment)
    pairs = [
        (cpu_seconds(imported, environment), cpu_seconds(command, environment)) for _ in range(9)
    ]
    baseline, ours = (min(times) for times in zip(*pairs, strict=True))
    words = "with bytecode" if compiled else "without bytecode"
    print_figure(
        f"processor time of validate --level static, {words}: {ours / baseline:.2f} × import onnx"
    )
    print_figure(f"  bar {bar}")
    assert ours <= bar * baseline


def bench_static_on_a_large_model(large: Path) -> None:
    settings = Settings(level=Level.STATIC)
    validate(large, settings)  # imports and caches
    ours = best(lambda: validate(large, settings))
    load = best(lambda: onnx.load(large), 3)
    size = large.stat().st_size / MEBIBYTE
    print_figure(
        f"static on {size:.0f} MiB: {1000 * ours:.1f} ms, onnx.load {1000 * load:.0f} ms, "
    )
    print_figure(f"ratio {ours / load:.4f} (bar 0.3)")
    assert ours <= 0.3 * load


def peak_megabytes(level: str, path: Path) -> float:
    """Return the peak memory of the largest process of ``gsgen validate``, in megabytes."""
    command = [sys.executable, "-m", "gsgen.cli", "validate", "--level", level, str(path)]
    # Started by a small process: a child begins with the peak of the process that it came from.
    launch = (
        "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True, "
        "stdout=subprocess.DEVNULL); "
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    completed = subprocess.run(
        [sys.executable, "-c", launch, *command], check=True, capture_output=True, text=True
    )
    return int(completed.stdout) * 1024 / 1e6


def bench_memory_of_static_on_a_large_model(large: Path) -> None:
    peak = peak_megabytes("static", large)
    print_figure(f"peak memory of the whole process, 232 MB model: {peak:.0f} MB (bar 150)")
    assert peak <= 150


def external_weights(path: Path, kind: str) -> float:
    """Write a model of 30 or 90 external weights, used as ``kind`` says; return their megabytes."""
    model, size = find("drift").draw().build(), 2048
    graph, is_half = model.graph, kind == "float16"
    count = 90 if is_half else 30
    [last] = [node for node in graph.node if "color" in node.output]
    last.output[0] = "flat"
    values = {"ones": np.ones((1, size), np.float32), "tiny": np.float32([1e-3])}
    values["shape"] = np.array([1, 1])
    graph.initializer.extend(onnx.numpy_helper.from_array(v, name) for name, v in values.items())
    nodes = ["moment = Reshape (time, shape)", "x0 = Mul (moment, ones)"]
    rng, offset = np.random.default_rng(0), 0
    with (path.parent / "weights.bin").open("wb") as file:
        for index in range(count):
            weights = rng.standard_normal((size, size), np.float32) / 50
            data = weights.astype(np.float16 if is_half else np.float32).tobytes()
            file.write(data)
            name, tensor = f"w{index}", graph.initializer.add()
            tensor.name, tensor.data_type = name, 10 if is_half else 1
            tensor.data_location = 1
            tensor.dims.extend([size, size])
            facts = {"location": "weights.bin", "offset": str(offset), "length": str(len(data))}
            for key, value in facts.items():
                tensor.external_data.add(key=key, value=value)
            offset += len(data)
            if kind == "transposed":
                nodes.append(f"{name}t = Transpose <perm = [1, 0]> ({name})")
                name += "t"
            if is_half:
                nodes.append(f"{name}f = Cast <to = 1> ({name})")
                name += "f"
            if kind == "scaled":
                nodes.append(f"{name}s = Mul ({name}, tiny)")
                name += "s"
            nodes.append(f"x{index + 1} = MatMul (x{index}, {name})")
    nodes += [f"mean = ReduceMean <keepdims = 1> (x{count})", "shade = Mul (mean, tiny)"]
    nodes.append("color = Add (flat, shade)")
    graph.node.extend(onnx.parser.parse_node(node) for node in nodes)
    path.write_bytes(model.SerializeToString())
    return offset / 1e6


@pytest.mark.parametrize("kind", ["plain", "transposed", "scaled", "float16"])
def bench_memory_of_values_on_external_weights(tmp_path: Path, kind: str) -> None:
    weights = external_weights(tmp_path / "large.onnx", kind)
    peak = peak_megabytes("values", tmp_path / "large.onnx")
    bar = 1.2 * weights + 500
    print_figure(f"level values, {weights:.0f} MB of external weights, {kind}: peak {peak:.0f} MB")
    print_figure(f"  {peak / weights:.2f} × the weights (bar {bar:.0f} MB)")
    assert peak <= bar


def values_seconds(path: Path) -> tuple[float, str]:
    """Return the time of everything but ONNX Runtime's process, and the JSON report."""
    durations = []
    for _ in range(3):
        report = validate(path, Settings(level=Level.VALUES))
        durations.append(report.seconds - report.runtime_seconds)
    return min(durations), to_json([report])


def bench_values_of_a_million_and_a_million_broken(half: Path, tmp_path: Path) -> None:
    clean, _ = values_seconds(half)
    bytes_checked = MILLION * (10 + 48) * 2
    rate = bytes_checked / clean / 1e6
    print_figure(
        f"values of 1 M Gaussians, SH3 float16: {1000 * clean:.0f} ms, {rate:.0f} MB/s (bar 500)"
    )
    baseline = best(lambda: np.isfinite(np.ones((MILLION, 58), np.float16)).all(), 3)
    print_figure(f"for scale, one np.isfinite over as many values: {1000 * baseline:.0f} ms")
    content = million(np.float16, 3)
    content.gaussians[:, 3] = 5  # GV003
    content.gaussians[:, 4] = -1  # GV005
    content.appearance[::2, 7] = np.nan  # GV001
    write_scene(from_content(content), tmp_path / "broken.onnx")
    broken, text = values_seconds(tmp_path / "broken.onnx")
    findings = json.loads(text)["findings"]
    counted = {finding["rule"]: finding["stats"]["count"] for finding in findings}
    print_figure(
        f"a million broken rows: {1000 * broken:.0f} ms, {broken / clean:.2f} × clean (bar 3)"
    )
    print_figure(f"findings {counted}, report {len(text) / 1000:.1f} kB (bar 20)")
    assert rate >= 500
    assert broken <= 3 * clean
    assert len(text) < 20_000
    assert len(findings) == len(counted) == 3
