"""Checks that code in the documentation imports public names only."""

__all__ = ["PUBLIC_MODULES", "documentation"]

import ast
import re
import textwrap
from collections.abc import Iterator

from house.repository import PythonFile, Repository, module_name
from house.violation import Measurement, Violation

PUBLIC_MODULES = frozenset(
    {
        "gsgen.conformance",
        "gsgen.conformance.fixtures",
        "gsgen.contract",
        "gsgen.contract.errors",
        "gsgen.contract.layout",
        "gsgen.contract.manifest",
        "gsgen.contract.rule",
        "gsgen.formats",
        "gsgen.reference_plugins.samples",
        "gsgen.reference_plugins.synthetic",
        "gsgen.runtime",
        "gsgen.sdk",
        "gsgen.sdk.binding",
        "gsgen.sdk.inputs",
        "gsgen.sdk.math",
        "gsgen.tiles",
    }
)
"""The modules whose names stay: what users import."""

_FENCE = re.compile(
    r"^(?P<indent>[ \t]*)```(?P<language>\w*)[^\n]*\n(?P<code>.*?)^(?P=indent)```[ \t]*$",
    re.MULTILINE | re.DOTALL,
)
_IMPORT = re.compile(r"^\s*(?:>>> |\.\.\. )?((?:from gsgen|import gsgen)[.\w]*\s.*)$")


def documentation(repository: Repository) -> Measurement:
    """Find imports of the documentation, its examples and its README that are not public."""
    modules = {module_name(file.path): file for file in repository.product}
    violations: list[Violation] = []
    total = 0
    for path, offset, tree in _trees(repository):
        for node in _import_statements(tree):
            for module, name in _imported(node, modules):
                total += 1
                actual = _problem(module, name, modules)
                if actual:
                    violations.append(_violation(path, offset + node.lineno, module, actual))
    return Measurement(violations, total)


def _trees(repository: Repository) -> Iterator[tuple[str, int, ast.Module]]:
    """Yield the code of pages and examples: path, number of lines before it, syntax tree."""
    for file in repository.selected:
        if file.root == "docs":
            yield file.path, 0, file.tree
    for page in repository.pages:
        if not repository.selects(page.path):
            continue
        for block in _FENCE.finditer(page.text):
            offset = page.text.count("\n", 0, block.start("code"))
            code = textwrap.dedent(block["code"])
            if block["language"] in ("python", "py"):
                yield from _parsed(page.path, offset, code)


def _parsed(path: str, offset: int, code: str) -> Iterator[tuple[str, int, ast.Module]]:
    """Yield the syntax tree of a code block; from an excerpt, each import by itself."""
    try:
        yield path, offset, ast.parse(code)
    except SyntaxError:
        for number, line in enumerate(code.split("\n")):
            if match := _IMPORT.match(line):
                yield path, offset + number, ast.parse(match[1])


def _import_statements(tree: ast.Module) -> list[ast.Import | ast.ImportFrom]:
    return [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]


def _imported(node: ast.stmt, modules: dict[str, PythonFile]) -> Iterator[tuple[str, str]]:
    """Yield the project's modules that a statement imports, each with the imported name."""
    match node:
        case ast.Import(names=aliases):
            for alias in aliases:
                if alias.name.split(".")[0] == "gsgen":
                    yield alias.name, ""
        case ast.ImportFrom(module=str(module), names=aliases) if module.split(".")[0] == "gsgen":
            for alias in aliases:
                submodule = f"{module}.{alias.name}"
                names = _exported(modules[module]) if module in modules else None
                is_module = submodule in modules and alias.name not in (names or ())
                yield (submodule, "") if is_module else (module, alias.name)


def _problem(module: str, name: str, modules: dict[str, PythonFile]) -> str:
    if module not in PUBLIC_MODULES:
        return f"imports {f'{name} from ' if name else ''}{module}, which is not public"
    if module not in modules:
        return f"imports {module}, which does not exist"
    exported = _exported(modules[module])
    if name and exported is not None and name not in exported:
        return f"imports {name!r}, which is not in __all__ of {module}"
    return ""


def _exported(file: PythonFile) -> set[str] | None:
    """Return the names of ``__all__``, or None where it is computed or absent."""
    for statement in file.tree.body:
        match statement:
            case ast.Assign(targets=[ast.Name(id="__all__")], value=ast.List(elts=parts)):
                names = [part.value for part in parts if isinstance(part, ast.Constant)]
                if len(names) == len(parts):
                    return {str(name) for name in names}
    return None


def _violation(path: str, line: int, module: str, actual: str) -> Violation:
    public = [name for name in PUBLIC_MODULES if name.split(".")[1] == (module + ".").split(".")[1]]
    return Violation(
        path=path,
        line=line,
        subject=module,
        actual=actual,
        expected=" or ".join(sorted(public)) or "a public module",
        hint="export the name from the public module, or show another way",
    )
