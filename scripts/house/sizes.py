"""Finds functions and files that are too long."""

__all__ = ["long_files", "long_functions"]

import ast

from house.repository import Repository
from house.violation import Measurement, Violation

_MOST_FUNCTION_LINES = 80
_MOST_FILE_LINES = 500


def long_functions(repository: Repository) -> Measurement:
    """Find functions of more than 80 lines, from ``def`` to the end, docstring included."""
    violations: list[Violation] = []
    total = 0
    for file in repository.selected:
        for name, node in file.definitions:
            if isinstance(node, ast.ClassDef):
                continue
            total += 1
            length = (node.end_lineno or node.lineno) - node.lineno + 1
            if length > _MOST_FUNCTION_LINES:
                violations.append(
                    Violation(
                        path=file.path,
                        line=node.lineno,
                        subject=name,
                        actual=f"{name} has {length} lines",
                        expected=f"at most {_MOST_FUNCTION_LINES}",
                        hint="give each of its steps a function, and shared options a group",
                    )
                )
    return Measurement(violations, total)


def long_files(repository: Repository) -> Measurement:
    """Find Python files of more than 500 lines."""
    violations = [
        Violation(
            path=file.path,
            line=_MOST_FILE_LINES + 1,
            subject=file.path,
            actual=f"{len(file.text.splitlines())} lines",
            expected=f"at most {_MOST_FILE_LINES}",
            hint="split it by subject",
        )
        for file in repository.selected
        if len(file.text.splitlines()) > _MOST_FILE_LINES
    ]
    return Measurement(violations, len(repository.selected))
