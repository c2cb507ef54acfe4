"""The files of a checkout: Python, shaders and pages, each read and parsed once."""

__all__ = ["PRODUCT", "FileUnreadable", "Page", "PythonFile", "Repository", "Shader", "module_name"]

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath

PRODUCT = ("contract", "sdk", "runtime", "reference_plugins")
"""Import roots: the folders whose code is shipped."""
_CODE = (*PRODUCT, "tests", "scripts", "docs")
_HISTORY = "CHANGELOG.md"  # entries of releases quote the words of their time

Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


class FileUnreadable(Exception):
    """A file cannot be decoded or parsed, so it cannot be checked."""


class PythonFile:
    """A Python file: path from the root, text and syntax tree."""

    def __init__(self, path: str, text: str) -> None:
        self.path = path
        self.text = text

    @cached_property
    def tree(self) -> ast.Module:
        """The syntax tree.

        Raises:
            FileUnreadable: The text is not valid Python.
        """
        try:
            return ast.parse(self.text, self.path)
        except SyntaxError as error:
            raise FileUnreadable(f"{self.path}:{error.lineno}: {error.msg}") from error

    @cached_property
    def nodes(self) -> list[ast.AST]:
        """All nodes of the file's syntax tree, parents before children."""
        return list(ast.walk(self.tree))

    @cached_property
    def definitions(self) -> list[tuple[str, Definition]]:
        """Every function and class of the file with its qualified name, ``Class.method``."""
        definitions: list[tuple[str, Definition]] = []
        pending: list[tuple[str, ast.AST]] = [("", self.tree)]
        while pending:
            prefix, node = pending.pop()
            for child in ast.iter_child_nodes(node):
                if isinstance(child, Definition):
                    definitions.append((f"{prefix}{child.name}", child))
                    pending.append((f"{prefix}{child.name}.", child))
                elif not isinstance(child, ast.expr):
                    pending.append((prefix, child))
        return definitions

    @cached_property
    def lines(self) -> list[str]:
        """The lines of the file without line ends."""
        return self.text.split("\n")

    @property
    def root(self) -> str:
        """The first folder of the file's path."""
        return PurePosixPath(self.path).parts[0]

    @property
    def is_product(self) -> bool:
        """Whether the file is shipped."""
        return self.root in PRODUCT


@dataclass(frozen=True, slots=True)
class Shader:
    """A WGSL shader file."""

    path: str
    text: str

    @property
    def name(self) -> str:
        """The file's name without its suffix, as an include directive spells it."""
        return PurePosixPath(self.path).stem


@dataclass(frozen=True, slots=True)
class Page:
    """A Markdown page."""

    path: str
    text: str


class Repository:
    """All files of the repository that are checked.

    Args:
        root: Folder of the checkout.
        selection: Paths from the root; violations outside them are not reported. Empty: all.
    """

    def __init__(self, root: Path, selection: tuple[str, ...] = ()) -> None:
        self.root = root
        self.selection = selection

    def selects(self, path: str) -> bool:
        """Return whether violations in a file are reported."""
        return not self.selection or any(
            path == selected or path.startswith(selected.rstrip("/") + "/")
            for selected in self.selection
        )

    @cached_property
    def python(self) -> list[PythonFile]:
        """Every Python file of the product, the tests, the scripts and the documentation."""
        paths = [path for folder in _CODE for path in self._files(folder, ".py")]
        return [PythonFile(self._name(path), _read(path)) for path in paths]

    @property
    def product(self) -> list[PythonFile]:
        """The Python files that are shipped."""
        return [file for file in self.python if file.is_product]

    @property
    def selected(self) -> list[PythonFile]:
        """The Python files whose violations are reported."""
        return [file for file in self.python if self.selects(file.path)]

    @cached_property
    def shaders(self) -> list[Shader]:
        """Every WGSL file of the product."""
        paths = [path for folder in PRODUCT for path in self._files(folder, ".wgsl")]
        return [Shader(self._name(path), _read(path)) for path in paths]

    @cached_property
    def pages(self) -> list[Page]:
        """Every Markdown page of the documentation and of the root, without the changelog."""
        paths = [*self._files("docs", ".md"), *sorted(self.root.glob("*.md"))]
        return [Page(self._name(path), _read(path)) for path in paths if path.name != _HISTORY]

    def _files(self, folder: str, suffix: str) -> Iterator[Path]:
        for path in sorted((self.root / folder).rglob(f"*{suffix}")):
            inner = path.relative_to(self.root).parts
            if not any(part.startswith(".") or part == "__pycache__" for part in inner):
                yield path

    def _name(self, path: Path) -> str:
        return path.relative_to(self.root).as_posix()


def module_name(path: str) -> str:
    """Return the dotted name that a product file is imported by."""
    parts = PurePosixPath(path).with_suffix("").parts[1:]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _read(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except UnicodeDecodeError as error:
        raise FileUnreadable(f"{path}: {error}") from error
