"""What level behaviour costs beside an earlier commit: a ratio of processor times in one run.

``GSGEN_BASELINE`` names the commit (by default the last one before the moments that manifest and
text name were run), ``GSGEN_BENCH_MODELS`` a folder with models that both read; otherwise plugins
export theirs, without test vectors.
Run by ``make bench``.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from gsgen.sdk import Demo, installed_plugins
from support.processor_time import cpu_seconds

ROOT = Path(__file__).parents[2]
ROOMS = ("contract", "sdk", "runtime", "reference_plugins")
BASELINE = os.environ.get("GSGEN_BASELINE", "ed2f1976")
METHODS = ("static", "hexplane-4dgs", "scaffold-gs", "gauhuman")
MAX_TIME_RATIO = 1.5
ROUNDS = 5


@pytest.fixture(scope="module")
def baseline(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A worktree of the earlier commit."""
    folder = tmp_path_factory.mktemp("baseline") / "tree"
    git = ["git", "-C", str(ROOT), "worktree"]
    subprocess.run([*git, "add", "--detach", "-q", str(folder), BASELINE], check=True)
    yield folder
    subprocess.run([*git, "remove", "--force", str(folder)], check=True)


def environment(tree: Path) -> dict[str, str]:
    """Return an environment in which ``gsgen`` is that of a worktree."""
    rooms = os.pathsep.join(str(tree / room) for room in ROOMS)
    return {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"} | {
        "PYTHONPATH": rooms,
        "PYTHONPYCACHEPREFIX": str(tree.parent / f"bytecode of {tree.name}"),
    }


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Models that the earlier commit can read, too."""
    if folder := os.environ.get("GSGEN_BENCH_MODELS"):
        return sorted(Path(folder).glob("*.onnx"))
    folder, demos = tmp_path_factory.mktemp("models"), dict[str, Demo]()
    for plugin in installed_plugins():
        if plugin.name in METHODS and plugin.demo is not None:
            demos[plugin.name] = plugin.demo
    paths = []
    for name, demo in demos.items():
        files, path = folder / name, folder / f"{name}.onnx"
        files.mkdir()
        command = [sys.executable, "-m", "gsgen.cli", "export", name, *demo.write(files)]
        options = ["--vectors", "0", "-o", str(path)]
        subprocess.run([*command, *options], check=True, env=environment(ROOT))
        paths.append(path)
    return paths


def bench_behaviour_beside_an_earlier_commit(baseline: Path, models: list[Path]) -> None:
    before, now = environment(baseline), environment(ROOT)
    ratios = {}
    for path in models:
        command = [sys.executable, "-m", "gsgen.cli", "validate", str(path)]
        for warm_up in (before, now):
            cpu_seconds(command, warm_up)
        pairs = [(cpu_seconds(command, before), cpu_seconds(command, now)) for _ in range(ROUNDS)]
        old, new = (min(times) for times in zip(*pairs, strict=True))
        ratios[path.name] = new / old
        text = f"{path.name}: {new:.2f} s, {new / old:.2f} × {BASELINE} (bar {MAX_TIME_RATIO})"
        sys.stdout.write(f"\n  behaviour of {text}")
    assert max(ratios.values()) <= MAX_TIME_RATIO
