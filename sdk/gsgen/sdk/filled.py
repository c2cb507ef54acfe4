"""Spherical harmonics of a degree that consumers take: what a checkpoint lacks is 0."""

__all__ = ["filled_harmonics"]

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import torch

from gsgen.contract.spherical_harmonics import MAX_DEGREE, coefficients, degree_of
from gsgen.sdk.generator import GaussianGenerator, Gaussians

# Consumers that read rows of one width alone (rule TV104).
_ONE_WIDTH = ("visionary",)


@contextmanager
def filled_harmonics(
    generator: GaussianGenerator, *, half: bool, target: str
) -> Iterator[list[str]]:
    """Let ``generator`` give spherical harmonics of a degree that is taken, for a while.

    Rows of float16 have to fill words of four bytes (rule GO015), which those of degree 0 and 2
    do not; and some consumers read degree 3 alone. Coefficients of 0 show nothing.

    Args:
        generator: Within the context it returns such harmonics.
        half: Outputs are float16.
        target: The consumer.

    Yields:
        What was done, in words; nothing while nothing is.
    """
    told: list[str] = []

    def fill(_module: Any, _given: Any, made: Any) -> Any:
        if not isinstance(made, Gaussians) or made.sh is None:
            return made
        degree = degree_of(made.sh.shape[1])
        wanted = degree + 1 if half and made.sh.shape[1] % 2 else degree
        wanted = MAX_DEGREE if target in _ONE_WIDTH else wanted
        if wanted == degree:
            return made
        if not told:
            why = f"{target} reads no other" if target in _ONE_WIDTH else "rows fill words"
            told.append(f"SH of degree {degree} are written as degree {wanted}: {why}")
        missing = coefficients(wanted) - made.sh.shape[1]
        return replace(made, sh=torch.nn.functional.pad(made.sh, (0, 0, 0, missing)))

    hook = generator.register_forward_hook(fill)
    try:
        yield told
    finally:
        hook.remove()
