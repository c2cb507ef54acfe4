"""What an export computed before the trace."""

__all__ = ["FoldedConstants"]

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FoldedConstants:
    """The operations that an export computed before the trace, as no input reaches them."""

    operations: int
    nbytes: int  # the size of the results that the file holds
