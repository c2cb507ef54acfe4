"""Code of third parties: what installed Python packages register under entry point groups.

It cannot end this process unnoticed: ``except Exception`` misses SystemExit, so a plugin that calls
``sys.exit()`` would end a validation with exit code 0, which reads as a pass. An extra that the code needs stands in square brackets: ``static = "acme.plugin:PLUGIN [sdk]"``.
"""

__all__ = [
    "Extension",
    "ExtensionUnusable",
    "PluginExit",
    "find_extensions",
    "plugin_exits_as_errors",
    "registered_entry_points",
    "short_repr",
]

import os
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.metadata import (
    Distribution,
    EntryPoint,
    PackageNotFoundError,
    distribution,
    entry_points,
    requires,
)
from typing import Any, Never

from gsgen.contract.errors import ExitCode, GsgenError

_EXTRA_REQUIREMENT_PATTERN = re.compile(r"^([A-Za-z0-9._-]+).*extra\s*==\s*['\"]([^'\"]+)['\"]")
_MAX_REPR_LENGTH = 300


class ExtensionUnusable(GsgenError):
    """Raised if a command or plugin cannot be loaded, or needs packages that are not installed.

    Attributes:
        summary: The reason in a few words, for a list of commands.
    """

    def __init__(self, message: str, summary: str, exit_code: ExitCode) -> None:
        super().__init__(message)
        self.summary = summary
        self.exit_code = exit_code  # type: ignore[misc]  # of this error, not of its class


@dataclass(frozen=True, slots=True)
class Extension:
    """A command or plugin that can be loaded by its name; packages that it needs may be missing.

    Attributes:
        name: The word that users type for it.
        point: The entry point of its code.
    """

    name: str
    point: EntryPoint

    @property
    def owner(self) -> str:
        """The name of the distribution that registers the extension."""
        return _name_of(self.point.dist) if self.point.dist else "gsgen"

    @property
    def missing(self) -> tuple[str, ...]:
        """The distributions that the extension requires but that are not installed."""
        missing_packages = []
        for line in _requirements(self.owner) if self.point.extras else ():
            match = _EXTRA_REQUIREMENT_PATTERN.match(line)
            if match and match[2] in self.point.extras and not _is_installed(match[1]):
                missing_packages.append(match[1])
        return tuple(missing_packages)

    @property
    def install_hint(self) -> str:
        """The shell command that installs the missing distributions."""
        return f"pip install '{self.owner}[{','.join(self.point.extras)}]'"

    def load(self) -> Any:
        """Import the extension, and return the object that it names.

        Raises:
            ExtensionUnusable: A distribution is missing, or the import fails.
        """
        if missing_packages := self.missing:
            verb = "is" if len(missing_packages) == 1 else "are"
            names, install_hint = ", ".join(missing_packages), self.install_hint
            raise ExtensionUnusable(
                f"`{self.name}` needs {names}, which {verb} not installed: {install_hint}",
                f"Not installed: {install_hint}",
                ExitCode.USAGE,
            )
        try:
            with plugin_exits_as_errors():
                return self.point.load()
        except Exception as error:  # a third party's code may fail in any way
            reason = short_repr(error)
            raise ExtensionUnusable(
                f"`{self.name}` ({self.point.value}) cannot be loaded: {reason}",
                f"Broken: {reason}",
                ExitCode.INTERNAL,
            ) from error


@cache
def _installed_entry_points() -> tuple[EntryPoint, ...]:
    groups = entry_points()  # reads a file of every installed distribution
    return tuple(point for group in groups.groups for point in groups.select(group=group))


def registered_entry_points(group: str) -> list[EntryPoint]:
    """Return the installed entry points of ``group``, sorted by name."""
    points = [point for point in _installed_entry_points() if point.group == group]
    return sorted(points, key=lambda point: point.name)


def find_extensions(group: str) -> dict[str, Extension]:
    """Return the extensions that packages register under an entry point group, by name."""
    return {point.name: Extension(point.name, point) for point in registered_entry_points(group)}


@cache
def _name_of(distribution: Distribution) -> str:
    return distribution.name  # which reads all of its metadata


@cache
def _requirements(owner: str) -> tuple[str, ...]:
    return tuple(requires(owner) or ())


@cache
def _is_installed(name: str) -> bool:
    try:
        distribution(name)
    except PackageNotFoundError:
        return False
    return True


class PluginExit(Exception):
    """Raised if a third party's code tried to end this process; its cause is the original exception."""


@contextmanager
def plugin_exits_as_errors() -> Iterator[None]:
    """Turn SystemExit and its like, and ``os._exit``, into PluginExit within the block.

    Ctrl-C still raises KeyboardInterrupt. ``os._exit`` ends other threads' processes as before, and
    those that the block forks.
    """
    exit_process, caller = os._exit, (os.getpid(), threading.get_ident())

    def refuse_exit(status: int) -> Never:
        if (os.getpid(), threading.get_ident()) != caller:
            exit_process(status)
        raise PluginExit(f"os._exit({status!r})")

    os._exit = refuse_exit
    try:
        yield
    except (Exception, KeyboardInterrupt):
        raise
    except BaseException as error:
        described_error = PluginExit(short_repr(error)).with_traceback(error.__traceback__)
        raise described_error from error
    finally:
        os._exit = exit_process


def short_repr(value: object) -> str:
    """Return the ``repr`` of a third party's object in one short line, even if its class fails."""
    try:
        with plugin_exits_as_errors():
            text = str(value) if isinstance(value, PluginExit) else repr(value)
            text = " ".join(text.split())
    except Exception:  # the class is a third party's
        text = f"{object.__repr__(value)}, which cannot be described"
    return text if len(text) <= _MAX_REPR_LENGTH else f"{text[:_MAX_REPR_LENGTH]} …"
