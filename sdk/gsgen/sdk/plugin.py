"""Plugins: what turns a method's files into a generator, found by entry point.

A package registers an object of :class:`Plugin` under the group ``gsgen.generators``. If it needs
an extra, the entry point says so in square brackets.
"""

__all__ = ["Plugin", "find_plugins"]

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from gsgen.cli.commands import Command, find_commands

_GROUP = "gsgen.generators"


@dataclass(frozen=True, slots=True)
class Plugin:
    """One method.

    Attributes:
        name: What ``gsgen export`` takes.
        summary: One sentence for people.
        reads: What files it reads, for ``gsgen export --help``.
        inputs: The roles of the inputs of what it exports.
        command: The typer function behind ``gsgen export NAME``.
    """

    name: str
    summary: str
    reads: str
    inputs: tuple[str, ...]
    command: Callable[..., Any]


def find_plugins() -> dict[str, Command]:
    """Return every installed plugin by name, as commands that may lack something."""
    return find_commands(_GROUP)
