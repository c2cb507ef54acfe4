"""Exceptions raised for checkpoints that cannot be read."""

__all__ = ["CheckpointInvalid", "NotInCheckpoint", "format_faults", "reason_of"]

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar

from gsgen.contract.errors import ExitCode, InputUnreadable
from gsgen.formats.shared.errors import FormatError

_MAX_CHARACTERS = 300


class CheckpointInvalid(InputUnreadable):
    """Raised if a checkpoint is incomplete, damaged, or unlike the files of its method."""


class NotInCheckpoint(CheckpointInvalid):
    """Raised if an option asks for a part that a valid checkpoint does not have (exit code 2)."""

    exit_code: ClassVar[int] = ExitCode.USAGE


@contextmanager
def format_faults(path: Path) -> Iterator[None]:
    """Convert errors about a splat file to errors about a checkpoint."""
    try:
        yield
    except FormatError as error:
        raise CheckpointInvalid(str(error).replace(f"{path}: ", ""), where=str(path)) from error


def reason_of(error: Exception) -> str:
    """Return the line of an error message that describes the fault of a file.

    ``torch.load`` first advises to load the file without its safeguard, which would be unsafe;
    the refused name comes later.
    """
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    informative_lines = [line for line in lines if "GLOBAL" in line or "Unsupported" in line]
    return (informative_lines or lines or [type(error).__name__])[0][:_MAX_CHARACTERS]
