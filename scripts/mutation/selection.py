"""Chooses the test files that are nearest to a mutant."""

import ast
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from mutation.sampling import PACKAGES, Mutant

MOST_FILES = 8
STEP_SCORES = (0.0, 6.0, 4.0, 2.5, 1.5, 0.5)
"""Scores of a test file by the number of imports between it and the module."""
SLOW_TESTS = (
    "tests/bench/",
    "tests/cli/house_rules/test_encodings.py",
    "tests/cli/house_rules/test_robustness.py",
    "tests/docs/",
    "tests/fuzz/",
    "tests/packaging/",
    "tests/web/",
)
"""Tests that run whole programs for minutes."""


@dataclass(frozen=True)
class SuiteFiles:
    """The test files of a tree.

    Attributes:
        root: The tree.
    """

    root: Path

    @cached_property
    def texts(self) -> dict[str, str]:
        """Texts of the test files, by their paths from the root."""
        files = sorted((self.root / "tests").rglob("test_*.py"))
        names = [file.relative_to(self.root).as_posix() for file in files]
        return {
            name: (self.root / name).read_text("utf-8")
            for name in names
            if not name.startswith(SLOW_TESTS)
        }

    @cached_property
    def _modules(self) -> dict[Path, str]:
        """Texts of the modules, by their paths from the root."""
        files = [x for package in PACKAGES for x in (self.root / package / "gsgen").rglob("*.py")]
        return {file.relative_to(self.root): file.read_text("utf-8") for file in files}

    @cached_property
    def _distances(self) -> dict[str, dict[str, int]]:
        """The number of imports between each test file and the modules that it reaches."""
        names = {".".join(path.with_suffix("").parts[1:]): path for path in self._modules}
        support = {
            ".".join(file.relative_to(self.root / "tests").with_suffix("").parts): file
            for file in (self.root / "tests").rglob("*.py")
        }
        texts = {name: self._modules[path] for name, path in names.items()}
        texts |= {name: file.read_text("utf-8") for name, file in support.items()}
        graph = {name: _named(text) & texts.keys() for name, text in texts.items()}
        return {
            file: _steps(file.removeprefix("tests/").removesuffix(".py").replace("/", "."), graph)
            for file in self.texts
        }

    def nearest(self, mutant: Mutant) -> list[str]:
        """Return the nearest test files, by names of functions, imports and subject."""
        dotted = ".".join(mutant.path.with_suffix("").parts[1:])
        mentions = [
            {file for file, text in self.texts.items() if re.search(rf"\b{re.escape(x)}\b", text)}
            for x in definitions_at(self._modules[mutant.path], mutant.diff)
        ]
        words, stem_words = _words(mutant.path), _words(Path(mutant.path.stem))
        scores = {}
        for name in self.texts:
            stem = Path(name).stem.removeprefix("test_")
            steps = self._distances[name].get(dotted, len(STEP_SCORES))
            scores[name] = (
                8.0 * (stem == mutant.path.stem.lstrip("_"))
                + sum(STEP_SCORES[steps : steps + 1])
                + sum(10 / (1 + len(files)) for files in mentions if name in files)
                + 0.5 * len(words & _words(Path(name)))
                + 1.0 * len(stem_words & _words(Path(stem)))
            )
        nearest = sorted(scores, key=lambda name: -scores[name])[:MOST_FILES]
        return [name for name in nearest if scores[name] > 0]


def _named(text: str) -> set[str]:
    """Return the dotted names in a module, with what `from a.b import c` may name."""
    names = set(re.findall(r"\b(?:gsgen|support)(?:\.\w+)+", text))
    for module, imported in re.findall(r"from ([\w.]+) import \(?([\w, \n]+)", text):
        names |= {f"{module}.{name}" for name in re.findall(r"\w+", imported)}
    return names


def _steps(start: str, graph: dict[str, set[str]]) -> dict[str, int]:
    """Return the number of steps from a module to all that it reaches in fewer than the limit."""
    steps, front = {start: 0}, [start]
    for count in range(1, len(STEP_SCORES)):
        front = list({name for module in front for name in graph[module]} - steps.keys())
        steps |= dict.fromkeys(front, count)
    return steps


def definitions_at(code: str, diff: str) -> set[str]:
    """Return the names of the classes and functions around the first changed line of a diff."""
    match = re.search(r"@@ -(\d+)", diff)
    line = int(match[1]) if match else 0
    kinds = (ast.FunctionDef, ast.ClassDef)
    nodes = [node for node in ast.walk(ast.parse(code)) if isinstance(node, kinds)]
    around = {node.name for node in nodes if node.lineno <= line <= (node.end_lineno or 0)}
    return {name for name in around if not name.startswith("__")}


def _words(path: Path) -> set[str]:
    """Return the words of a path's folders and name, without those that all paths have."""
    words = {word.removesuffix("s") for word in re.split(r"[/_]", path.with_suffix("").as_posix())}
    roots = {package.removesuffix("s") for package in PACKAGES}
    return words - {"", "gsgen", "test", "init"} - roots
