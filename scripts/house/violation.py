"""Violations with locations, and the number of searched things."""

__all__ = ["Measurement", "Violation"]

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Violation:
    """One violation of a style rule, with its location.

    Attributes:
        path: File or folder, from the root of the checkout.
        line: Line in the file, from 1; 0 for a folder.
        subject: What an exception names: a binding, function, class, module or phrase.
        actual: What stands there.
        expected: What the rule asks for.
        hint: The next thing to do.
    """

    path: str
    line: int
    subject: str
    actual: str
    expected: str
    hint: str

    def __str__(self) -> str:
        location = f"{self.path}:{self.line}" if self.line else self.path
        return f"{location}: {self.actual}; expected {self.expected}; hint: {self.hint}"


@dataclass(frozen=True, slots=True)
class Measurement:
    """The violations of one style rule, and the number of searched things."""

    violations: list[Violation]
    total: int = 0
