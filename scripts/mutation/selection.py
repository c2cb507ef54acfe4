"""Chooses the test files that are nearest to a mutant."""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from mutation.sampling import PACKAGES, Mutant

MOST_FILES = 8
STEP_SCORES = (0.0, 6.0, 4.0, 2.5, 1.5, 0.5)
"""Scores of a test file by the number of imports between it and the module."""
OTHER_TESTS = (
    "tests/bench/",
    "tests/cli/house_rules/test_encodings.py",
    "tests/cli/house_rules/test_robustness.py",
    "tests/docs/",
    "tests/fuzz/",
    "tests/packaging/",
    "tests/scripts/",
    "tests/web/",
)
"""Tests of the scripts, and tests that run whole programs for minutes."""


@dataclass(frozen=True)
class SuiteFiles:
    """The test files of a tree.

    Attributes:
        root: The tree.
        node_ids: Node ids of the tests, if these are known: some name a rule or a fixture.
    """

    root: Path
    node_ids: list[str] = field(default_factory=list)

    @cached_property
    def texts(self) -> dict[str, str]:
        """Texts of the test files, by their paths from the root."""
        files = sorted((self.root / "tests").rglob("test_*.py"))
        names = [file.relative_to(self.root).as_posix() for file in files]
        return {
            name: (self.root / name).read_text("utf-8")
            for name in names
            if not name.startswith(OTHER_TESTS)
        }

    @cached_property
    def _words(self) -> dict[str, set[str]]:
        """The words of each test file."""
        return {name: set(re.findall(r"\w+", text)) for name, text in self.texts.items()}

    @cached_property
    def _module_words(self) -> dict[Path, set[str]]:
        """The words of each module."""
        return {path: set(re.findall(r"\w+", text)) for path, text in self._modules.items()}

    @cached_property
    def _parametrized(self) -> dict[str, set[str]]:
        """The test files with each word of a parameter."""
        files: dict[str, set[str]] = {}
        for node_id in self.node_ids:
            for word in parameter_words(node_id):
                files.setdefault(word, set()).add(node_id.partition("::")[0])
        return files

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
        commands = {name for name in names if ".commands." in name}
        texts = {name: self._modules[path] for name, path in names.items()}
        graph = {name: _named(text) & texts.keys() for name, text in texts.items()}
        for name, file in support.items():
            text = file.read_text("utf-8")
            graph[name] = _named(text) & (texts.keys() | support.keys()) | _run(text, commands)
        return {
            file: _steps(file.removeprefix("tests/").removesuffix(".py").replace("/", "."), graph)
            for file in self.texts
        }

    def nearest(self, mutant: Mutant) -> list[str]:
        """Return the nearest test files, by names, imports, subject, and the tests' parameters."""
        dotted = ".".join(mutant.path.with_suffix("").parts[1:])
        names = definitions_at(self._modules[mutant.path], mutant.diff)
        mentions = [
            {file for file, words in self._words.items() if name in words} for name in names
        ]
        mentions += [self._tests_of_users(name, mutant.path) for name in names]
        mentions += [self._parametrized.get(name, set()) for name in self.parameters(mutant)]
        words, stem_words = _words(mutant.path), _words(Path(mutant.path.stem))
        folder_words = _words(Path(mutant.path.parent.name))
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
                + 2.0 * len(folder_words & _words(Path(stem)))
                + 0.2 * (Path(name).parts[1] in mutant.path.parts[2:])
            )
        nearest = sorted(scores, key=lambda name: -scores[name])[:MOST_FILES]
        return [name for name in nearest if scores[name] > 0]

    def _tests_of_users(self, name: str, home: Path) -> set[str]:
        """Return the test files that import a module that uses a name of the module ``home``."""
        users = {
            ".".join(path.with_suffix("").parts[1:])
            for path, words in self._module_words.items()
            if path != home and name in words
        }
        return {
            file
            for file, steps in self._distances.items()
            if any(steps.get(user) == 1 for user in users)
        }

    def parameters(self, mutant: Mutant) -> set[str]:
        """Return the names around a mutant, and those of rules and fixtures in its module."""
        code = self._modules[mutant.path]
        return definitions_at(code, mutant.diff) | set(_registered(code))


def parameter_words(node_id: str) -> list[str]:
    """Return the words of a test's parameters."""
    return re.findall(r"\w+", node_id.partition("[")[2])


def _registered(code: str) -> Iterator[str]:
    """Yield the names of a module's decorated functions, and the decorators' texts (rule ids)."""
    for function in ast.parse(code).body:
        for decorator in getattr(function, "decorator_list", ()):
            if isinstance(decorator, ast.Call) and isinstance(function, ast.FunctionDef):
                yield function.name
                yield from (str(x.value) for x in decorator.args if isinstance(x, ast.Constant))


def _run(text: str, commands: set[str]) -> set[str]:
    """Return the modules of the commands that a test runs by name."""
    if "support.commands" not in text:
        return set()
    words = set(re.findall(r"[\"' ](\w+)[\"' ]", text))
    return {name for name in commands if name.rpartition(".")[2] in words}


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
    """Return the names of what is defined around the first changed line of a diff."""
    match = re.search(r"@@ -(\d+)", diff)
    line = int(match[1]) if match else 0
    tree = ast.parse(code)
    kinds = (ast.FunctionDef, ast.ClassDef)
    nodes = [node for node in ast.walk(tree) if isinstance(node, kinds)]
    around = {node.name for node in nodes if node.lineno <= line <= (node.end_lineno or 0)}
    constants = [node for node in tree.body if isinstance(node, (ast.Assign, ast.AnnAssign))]
    for node in constants:
        if node.lineno <= line <= (node.end_lineno or 0):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            around |= {target.id for target in targets if isinstance(target, ast.Name)}
    return {name for name in around if not name.startswith("__")}


def _words(path: Path) -> set[str]:
    """Return the words of a path's folders and name, without those that all paths have."""
    words = {word.removesuffix("s") for word in re.split(r"[/_]", path.with_suffix("").as_posix())}
    roots = {package.removesuffix("s") for package in PACKAGES}
    return words - {"", "gsgen", "test", "init"} - roots
