"""Reads, validates and applies the table of exceptions from style checks."""

__all__ = ["ExceptionsInvalid", "StyleException", "excepted", "read_exceptions"]

import tomllib
from collections.abc import Collection
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from house.violation import Violation

_KEYS = {"check", "path", "subjects", "reason"}
_SHORTEST_REASON = 15  # characters: shorter ones restate the rule


class ExceptionsInvalid(Exception):
    """The table of exceptions has an entry that cannot be applied."""


@dataclass(frozen=True, slots=True)
class StyleException:
    """An exception from one style check: files, subjects and the reason."""

    check: str
    path: str
    subjects: tuple[str, ...]
    reason: str

    def allows(self, check: str, violation: Violation) -> bool:
        """Return whether the exception permits a violation."""
        return (
            check == self.check
            and fnmatchcase(violation.path, self.path)
            and any(fnmatchcase(violation.subject, subject) for subject in self.subjects)
        )

    def __str__(self) -> str:
        return f"{self.check}: {self.path} {', '.join(self.subjects)}: {self.reason}"


def read_exceptions(path: Path, checks: Collection[str]) -> list[StyleException]:
    """Read the table of exceptions.

    Args:
        path: TOML file with ``[[exception]]`` entries.
        checks: Names that an entry may give.

    Raises:
        ExceptionsInvalid: An entry lacks a key or a reason, or names no known check.
    """
    try:
        entries = tomllib.loads(path.read_text("utf-8")).get("exception", [])
    except tomllib.TOMLDecodeError as error:
        raise ExceptionsInvalid(f"{path}: {error}") from error
    return [_parsed(path, number, entry, checks) for number, entry in enumerate(entries, 1)]


def excepted(
    check: str, violations: list[Violation], exceptions: list[StyleException]
) -> tuple[list[Violation], set[StyleException]]:
    """Return the violations that no exception permits, and the exceptions that were used."""
    remaining: list[Violation] = []
    used: set[StyleException] = set()
    for violation in violations:
        permissions = {entry for entry in exceptions if entry.allows(check, violation)}
        used |= permissions
        if not permissions:
            remaining.append(violation)
    return remaining, used


def _parsed(
    path: Path, number: int, entry: dict[str, Any], checks: Collection[str]
) -> StyleException:
    location = f"{path.name}: entry {number}"
    if unknown := set(entry) - _KEYS:
        raise ExceptionsInvalid(f"{location}: unknown keys {sorted(unknown)}")
    if missing := {"check", "path", "reason"} - set(entry):
        raise ExceptionsInvalid(f"{location}: missing keys {sorted(missing)}")
    if entry["check"] not in checks:
        names = ", ".join(sorted(checks))
        raise ExceptionsInvalid(f"{location}: check {entry['check']!r}; expected one of {names}")
    if len(entry["reason"].strip()) < _SHORTEST_REASON:
        raise ExceptionsInvalid(f"{location}: reason {entry['reason']!r} explains nothing")
    subjects = entry.get("subjects", ["*"])
    if not isinstance(subjects, list):
        raise ExceptionsInvalid(f"{location}: subjects {subjects!r}; expected a list of names")
    return StyleException(entry["check"], entry["path"], tuple(subjects), entry["reason"])
