"""Lets import-linter see all four folders of gsgen, whose path is complete once it is imported."""

__all__ = ["LayersContract"]

from importlinter.contracts.layers import LayersContract

import gsgen  # noqa: F401
