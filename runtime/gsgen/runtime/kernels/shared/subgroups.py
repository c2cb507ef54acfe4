"""Subgroups: how many invocations of a workgroup run as one, which some drivers tell."""

__all__ = ["lanes"]

from typing import Final

import numpy as np

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared.kernel import Kernel, Step, run

_THREADS: Final = 8


def lanes(device: Device) -> int:
    """Return the size of the subgroups of a workgroup of eight, or 0 where there are none.

    It is measured: adapters only tell a range.
    """
    if not device.subgroups:
        return 0
    kernel = Kernel(device, "subgroups", "measure", ("w",), THREADS=_THREADS)
    sizes = device.storage("subgroup sizes", 4 * _THREADS)
    encoder = device.raw.create_command_encoder(label="subgroups")
    run(encoder, [Step(kernel, (kernel.bind(sizes),), (1, 1, 1))], "subgroups")
    device.submit(encoder)
    found = device.read(sizes, np.uint32, _THREADS)
    return int(found[0]) if (found == found[0]).all() else 0
