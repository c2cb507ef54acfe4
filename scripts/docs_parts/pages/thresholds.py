"""The numbers that a rule compares with: constants beside its check, with their comments."""

import ast
import re
import sys
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, Final

from docs_parts.tables import table
from gsgen.contract.validation.rule import Rule

# Rules and what they alone share: numbers of other rooms are in tables of the specification.
_ROOMS: Final = ("gsgen.contract.rules.", "gsgen.contract.causes.")
_CONSTANT = re.compile(r"_?[A-Z][A-Z0-9_]+")
# Names of what values are compared with; others are sizes of tensors and of blocks of memory.
_COMPARED = re.compile(
    r"_?(MIN|MAX)_(?!EXAMPLES|NAMED)|(SHARE|RATIO|RANGE|SLACK|ROUNDING|FRACTION|DEVIATION|ROUGHNESS"
    r"|SLOPE|DISTANCE|SIGMAS|QUANTILE|PERCENTILE|COEFFICIENT|MARGIN|TOLERANCE)S?$"
)


@dataclass(frozen=True, slots=True)
class _Module:
    """The constants, functions and imports of a module."""

    comments: dict[str, str]  # of each constant, in the order of the source
    names: dict[str, frozenset[str]]  # that each function, class or constant uses
    imports: dict[str, str]  # the module of each imported name


@cache
def _module(name: str) -> _Module:
    """Read a module; imports within functions count as those at its top."""
    path = Path(str(import_module(name).__file__))
    text = path.read_text("utf-8")
    lines = text.splitlines()
    comments: dict[str, str] = {}
    names: dict[str, frozenset[str]] = {}
    imports: dict[str, str] = {}
    last_line, last_comment = 0, ""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            imports |= {alias.asname or alias.name: node.module for alias in node.names}
    for node in tree.body:
        used = frozenset(part.id for part in ast.walk(node) if isinstance(part, ast.Name))
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            names[node.name] = used
        elif isinstance(node, (ast.Assign, ast.AnnAssign)):
            start = node.lineno - 1
            above = []
            while start > 0 and lines[start - 1].startswith("#"):
                start -= 1
                above.insert(0, lines[start].lstrip("# "))
            # A comment stands above all constants up to the next empty line.
            comment = " ".join(above) or (last_comment if start == last_line else "")
            last_line, last_comment = node.end_lineno or node.lineno, comment
            _, _, beside = lines[last_line - 1].partition("  # ")
            targets = [part for part in ast.walk(node) if isinstance(part, ast.Name)]
            for target in targets:
                if isinstance(target.ctx, ast.Store) and _CONSTANT.fullmatch(target.id):
                    comments[target.id] = " ".join(filter(None, (comment, beside)))
                    names[target.id] = used
    return _Module(comments, names, imports)


def _numbers(value: object) -> str:
    """Return a number or a few of them as text; empty for anything else."""
    if isinstance(value, tuple):
        parts = [_numbers(part) for part in value]
        return " to ".join(parts) if len(parts) == 2 and all(parts) else ""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return ""
    return f"{value:,}" if isinstance(value, int) else f"{value:.5g}"


def thresholds(rule: Rule) -> list[tuple[str, str, str]]:
    """Return name, value and comment of each number that the check of a rule uses."""
    check: Any = rule.check
    pending, seen = [(check.__module__, check.__name__)], set[tuple[str, str]]()
    while pending:
        where = pending.pop()
        module_name, name = where
        if where in seen or not module_name.startswith(_ROOMS):
            continue
        seen.add(where)
        module = _module(module_name)
        if name in module.imports:
            pending.append((module.imports[name], name))
        pending += [(module_name, used) for used in module.names.get(name, ())]
    results = []
    for module_name in sorted({module_name for module_name, _ in seen}):
        module = _module(module_name)
        for name, comment in module.comments.items():
            value = _numbers(getattr(sys.modules[module_name], name))
            if value and (module_name, name) in seen and _COMPARED.search(name):
                words = name.strip("_").lower().replace("_", " ")
                results.append((re.sub(r"^(min|max)\b", r"\1.", words), value, comment or "–"))
    return results


def section(rule: Rule) -> str:
    """Return the part of a rule's page with its thresholds; empty without any."""
    groups: dict[str, list[str]] = {}  # numbers that one comment explains, by the comment
    for name, value, comment in thresholds(rule):
        groups.setdefault(comment, []).append(f"{name} {value}")
    rows = [("; ".join(numbers), comment) for comment, numbers in groups.items()]
    return f"\n## Thresholds\n\n{table(('numbers', 'why'), rows)}\n" if rows else ""
