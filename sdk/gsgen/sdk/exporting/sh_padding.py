"""Spherical harmonics of a degree that consumers take: what a checkpoint lacks is 0."""

__all__ = ["filled_harmonics"]

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import torch

from gsgen.contract.spec.spherical_harmonics import coefficients, degree_of
from gsgen.sdk.authoring.generator import GaussianGenerator, Gaussians
from gsgen.sdk.exporting.sh_degrees import taken_degree


@contextmanager
def filled_harmonics(
    generator: GaussianGenerator, *, half: bool, target: str
) -> Iterator[list[str]]:
    """Let ``generator`` give spherical harmonics of a degree that is taken, for a while.

    Which one that is, :func:`gsgen.sdk.exporting.sh_degrees.taken_degree` says.

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
        wanted, why = taken_degree(degree, half=half, target=target)
        if wanted == degree:
            return made
        if not told:
            told.append(why)
        missing = coefficients(wanted) - made.sh.shape[1]
        return replace(made, sh=torch.nn.functional.pad(made.sh, (0, 0, 0, missing)))

    hook = generator.register_forward_hook(fill)
    try:
        yield told
    finally:
        hook.remove()
