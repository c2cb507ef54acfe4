"""What is wrong with a checkpoint."""

__all__ = ["CheckpointInvalid", "NotInCheckpoint"]

from typing import ClassVar

from gsgen.contract.errors import InputUnreadable


class CheckpointInvalid(InputUnreadable):
    """A checkpoint lacks something, or holds something else than its method writes."""


class NotInCheckpoint(CheckpointInvalid):
    """An option asks for what a checkpoint, sound as it is, does not have (exit code 2)."""

    exit_code: ClassVar[int] = 2
