"""Fuzz the reader and the validator of tilesets: mutants are judged or refused, within bounds.

Run by ``make fuzz-tiles``. Mutants are judged in a process with a bound on its memory and on the
time of each, which goes on behind one that dies. What failed is kept in out/fuzz-tiles.
"""

__all__ = ["Trial", "judge", "main", "mutant"]

import argparse
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.contract import Level, Settings
from gsgen.contract.errors import GsgenError
from gsgen.tiles.loading.info import describe_tileset
from gsgen.tiles.stores.zip_store import write_archive
from gsgen.tiles.validation.fixtures import tiles_fixtures
from gsgen.tiles.validation.validate import validate
from support.tiles import foreign_tiles as foreign

MEMORY = 1 << 30
"""Bytes of data that judging small files may take, beyond what the imports have taken."""
SECONDS = 20
FOLDER = Path("out/fuzz-tiles")
_ENVIRONMENT = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
_INDEX = "tileset.json"
_VALUES: tuple[Any, ...] = (
    None, True, "", "x", "../a", "tileset.json", "s/{level}.json", -1, 0, 1, 2, 0.5, 255,
    1e9, 2**31, 2**32, 2**53, 2**63, 1e300, -1e300, 1e-300, [], {}, [0] * 12, [1] * 16,
    [1e300] * 12, "data:;base64,AAAA", "data:,", "QUADTREE", "OCTREE", "ADD", [[]], "\0",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Trial:
    """What judging a mutant came to, and what was wrong with that."""

    kind: str
    failure: str = ""


class _Late(BaseException):
    """Judging took too long; nothing catches it."""


@cache
def valid_tilesets() -> tuple[dict[str, bytes], ...]:
    """Return what is damaged: tilesets as files by name."""
    sets = []
    for fixture in tiles_fixtures():
        if fixture.rule in ("", "GT009", "GT019") and "neural" not in fixture.name:
            with tempfile.TemporaryDirectory() as folder:
                root = fixture.write(Path(folder)).parent
                sets.append(_files(root))
    cloud = foreign.cloud(1, degree=1)
    leaf = {
        "boundingVolume": {"region": [0.1, 0.2, 0.3, 0.4, 0, 50]},
        "geometricError": 0,
        "content": {"uri": "b.gltf"},
    }
    outer_tileset = {
        "boundingVolume": {"sphere": [0, 0, 0, 9e6]},
        "geometricError": 9,
        "refine": "ADD",
        "content": {"uri": "a.glb"},
        "children": [{**leaf, "content": {"uri": "in/tileset.json"}}, leaf],
    }
    sets.append(
        {
            _INDEX: foreign.tileset(outer_tileset),
            "in/tileset.json": foreign.tileset(
                {**leaf, "refine": "ADD", "content": {"uri": "../a.glb"}}
            ),
            "a.glb": foreign.gltf(cloud),
            "b.gltf": foreign.gltf(cloud, embedded=True),
        }
    )
    return tuple(sets)


def _files(root: Path) -> dict[str, bytes]:
    return {
        file.relative_to(root).as_posix(): file.read_bytes()
        for file in sorted(root.rglob("*"))
        if file.is_file()
    }


def mutant(seed: int, case: int) -> tuple[dict[str, bytes], bool]:
    """Return the files of a mutant, always the same, and whether they are to be packed."""
    rng = np.random.default_rng([seed, case])
    files = dict(valid_tilesets()[int(rng.integers(len(valid_tilesets())))])
    packed = bool(rng.random() < 0.1)
    for _ in range(int(rng.integers(1, 4))):
        name = sorted(files)[int(rng.integers(len(files)))]
        if rng.random() < 0.4:
            name = _INDEX
        files[name] = _damage(files[name], name, rng)
    return files, packed


def _damage(data: bytes, name: str, rng: np.random.Generator) -> bytes:
    if name.endswith((".json", ".gltf")) and rng.random() < 0.85:
        return _edited(data, rng)
    if name.endswith(".glb") and rng.random() < 0.5 and len(data) > 20:
        size = int.from_bytes(data[12:16], "little")
        text = _edited(data[20 : 20 + size], rng)
        text += b" " * (-len(text) % 4)
        remaining = data[20 + size :]
        head = b"glTF" + (2).to_bytes(4, "little")
        head += (20 + len(text) + len(remaining)).to_bytes(4, "little")
        return head + len(text).to_bytes(4, "little") + b"JSON" + text + remaining
    if name.endswith(".subtree") and rng.random() < 0.5 and len(data) > 24:
        size = int.from_bytes(data[8:16], "little")
        text = _edited(data[24 : 24 + size], rng)
        text += b" " * (-len(text) % 8)
        remaining = data[24 + size :]
        sizes = len(text).to_bytes(8, "little") + data[16:24]
        return data[:8] + sizes + text + remaining
    return _bytes(data, rng)


def _edited(data: bytes, rng: np.random.Generator) -> bytes:
    """Change values of JSON; what is no JSON any more has its bytes changed."""
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        return _bytes(data, rng)
    places: list[tuple[Any, Any]] = []
    pending = [document]
    while pending:
        container = pending.pop()
        keys = container if isinstance(container, dict) else range(len(container))
        for key in keys:
            places.append((container, key))
            if isinstance(container[key], dict | list):
                pending.append(container[key])
    if not places:
        return _bytes(data, rng)
    container, key = places[int(rng.integers(len(places)))]
    other, another = places[int(rng.integers(len(places)))]
    choice = rng.random()
    if choice < 0.15 and isinstance(container, dict):
        del container[key]
    elif choice < 0.3:
        container[key] = json.loads(json.dumps(other[another]))
    elif choice < 0.4 and isinstance(container[key], int | float):
        container[key] = container[key] * float(rng.choice([-1, 0.5, 2, 1e6, 1e-6]))
    elif choice < 0.43:
        return b"[" * int(rng.choice([500, 5000, 100_000])) + data
    else:
        container[key] = _VALUES[int(rng.integers(len(_VALUES)))]
    return json.dumps(document).encode()


def _bytes(data: bytes, rng: np.random.Generator) -> bytes:
    body = bytearray(data)
    choice = rng.random()
    if not body or choice < 0.1:
        return bytes(rng.integers(0, 256, 40, dtype=np.uint8))
    offset = int(rng.integers(len(body)))
    if choice < 0.3:
        del body[offset:]
    elif choice < 0.4:
        body[offset:offset] = rng.bytes(int(rng.integers(1, 64)))
    elif choice < 0.6:
        offset = int(rng.integers(min(len(body), 64)))
        body[offset : offset + 4] = int(rng.choice([0, 1, 2**31 - 1, 2**32 - 1])).to_bytes(
            4, "little"
        )
    else:
        for _ in range(int(rng.integers(1, 8))):
            body[int(rng.integers(len(body)))] ^= 1 << int(rng.integers(8))
    return bytes(body)


def judge(folder: Path, files: dict[str, bytes], *, packed: bool) -> Trial:
    """Validate and describe a mutant, and say what came of it."""
    for name, data in files.items():
        path = folder / "set" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    source = folder / "set" / _INDEX
    if packed:
        source = folder / "set.3tz"
        write_archive(folder / "set", source)
        rng = np.random.default_rng(len(files[_INDEX]))
        source.write_bytes(_bytes(source.read_bytes(), rng))
    kinds = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for action in (_validate, describe_tileset):
            trial = _run_guarded(action, source)
            if trial.failure:
                return trial
            kinds.append(trial.kind)
    return Trial(kinds[0])


def _validate(source: Path) -> Any:
    report = validate(source, Settings(level=Level.VALUES))
    for outcome in report.outcomes:
        if outcome.status == "crashed":
            raise AssertionError(f"{outcome.rule.id} crashed: {outcome.reason}")
    return report.verdict


def _run_guarded(action: Callable[[Path], Any], source: Path) -> Trial:
    try:
        result = action(source)
    except GsgenError as error:
        if len(str(error)) > 2000 or not error.where:
            return Trial("refused", f"an error that is too long or names no file: {error}")
        return Trial("refused")
    except Exception as error:
        return Trial("raised", f"{type(error).__name__}: {error}")
    return Trial(result if isinstance(result, str) else "described")


def main() -> int:
    """Run as the command line says; 1 where something failed."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.tilesets", description=__doc__)
    parser.add_argument("--count", type=int, default=2000, help="how many mutants")
    parser.add_argument("--seed", type=int, default=0, help="another seed, other mutants")
    parser.add_argument("--first", type=int, default=0, help=argparse.SUPPRESS)
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        return _work(arguments.count, arguments.seed, arguments.first)
    return 1 if _run(arguments.count, arguments.seed) else 0


def _run(count: int, seed: int) -> int:
    """Judge mutants in other processes; return how many failed."""
    start_time, first, peak, kinds = time.monotonic(), 0, 0, Counter[str]()
    failures: dict[int, str] = {}
    while first < count:
        words = ["--worker", "--count", count, "--seed", seed, "--first", first]
        command = [sys.executable, "-m", "fuzz.tilesets", *map(str, words)]
        completed = subprocess.run(command, capture_output=True, text=True, env=_ENVIRONMENT)
        for line in completed.stdout.splitlines():
            document = json.loads(line)
            first = document["case"] + 1
            kinds[document["kind"]] += 1
            peak = max(peak, document["peak"])
            if document["failure"]:
                failures[document["case"]] = document["failure"]
        if first < count:  # it died over this one
            failures[first] = f"ended with {completed.returncode}: {completed.stderr[-500:]}"
            kinds["died"] += 1
            first += 1
    for case, failure in failures.items():
        _save_failure(seed, case, failure)
    most = ", ".join(f"{kind} {number}" for kind, number in kinds.most_common())
    sys.stdout.write(
        f"{count} mutants in {time.monotonic() - start_time:.0f} s, {len(failures)} failed, "
        f"{peak >> 20} MiB at most; {most}\n"
    )
    for case, failure in [*failures.items()][:5]:
        sys.stdout.write(f"  {case}: {failure[-400:]}\n")
    return len(failures)


def _save_failure(seed: int, case: int, failure: str) -> None:
    folder = FOLDER / f"{seed}-{case}"
    shutil.rmtree(folder, ignore_errors=True)
    for name, data in mutant(seed, case)[0].items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    (folder / "failure.txt").write_text(failure)


def _work(count: int, seed: int, first: int) -> int:
    """Judge mutants, and write a line of JSON about each."""
    valid_tilesets()
    used = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[5]) * os.sysconf(
        "SC_PAGE_SIZE"
    )
    resource.setrlimit(resource.RLIMIT_DATA, (used + MEMORY, used + MEMORY))
    signal.signal(signal.SIGALRM, _stop)
    for case in range(first, count):
        with tempfile.TemporaryDirectory() as folder:
            signal.alarm(SECONDS)
            try:
                files, packed = mutant(seed, case)
                trial = judge(Path(folder), files, packed=packed)
            except _Late:
                trial = Trial("late", f"took longer than {SECONDS} s")
            finally:
                signal.alarm(0)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
        line = {"case": case, "kind": trial.kind, "failure": trial.failure, "peak": peak}
        sys.stdout.write(json.dumps(line) + "\n")
        sys.stdout.flush()
    return 0


def _stop(*_: object) -> None:
    raise _Late


if __name__ == "__main__":
    sys.exit(main())
