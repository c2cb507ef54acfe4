"""Mutate lines of the code, one at a time over all rooms, and run the tests that name the module.

cosmic-ray writes the mutants; a copy of the working tree holds them. A mutant is killed if a test
fails or exceeds the time limit. Prints each survivor as a diff, and exits 1 if fewer mutants than
the bar are killed. A run that was stopped goes on where it was: outcomes are kept in a file, those
of survivors until a test of theirs changes.

    .venv/bin/python scripts/mutants.py --count 300 --seed 0 --minutes 90
"""

import argparse
import difflib
import hashlib
import json
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names
from forked_tests import preload, run_forked

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("contract", "sdk", "runtime", "reference_plugins")
BAR = 0.9
MOST_TEST_FILES = 6
SECONDS = 120
EQUIVALENT = {"", "@final"}
"""Lines that do nothing when the program runs, so that no test can miss them."""
SKIPPED_OPERATORS = ("BitOr", "ExceptionReplacer")
"""Parts of names. Most `|` join types in annotations, where every mutant fails at import; the
replacer of exceptions fails on names with dots."""


@dataclass(frozen=True, slots=True)
class Mutant:
    """A changed module.

    Attributes:
        path: The module, from the repository's root.
        operator: Name of cosmic-ray's operator.
        code: Its mutated code.
        diff: The changed lines.
    """

    path: Path
    operator: str
    code: str
    diff: str


def main() -> int:
    """Run a sample of mutants, and return the exit code."""
    options = _parser().parse_args()
    generator = random.Random(options.seed)
    deadline = time.monotonic() + 60 * options.minutes
    outcomes = ("killed", "survived", "without tests", "tests fail")
    results: dict[str, int] = dict.fromkeys(outcomes, 0)
    known = read_outcomes(options.results)
    with tempfile.TemporaryDirectory(prefix="gsgen-mutants-") as name:
        copy = copy_of_tree(Path(name))
        for package in PACKAGES:
            preload(package)
        for _ in range(options.count):
            if time.monotonic() > deadline:
                break
            mutant = draw(generator, copy)
            key = f"{mutant.path} {mutant.operator} {mutant.diff}"
            tests = tests_of(mutant.path, copy)
            key += f" {_digest(tests, copy)}"
            if key not in known:
                known[key] = evaluate(mutant, tests, copy) if tests else "without tests"
                with options.results.open("a", encoding="utf-8") as file:
                    file.write(json.dumps([key, known[key]]) + "\n")
            outcome = known[key]
            results[outcome] += 1
            print(f"{outcome:<14}{mutant.path} {mutant.operator}", flush=True)
            if outcome != "killed":
                print(mutant.diff, flush=True)
    total = sum(results.values()) - results["tests fail"]
    share = results["killed"] / total if total else 0.0
    print(f"{total} of {options.count} mutants count: {results}; {share:.0%} killed, bar {BAR:.0%}")
    return 0 if total and share >= BAR else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=300, help="number of mutants")
    parser.add_argument("--seed", type=int, default=0, help="seed of the sample")
    parser.add_argument("--minutes", type=float, default=90, help="no mutant starts later")
    results = ROOT / "out" / "mutants.jsonl"
    parser.add_argument("--results", type=Path, default=results, help="outcomes so far")
    return parser


def read_outcomes(path: Path) -> dict[str, str]:
    """Return the outcomes of earlier runs by mutant; create the result file's folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = path.read_text("utf-8").splitlines() if path.exists() else []
    return dict(map(json.loads, lines))


def _digest(tests: Sequence[str], root: Path) -> str:
    """Return a digest of test files, which changes with their names and contents."""
    content = "".join(name + (root / name).read_text("utf-8") for name in tests)
    return hashlib.sha256(content.encode()).hexdigest()[:16]


def copy_of_tree(folder: Path) -> Path:
    """Copy the tracked files into ``folder``, and return the copy's root."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, encoding="utf-8", check=True
    ).stdout
    for name in filter(None, listed.split("\0")):
        target = folder / "tree" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_file():
            shutil.copy(ROOT / name, target)
    return folder / "tree"


def draw(generator: random.Random, root: Path) -> Mutant:
    """Choose a room, a module in it, and a mutation of it; rooms are equally likely."""
    modules = [file for package in PACKAGES for file in (root / package / "gsgen").rglob("*.py")]
    rooms = sorted({file.parent for file in modules})
    names = [n for n in operator_names() if not any(word in n for word in SKIPPED_OPERATORS)]
    while True:
        room = generator.choice(rooms)
        file = generator.choice(sorted(room.glob("*.py")))
        code = file.read_text("utf-8")
        nodes = list(ast_nodes(get_ast(code)))
        generator.shuffle(names)
        for name in names:
            operator_class = get_operator(name)
            if operator_class.arguments():
                continue
            operator = operator_class()
            positions = sum(len(list(operator.mutation_positions(node))) for node in nodes)
            if positions:
                mutated = mutate_code(code, operator, generator.randrange(positions))
                if mutated and _removed(code, mutated) - EQUIVALENT:
                    return Mutant(file.relative_to(root), name, mutated, _diff(code, mutated))


def _removed(before: str, after: str) -> set[str]:
    lines = difflib.ndiff(before.splitlines(), after.splitlines())
    return {line[2:].strip() for line in lines if line.startswith("- ")}


def _diff(before: str, after: str) -> str:
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), n=0, lineterm="")
    return "\n".join(f"    {line}" for line in list(lines)[2:])


def tests_of(path: Path, root: Path) -> list[str]:
    """Return a module's test files: first by name, then by imports, then by related subject."""
    dotted = ".".join(path.with_suffix("").parts[1:])
    files = sorted((root / "tests").rglob("test_*.py"))
    named = [file for file in files if file.stem.removeprefix("test_") == path.stem]
    importing = [file for file in files if dotted in file.read_text("utf-8")]
    # The folders of tests are those of the code, without the import root.
    module_words = _words(path)
    shared = {file: len(module_words & _words(file.relative_to(root))) for file in files}
    related = [file for file in sorted(files, key=lambda file: -shared[file]) if shared[file]]
    selected = list(dict.fromkeys([*named, *importing, *related]))[:MOST_TEST_FILES]
    return [file.relative_to(root).as_posix() for file in selected]


def _words(path: Path) -> set[str]:
    """Return the words of a path's folders and name, without those that all paths have."""
    words = {word.removesuffix("s") for word in re.split(r"[/_]", path.with_suffix("").as_posix())}
    return words - {
        "",
        "gsgen",
        "test",
        "init",
        *(package.removesuffix("s") for package in PACKAGES),
    }


def evaluate(mutant: Mutant, tests: Sequence[str], copy: Path) -> str:
    """Run ``tests`` on a mutant in the copy of the tree, and return the outcome.

    Test files run one after the other, the nearest to the module first. A mutant counts as killed
    only if the test that failed passes on the original.
    """
    target = copy / mutant.path
    original = target.read_text("utf-8")
    target.write_text(mutant.code, "utf-8")
    try:
        failed = next(filter(None, (_failure(file, copy) for file in tests)), None)
    finally:
        target.write_text(original, "utf-8")
    if failed is None:
        return "survived"
    return "killed" if run_forked([failed], copy, PACKAGES, SECONDS).passed else "tests fail"


def _failure(file: str, copy: Path) -> str | None:
    """Return the node id of the first test of a file that fails; None if all pass."""
    result = run_forked([file], copy, PACKAGES, SECONDS)
    return None if result.passed else result.failure or file


if __name__ == "__main__":
    sys.exit(main())
