"""Find commands: each room registers its own under the entry point group ``gsgen.commands``.

An entry point names a typer function or a :class:`typer.Typer`. If it needs an extra, it says so
in square brackets, as entry points do: ``export = "gsgen.sdk.commands.export:app [sdk]"``.
"""

__all__ = ["Command", "escaped", "find_commands"]

import re
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, PackageNotFoundError, version
from typing import Annotated, Any

import typer

from gsgen.contract._entry_points import registered

_GROUP = "gsgen.commands"
_USAGE = 2
_INTERNAL = 3
_REQUIREMENT = re.compile(r"^([A-Za-z0-9._-]+).*extra\s*==\s*['\"]([^'\"]+)['\"]")


@dataclass(frozen=True, slots=True)
class Command:
    """A command that may or may not be usable here.

    Attributes:
        name: What people type.
        point: Where its code is.
        missing: Distributions it needs that are not installed.
    """

    name: str
    point: EntryPoint
    missing: tuple[str, ...]

    @property
    def requirement(self) -> str:
        """The distribution with the extra that this command needs."""
        owner = self.point.dist.name if self.point.dist else "gsgen"
        return f"{owner}[{','.join(self.point.extras)}]"

    @property
    def remedy(self) -> str:
        """What to type to be able to use it."""
        return f"pip install '{self.requirement}'"

    @property
    def context(self) -> dict[str, Any]:
        """Settings of the command's context: one that cannot run takes any options."""
        return {"ignore_unknown_options": True} if self.missing else {}

    def load(self) -> Callable[..., Any] | typer.Typer:
        """Import the command, or return one that says what it lacks."""
        if self.missing:
            absent = ", ".join(self.missing)
            return _refusing(
                f"Not installed: {self.remedy}",
                f"`gsgen {self.name}` needs {absent}, which is not installed: {self.remedy}",
                _USAGE,
            )
        try:
            loaded: Callable[..., Any] | typer.Typer = self.point.load()
        except Exception as error:  # a third party's code may fail in any way
            reason = f"{type(error).__name__}: {error}"
            what = f"`gsgen {self.name}` ({self.point.value}) cannot be loaded: {reason}"
            return _refusing(f"Broken: {reason}", what, _INTERNAL)
        return loaded


def _refusing(summary: str, reason: str, code: int) -> Callable[..., Any]:
    """Return a command that takes any arguments and only says why it cannot run."""

    def refuse(
        words: Annotated[list[str] | None, typer.Argument(hidden=True)] = None,
    ) -> None:
        typer.echo(f"gsgen: {reason}", err=True)
        raise typer.Exit(code)

    refuse.__doc__ = escaped(summary)
    return refuse


def escaped(text: str) -> str:
    """Return ``text`` so that help pages show its square brackets, which rich takes as markup."""
    return text.replace("[", r"\[")


def find_commands(group: str = _GROUP) -> dict[str, Command]:
    """Return every command registered under an entry point group, by name."""
    return {
        point.name: Command(point.name, point, _missing(point))
        for point in registered(group)
    }


def _missing(point: EntryPoint) -> tuple[str, ...]:
    """Return the distributions that the entry point's extras ask for and that are absent."""
    required = (point.dist.requires or []) if point.dist and point.extras else []
    absent = []
    for line in required:
        match = _REQUIREMENT.match(line)
        if match and match[2] in point.extras and not _installed(match[1]):
            absent.append(match[1])
    return tuple(absent)


def _installed(name: str) -> bool:
    try:
        version(name)
    except PackageNotFoundError:
        return False
    return True
