"""Pads a generator's SH coefficients with zeros up to the degree that a viewer can read."""

__all__ = ["padded_harmonics"]

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import torch

from gsgen.contract.spec.spherical_harmonics import coefficients, degree_of
from gsgen.sdk.authoring.generator import GaussianGenerator, Gaussians
from gsgen.sdk.exporting.sh_degrees import stored_degree


@contextmanager
def padded_harmonics(
    generator: GaussianGenerator, *, half: bool, target: str
) -> Iterator[list[str]]:
    """Pad a generator's SH with zeros to the degree that the exported file stores.

    Yields notes on the padding; the list stays empty if the SH need none.
    """
    notes: list[str] = []

    def pad(_module: Any, _arguments: Any, output: Any) -> Any:
        if not isinstance(output, Gaussians) or output.sh is None:
            return output
        degree = degree_of(output.sh.shape[1])
        stored, note = stored_degree(degree, half=half, target=target)
        if stored == degree:
            return output
        if not notes:
            notes.append(note)
        missing = coefficients(stored) - output.sh.shape[1]
        padded = torch.nn.functional.pad(output.sh, (0, 0, 0, missing))
        return replace(output, sh=padded)

    forward_hook = generator.register_forward_hook(pad)
    try:
        yield notes
    finally:
        forward_hook.remove()
