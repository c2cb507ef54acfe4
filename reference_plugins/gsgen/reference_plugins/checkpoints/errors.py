"""What is wrong with a checkpoint."""

__all__ = ["CheckpointInvalid"]

from gsgen.contract.errors import GsgenError


class CheckpointInvalid(GsgenError):
    """A checkpoint lacks something, or holds something else than its method writes."""
