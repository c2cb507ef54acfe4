"""Exceptions raised for invalid user input, and the exit codes that commands end with.

All of them derive from :class:`GsgenError`, so a caller needs one ``except`` clause::

    GsgenError                        exit code 2
    ├── ConfigInvalid                 an option or a settings file
    │   └── UnknownName               a rule, target, role or plugin
    ├── InputUnreadable               a file or folder: exit code 4
    │   ├── ModelUnreadable           an ONNX model
    │   └── CheckpointInvalid         a trained model, in gsgen.reference_plugins
    ├── ManifestInvalid               a manifest
    ├── LayoutMismatch                arrays that should be packed rows
    ├── HostProcessFailed                    this machine: no memory, a full disk, a killed process
    ├── LevelUnavailable              a validation level, in gsgen.contract.rule
    ├── RecordingRefused              test vectors or reference images
    ├── FormatError                   a splat file, in gsgen.formats, with a subclass per cause
    ├── GeneratorInvalid, ExportFailed, ParityFailed, ExportRejected, RewriteFailed
    │                                 an export or a rewrite, in gsgen.sdk
    ├── ProviderUnavailable, SessionClosed, FrameExpired, InputInvalid, SizeUnknown, RunFailed
    │                                 a bound session, in gsgen.sdk.binding
    └── DeviceUnavailable, DisplayUnavailable, CapacityExceeded, SceneInvalid, SceneUnreadable
                                      drawing, in gsgen.runtime

Every other exception that leaves a public function is a fault of gsgen.
"""

__all__ = [
    "ConfigInvalid",
    "ExitCode",
    "FileNote",
    "GsgenError",
    "HostProcessFailed",
    "InputUnreadable",
    "LayoutMismatch",
    "ManifestInvalid",
    "ModelUnreadable",
    "UnknownName",
    "names_meant",
]

from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import ClassVar, Self

_MAX_LISTED_NAMES = 12


class ExitCode(IntEnum):
    """The exit codes of every gsgen command.

    Attributes:
        SUCCESS: The command did its work, and the model conforms where it was checked.
        FAILURE: The command ran to its end with a negative result: a model breaks a rule, two
            models differ, an export was rejected.
        USAGE: An option, a settings file or the environment is wrong, or an output cannot be
            written; nothing was decided.
        INTERNAL: A rule or gsgen itself crashed: a fault of gsgen, not of the input.
        UNREADABLE: An input file cannot be read.
        TERMINAL_HANGUP: The terminal was closed (128 + SIGHUP, as shells report it).
        INTERRUPTED: The user pressed Ctrl-C (128 + SIGINT).
        TERMINATED: The system asked the process to end (128 + SIGTERM).
    """

    SUCCESS = 0
    FAILURE = 1
    USAGE = 2
    INTERNAL = 3
    UNREADABLE = 4
    TERMINAL_HANGUP = 129
    INTERRUPTED = 130
    TERMINATED = 143


class GsgenError(Exception):
    """Base class of all exceptions that gsgen raises for invalid input.

    Attributes:
        message: The fault, with the offending value and the expected one.
        where: The file, tensor, row or option that holds the fault.
        hint: The next thing to do or type; may be empty.
        exit_code: The exit code of a command that the error ends.
    """

    exit_code: ClassVar[int] = ExitCode.USAGE

    def __init__(self, message: str, *, where: str = "", hint: str = "") -> None:
        self.message = message
        self.where = where
        self.hint = hint
        super().__init__(message)

    def located(self, where: str) -> Self:
        """Return a copy of the error with another location, whichever arguments its class takes."""
        error = type(self).__new__(type(self), *self.args)
        error.__dict__.update(self.__dict__)
        error.where = where
        return error

    def __str__(self) -> str:
        head = f"{self.where}: {self.message}" if self.where else self.message
        return f"{head}\n  {self.hint}" if self.hint else head


class FileNote(UserWarning):
    """Base class of warnings about input files, which every command prints as notes."""


class InputUnreadable(GsgenError):
    """Raised if an input file or folder is missing, damaged, or of another kind than expected."""

    exit_code: ClassVar[int] = ExitCode.UNREADABLE


class ModelUnreadable(InputUnreadable):
    """Raised if a file is not an ONNX model, so that no rule can be checked."""


class ManifestInvalid(GsgenError):
    """Raised if a model's manifest does not follow its JSON Schema, or cannot be written."""


class ConfigInvalid(GsgenError):
    """Raised if an option or a settings file holds an invalid value."""


class HostProcessFailed(GsgenError):
    """Raised if this machine, not the input, ended a run: no memory, a full disk, a killed process.

    It is never a verdict about a model.
    """


class LayoutMismatch(GsgenError):
    """Raised if arrays do not have the shapes or dtypes of the contract's packed layout."""


def names_meant(word: str, words: Mapping[str, str]) -> list[str]:
    """Return the names that people mean by another word: by meaning, not by letters.

    Args:
        word: The typed word; case, ``_`` for ``-`` and leading hyphens do not matter.
        words: Name → the other words for it, separated by spaces.
    """
    typed = word.lstrip("-").replace("_", "-").casefold()
    return [name for name, others in words.items() if typed in (name.lstrip("-"), *others.split())]


class UnknownName(ConfigInvalid):
    """Raised if no rule, target runtime, input role or plugin has the given name."""

    @classmethod
    def among(
        cls,
        noun: str,
        name: str,
        known: Iterable[str],
        where: str = "",
        words: Mapping[str, str] | None = None,
        listing: str = "",
    ) -> "UnknownName":
        """Return the error for an unknown name, whose hint says which known name was meant.

        Args:
            noun: What the name is of.
            name: The unknown name.
            known: The known names.
            where: Location of the name.
            words: Known name → other words for it, which count before similar letters do.
            listing: What lists the known names, where they are too many for an error.
        """
        from difflib import get_close_matches  # imported on failure only: start-up time counts

        names = sorted(known)
        meant = names_meant(name, dict.fromkeys(names, "") | dict(words or {}))
        begun = [known_name for known_name in names if known_name.startswith(f"{name}-")]
        matches = meant or begun[:3] or get_close_matches(name, names, n=1, cutoff=0.65)
        is_short_list = len(names) <= _MAX_LISTED_NAMES
        nearest_names = get_close_matches(name, names, n=3, cutoff=0.0)
        examples_text = f"{len(names)} are known, such as {', '.join(nearest_names)}."
        examples_text = listing or examples_text
        known_text = f"Known: {', '.join(names) or 'none'}." if is_short_list else examples_text
        hint = f"Did you mean {' or '.join(map(repr, matches))}?" if matches else known_text
        return cls(f"unknown {noun} {name!r}", where=where, hint=hint)
