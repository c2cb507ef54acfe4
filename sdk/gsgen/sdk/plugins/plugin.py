"""Plugins: what turns a method's files into a generator, found by entry point.

A package registers an object of :class:`Plugin` under the group ``gsgen.generators``. If it needs
an extra, the entry point says so in square brackets.
"""

__all__ = ["Plugin", "find_plugins"]

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from gsgen.contract._extensions import Command, find_commands
from gsgen.sdk.plugins.export_options import Build

_GROUP = "gsgen.generators"


@dataclass(frozen=True, slots=True)
class Plugin:
    """One method: give ``build``, or ``command`` where a plugin does the exporting by itself.

    Attributes:
        name: What ``gsgen export`` takes.
        summary: One sentence for people.
        reads: What files it reads, for ``gsgen export --help``.
        inputs: The roles of the inputs of what it exports.
        command: The typer function behind ``gsgen export NAME``.
        build: Returns the generator. Its parameters, declared as typer does, become arguments
            and options of ``gsgen export NAME``; ``-o``, ``--dtype``, ``--capacity`` and the
            other options of every export come by themselves. Import torch inside.

    Raises:
        TypeError: Both or neither of ``command`` and ``build`` are given.
    """

    name: str
    summary: str
    reads: str
    inputs: tuple[str, ...]
    command: Callable[..., Any] | None = None
    build: Build | None = None

    def __post_init__(self) -> None:
        if (self.command is None) == (self.build is None):
            raise TypeError(f"plugin {self.name!r}: give exactly one of command and build")

    @property
    def function(self) -> Callable[..., Any]:
        """The typer function, with every option."""
        if self.command is not None:
            return self.command
        assert self.build is not None
        from gsgen.sdk.plugins.export_job import run_export
        from gsgen.sdk.plugins.export_options import with_common_options

        return with_common_options(
            self.build, lambda build, request: run_export(build, request, self.name)
        )


def find_plugins() -> dict[str, Command]:
    """Return every installed plugin by name, as commands that may lack something."""
    return find_commands(_GROUP)
