"""Finds the gsgen commands that packages register under the entry point group ``gsgen.commands``.

An entry point names a typer function or a :class:`typer.Typer`. An extra that it needs stands in
square brackets: ``export = "gsgen.sdk.commands.export:app [sdk]"``.
"""

__all__ = ["Command", "escape_markup", "find_commands"]

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, PackageNotFoundError, requires, version
from typing import Annotated, Any

import typer

from gsgen.contract._entry_points import registered_entry_points
from gsgen.contract.errors import ExitCode

_GROUP = "gsgen.commands"
_REQUIREMENT = re.compile(r"^([A-Za-z0-9._-]+).*extra\s*==\s*['\"]([^'\"]+)['\"]")


@dataclass(frozen=True, slots=True)
class Command:
    """A gsgen command that an installed package registers; its dependencies may be missing.

    Attributes:
        name: The word that users type after ``gsgen``.
        point: The entry point of its code.
    """

    name: str
    point: EntryPoint

    @property
    def missing(self) -> tuple[str, ...]:
        """The distributions that a command requires but that are not installed."""
        return _missing(self.point)

    @property
    def requirement(self) -> str:
        """The distribution with the extra that the command needs, such as ``gsgen[sdk]``."""
        owner = self.point.dist.name if self.point.dist else "gsgen"
        return f"{owner}[{','.join(self.point.extras)}]"

    @property
    def remedy(self) -> str:
        """The shell command that installs the command's missing distributions."""
        return f"pip install '{self.requirement}'"

    @property
    def context(self) -> dict[str, Any]:
        """Click context settings; a command with missing dependencies accepts any options."""
        return {"ignore_unknown_options": True} if self.missing else {}

    def load(self) -> Callable[..., Any] | typer.Typer:
        """Import the command, or return a replacement that reports its missing dependencies."""
        if self.missing:
            absent, verb = ", ".join(self.missing), "is" if len(self.missing) == 1 else "are"
            return _refusing(
                f"Not installed: {self.remedy}",
                f"`gsgen {self.name}` needs {absent}, which {verb} not installed: {self.remedy}",
                ExitCode.USAGE,
            )
        try:
            loaded: Callable[..., Any] | typer.Typer = self.point.load()
        except Exception as error:  # a third party's code may fail in any way
            reason = f"{type(error).__name__}: {error}"
            message = f"`gsgen {self.name}` ({self.point.value}) cannot be loaded: {reason}"
            return _refusing(f"Broken: {reason}", message, ExitCode.INTERNAL)
        return loaded


def _refusing(summary: str, reason: str, code: ExitCode) -> Callable[..., Any]:
    """Return a command that accepts any arguments, and fails with the message ``reason``."""

    def refuse(words: Annotated[list[str] | None, typer.Argument(hidden=True)] = None) -> None:
        typer.echo(f"gsgen: {reason}", err=True)
        raise typer.Exit(code)

    refuse.__doc__ = escape_markup(summary)
    return refuse


def escape_markup(text: str) -> str:
    """Escape square brackets in help texts, which rich would read as markup."""
    return text.replace("[", r"\[")


def find_commands(group: str = _GROUP) -> dict[str, Command]:
    """Return the gsgen commands that an entry point group registers, by name."""
    return {point.name: Command(point.name, point) for point in registered_entry_points(group)}


def _missing(point: EntryPoint) -> tuple[str, ...]:
    """Return the distributions that an entry point's extras require but that are not installed."""
    absent = []
    for line in _requirements(point.dist.name) if point.dist and point.extras else ():
        match = _REQUIREMENT.match(line)
        if match and match[2] in point.extras and not _installed(match[1]):
            absent.append(match[1])
    return tuple(absent)


@cache
def _requirements(distribution: str) -> tuple[str, ...]:
    return tuple(requires(distribution) or ())


@cache
def _installed(name: str) -> bool:
    try:
        version(name)
    except PackageNotFoundError:
        return False
    return True
