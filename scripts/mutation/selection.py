"""Chooses the test files that are nearest to a mutant."""

import ast
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from mutation.sampling import PACKAGES, Mutant

MOST_FILES = 8
SLOW_FOLDERS = tuple(
    f"tests/{name}/"
    for name in ("bench", "cli/house_rules", "docs", "fuzz", "packaging", "support", "web")
)
"""Folders of tests that run whole programs for minutes."""


@dataclass(frozen=True)
class Tests:
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
            if not name.startswith(SLOW_FOLDERS)
        }

    @cached_property
    def _modules(self) -> dict[Path, str]:
        """Texts of the modules, by their paths from the root."""
        files = [x for package in PACKAGES for x in (self.root / package / "gsgen").rglob("*.py")]
        return {file.relative_to(self.root): file.read_text("utf-8") for file in files}

    def nearest(self, mutant: Mutant) -> list[str]:
        """Return the nearest test files, by names of functions, modules, importers and subject."""
        dotted = ".".join(mutant.path.with_suffix("").parts[1:])
        names = definitions_at(self._modules[mutant.path], mutant.diff)
        importers = {
            path.stem
            for path, text in self._modules.items()
            if re.search(rf"\b{re.escape(dotted)}\b", text) and path.stem != "__init__"
        }
        words, stem_words = _words(mutant.path), _words(Path(mutant.path.stem))
        scores = {}
        for name, text in self.texts.items():
            stem = Path(name).stem.removeprefix("test_")
            scores[name] = (
                8 * (stem == mutant.path.stem.lstrip("_"))
                + 4 * (dotted in text)
                + 3 * any(re.search(rf"\b{re.escape(x)}\b", text) for x in names)
                + 2 * (stem in importers)
                + 0.5 * len(words & _words(Path(name)))
                + 1.0 * len(stem_words & _words(Path(stem)))
            )
        nearest = sorted(scores, key=lambda name: -scores[name])[:MOST_FILES]
        return [name for name in nearest if scores[name] > 0]


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
