"""Normals: the direction in which each Gaussian is thinnest, towards the camera."""

__all__ = ["NormalsKernel", "normals_reference"]

from typing import final

import numpy as np
from jaxtyping import Float

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.splat_residency import Page
from gsgen.runtime.kernels.project.project import PAGE
from gsgen.runtime.kernels.shared.kernel import THREADS, Kernel, Step


@final
class NormalsKernel:
    """``normals.wgsl``.

    Args:
        device: Where it runs.
        packed: Whether rows are, as compact_rows.py does.
    """

    def __init__(self, device: Device, *, packed: bool = False) -> None:
        self.kernel = Kernel(
            device, "normals", "find_normals", ("rw", "ur"), THREADS=THREADS, PACKED=packed
        )

    def step(self, keys: Buffer, normals: Buffer, uniform: Buffer, slot: int, page: Page) -> Step:
        """Return the step for a page, whose uniform is number ``slot`` of a buffer."""
        page_uniform = (uniform, slot * PAGE.itemsize, PAGE.itemsize)
        binds = (
            self.kernel.bind(keys, normals),
            self.kernel.bind(page_uniform, page.rows, group=1),
        )
        return Step(self.kernel, binds, (-(-page.capacity // THREADS), 1, 1))


def normals_reference(
    covariance: Float[np.ndarray, "n 3 3"], position: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Return normals as ``normals.wgsl`` must, for covariances other than balls.

    Args:
        covariance: In camera space.
        position: Of the centres, in camera space.
    """
    _, vectors = np.linalg.eigh(covariance)
    thinnest = vectors[:, :, 0]
    is_averted = np.einsum("nd,nd->n", thinnest, position) > 0
    return np.where(is_averted[:, None], -thinnest, thinnest)
