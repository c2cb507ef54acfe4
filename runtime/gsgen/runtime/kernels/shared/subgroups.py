"""Measures the subgroup size of a GPU: how many invocations run in lockstep."""

__all__ = ["subgroup_size"]

from typing import Final

import numpy as np

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared.kernel import Kernel, Step, run

_THREADS_PER_WORKGROUP: Final = 8


def subgroup_size(device: Device) -> int:
    """Return the subgroup size of a workgroup of eight invocations, or 0 without subgroups.

    The size is measured, because adapters only report a range.
    """
    if not device.subgroups:
        return 0
    kernel = Kernel(device, "subgroups", "measure", ("w",), THREADS=_THREADS_PER_WORKGROUP)
    sizes = device.storage("subgroup sizes", 4 * _THREADS_PER_WORKGROUP)
    encoder = device.raw.create_command_encoder(label="subgroups")
    run(encoder, [Step(kernel, (kernel.bind(sizes),), (1, 1, 1))], "subgroups")
    device.submit(encoder)
    measured_sizes = device.read(sizes, np.uint32, _THREADS_PER_WORKGROUP)
    return int(measured_sizes[0]) if (measured_sizes == measured_sizes[0]).all() else 0
