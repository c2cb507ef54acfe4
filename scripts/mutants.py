"""Mutate lines of the code, one at a time over all rooms, and run the tests nearest to each.

cosmic-ray writes the mutants; a copy of the working tree holds them. A mutant is killed if a test
fails that passes on the original, or takes five times as long as there and exceeds the limit.
Prints each survivor as a diff, and exits 1 if fewer mutants than the bar are killed. A run that
was stopped goes on where it was: outcomes are kept in a file, those of survivors until a test of
theirs changes. mutation/survivors.toml has the reasons of survivors that no test can kill: these
count as survivors, and run no test.

    .venv/bin/python scripts/mutants.py --count 300 --seed 0 --minutes 90
"""

import argparse
import compileall
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Sequence
from pathlib import Path
from py_compile import PycInvalidationMode
from typing import Any

from mutation.forks import CPU_SECONDS, CollectedTests, FreshTests, TestRun, prepare
from mutation.patching import changed_functions
from mutation.sampling import PACKAGES, Mutant, draw
from mutation.selection import SuiteFiles

ROOT = Path(__file__).resolve().parents[1]
BAR = 0.9
MOST_BAD_TESTS = 8
"""Tests that fail on the original, too, before a mutant is given up."""
OUTCOMES = ("killed", "survived", "without tests", "tests fail")


class Judge:
    """Decides whether tests kill mutants.

    Attributes:
        known: Processor time of the tests that ran so far, in seconds.
    """

    def __init__(self, copy: Path, seconds: Path) -> None:
        self.copy = copy
        self.tests = SuiteFiles(copy)
        self._file = seconds
        self.known: dict[str, float] = read_outcomes(seconds)
        self._good: set[str] = set()
        """Tests that pass on the original."""
        prepare(copy)
        self._fresh = FreshTests()
        self._collected = CollectedTests(list(self.tests.texts))
        self.tests.node_ids.extend(self._collected.node_ids)

    def outcome(self, mutant: Mutant, files: Sequence[str]) -> str:
        """Run test files on a mutant, and return the outcome."""
        target = self.copy / mutant.path
        original = target.read_text("utf-8")
        for _ in range(MOST_BAD_TESTS):
            target.write_text(mutant.code, "utf-8")
            try:
                run = self._run(mutant, original, str(target), files)
            finally:
                target.write_text(original, "utf-8")
            node = run.failure or run.hung
            if node is None:
                return "survived"
            if self._passes_on_original(node, is_slow=run.failure is None):
                return "killed"
            print(f"     fails on the original, and runs no more: {node}", flush=True)
            self.known[node.partition("[")[0]] = float("inf")
        return "tests fail"

    def _run(self, mutant: Mutant, original: str, target: str, files: Sequence[str]) -> TestRun:
        changes = changed_functions(original, mutant.code, target)
        first = self.tests.parameters(mutant)
        run = None if changes is None else self._collected.run(files, self.known, changes, first)
        if run is None:  # code that runs at import, or a module that no test file imports
            run = self._fresh.run(files, self.known, first)
        self.known |= run.seconds
        with self._file.open("a", encoding="utf-8") as file:
            file.writelines(json.dumps(entry) + "\n" for entry in run.seconds.items())
        return run

    def _passes_on_original(self, node: str, *, is_slow: bool) -> bool:
        if node in self._good and not is_slow:
            return True
        run = self._collected.run([node], {}, []) or TestRun(failure=node)
        if run.failure or run.hung:
            return False
        self._good.add(node)
        return not is_slow or sum(run.seconds.values()) < CPU_SECONDS / 5

    def close(self) -> None:
        """End the process of fresh tests."""
        self._fresh.close()


def main() -> int:
    """Run a sample of mutants, and return the exit code."""
    options = _parser().parse_args()
    options.results = options.results.resolve()  # forks have other working directories
    deadline = time.monotonic() + 60 * options.minutes
    results: dict[str, int] = dict.fromkeys(OUTCOMES, 0)
    known = read_outcomes(options.results)
    with tempfile.TemporaryDirectory(prefix="gsgen-mutants-") as name:
        seconds = options.results.with_suffix(".seconds.jsonl")
        judge = Judge(copy_of_tree(Path(name)), seconds)
        for number in range(options.first, options.first + options.count):
            if time.monotonic() > deadline:
                break
            mutant = draw(options.seed, number, judge.copy)
            key = f"{mutant.path} {mutant.operator} {mutant.diff}"
            files: list[str] = []
            if known.get(key) != "killed":
                files = judge.tests.nearest(mutant)
                key += f" {_digest(files, judge.copy)}"
            if reason(mutant):
                known[key] = "survived"
            elif known.get(key, "tests fail") == "tests fail":
                known[key] = judge.outcome(mutant, files) if files else "without tests"
                saved = key if known[key] != "killed" else key.rpartition(" ")[0]
                with options.results.open("a", encoding="utf-8") as file:
                    file.write(json.dumps([saved, known[key]]) + "\n")
            results[known[key]] += 1
            print(f"{number:>4} {known[key]:<14}{mutant.path} {mutant.operator}", flush=True)
            if known[key] != "killed":
                print(f"{mutant.diff}\n     {reason(mutant) or ' '.join(files)}", flush=True)
        judge.close()
    total = sum(results.values()) - results["tests fail"]
    share = results["killed"] / total if total else 0.0
    print(f"{total} of {options.count} mutants count: {results}; {share:.0%} killed, bar {BAR:.0%}")
    return 0 if total and share >= BAR else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=300, help="number of mutants")
    parser.add_argument("--first", type=int, default=0, help="number of the first mutant")
    parser.add_argument("--seed", type=int, default=0, help="seed of the sample")
    parser.add_argument("--minutes", type=float, default=90, help="no mutant starts later")
    results = ROOT / "out" / "mutants.jsonl"
    parser.add_argument("--results", type=Path, default=results, help="outcomes so far")
    return parser


def read_outcomes(path: Path) -> dict[str, Any]:
    """Return what earlier runs wrote, by mutant or test; create the file's folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = path.read_text("utf-8").splitlines() if path.exists() else []
    return dict(map(json.loads, lines))


def reason(mutant: Mutant) -> str | None:
    """Return why a mutant is known to survive, from scripts/mutation/survivors.toml."""
    document = tomllib.loads((ROOT / "scripts/mutation/survivors.toml").read_text("utf-8"))
    lines = {line.strip("+ ") for line in mutant.diff.splitlines() if line.startswith("    +")}
    for entry in document["survivor"]:
        if entry["path"] == mutant.path.as_posix() and entry["line"] in lines:
            return str(entry["reason"])
    return None


def _digest(tests: Sequence[str], root: Path) -> str:
    """Return a digest of test files, which changes with their names and contents."""
    content = "".join(name + (root / name).read_text("utf-8") for name in tests)
    return hashlib.sha256(content.encode()).hexdigest()[:16]


def copy_of_tree(folder: Path) -> Path:
    """Copy the tracked files into ``folder``, compile them, and return the copy's root."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, encoding="utf-8", check=True
    ).stdout
    for name in filter(None, listed.split("\0")):
        target = folder / "tree" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_file():
            shutil.copy(ROOT / name, target)
    mode = PycInvalidationMode.CHECKED_HASH  # bytecode of a mutant's original does not count
    for package in PACKAGES:
        compileall.compile_dir(folder / "tree" / package, quiet=2, invalidation_mode=mode)
    os.environ.setdefault("GSGEN_SHARED", str(ROOT.parent / "shared"))
    return folder / "tree"


if __name__ == "__main__":
    sys.exit(main())
