"""Normals: the direction in which each Gaussian is thinnest, towards the camera."""

__all__ = ["NormalsKernel", "normals_reference"]

from typing import Any, Final, final

import numpy as np
from jaxtyping import Float

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.project.project import PAGE
from gsgen.runtime.kernels.shared.kernel import Kernel, Step

_THREADS: Final = 64


@final
class NormalsKernel:
    """``normals.wgsl``.

    Args:
        device: Where it runs.
        packed: Whether rows are, as packing.py says.
    """

    def __init__(self, device: Device, packed: bool = False) -> None:
        self.kernel = Kernel(
            device,
            "normals",
            "find_normals",
            ("rw", "ur"),
            THREADS=_THREADS,
            PACKED=packed,
        )

    def step(self, keys: Any, normals: Any, uniform: Any, slot: int, page: Any) -> Step:
        """Return the step for a page, whose uniform is number ``slot`` of a buffer."""
        own = (uniform, slot * PAGE.itemsize, PAGE.itemsize)
        binds = (
            self.kernel.bind(keys, normals),
            self.kernel.bind(own, page.rows, group=1),
        )
        return Step(self.kernel, binds, (-(-page.capacity // _THREADS), 1, 1))


def normals_reference(
    covariance: Float[np.ndarray, "n 3 3"], position: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """What ``normals.wgsl`` must find, of covariances that are no balls.

    Args:
        covariance: In camera space.
        position: Of the centres, in camera space.
    """
    _, vectors = np.linalg.eigh(covariance)
    thinnest = vectors[:, :, 0]
    away = np.einsum("nd,nd->n", thinnest, position) > 0
    return np.where(away[:, None], -thinnest, thinnest)
