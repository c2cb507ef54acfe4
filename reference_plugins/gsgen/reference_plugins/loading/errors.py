"""Exceptions raised for checkpoints that cannot be read."""

__all__ = ["CheckpointInvalid", "NotInCheckpoint"]

from typing import ClassVar

from gsgen.contract.errors import ExitCode, InputUnreadable


class CheckpointInvalid(InputUnreadable):
    """A checkpoint is incomplete or damaged, or differs from the files of its method."""


class NotInCheckpoint(CheckpointInvalid):
    """An option asks for a part that a valid checkpoint does not have (exit code 2)."""

    exit_code: ClassVar[int] = ExitCode.USAGE
