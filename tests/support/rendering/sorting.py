"""A sort on a device, alone, and keys that are hard for one."""

from collections.abc import Callable

import numpy as np

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared import counts as counting
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.kernel import run
from gsgen.runtime.kernels.shared.shader import NO_ID
from gsgen.runtime.kernels.sort.scan import Scan
from gsgen.runtime.kernels.sort.sort import Columns, RadixSort, SortConfig
from references.sorting import first_digits_reference

GPU = SortConfig(threads=256, run=8, digit_bits=8, walk_rows=4, tile=32)
"""How work is cut where there are many invocations."""


def _depths(n: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0.01, 1000, n).astype(np.float32).view(np.uint32)


def _mostly_absent_keys(n: int, rng: np.random.Generator) -> np.ndarray:
    keys = rng.integers(0, NO_ID, n, np.uint32)
    keys[rng.random(n) < 0.6] = NO_ID
    return keys


KEYS: dict[str, Callable[[int, np.random.Generator], np.ndarray]] = {
    "random": lambda n, rng: rng.integers(0, NO_ID, n, np.uint32),
    "depths": _depths,
    "absent": _mostly_absent_keys,
    "few": lambda n, rng: rng.integers(0, 3, n, np.uint32) << np.uint32(20),
    "equal": lambda n, rng: np.full(n, 0x3F800000, np.uint32),
    "reversed": lambda n, rng: np.arange(n, dtype=np.uint32)[::-1] * np.uint32(977),
    "sawtooth": lambda n, rng: np.arange(n, dtype=np.uint32) % 4097 * np.uint32(65_537),
    "high bits": lambda n, rng: rng.integers(0, 255, n, np.uint32) << np.uint32(24),
    "one lower": lambda n, rng: np.append(np.full(n, 7, np.uint32), np.uint32(6))[-n or n :],
}
"""By name: ``n`` keys, of which each tries another thing."""


def keys_of(n: int, kind: str, seed: int = 0) -> np.ndarray:
    return KEYS[kind](n, np.random.default_rng(seed))


class Bench:
    """A sort of up to ``room`` keys, with what it reads and writes.

    Args:
        device: Where it runs.
        cut: How work is cut; scans of many numbers are as on a GPU where the cut is.
        bits: Of the keys.
        room: For how many keys.
        compact: Take as many keys as there is room for, and leave out those that are ABSENT.
        counted: The first digits are counted before, by NumPy.
    """

    def __init__(
        self,
        device: Device,
        cut: SortConfig,
        bits: int,
        room: int,
        compact: bool,
        counted: bool = False,
    ) -> None:
        self.device, self.room, self.compact = device, room, compact
        gpu_like_device = Device(device.raw)
        gpu_like_device.software = device.software and cut.threads < GPU.threads
        sort = RadixSort(device, cut, Scan(gpu_like_device, cut.block, 64, 256))
        self.counts = device.storage("counts", counting.COUNTERS_BYTES, extra_usage="INDIRECT")
        self.columns = [
            Columns(device.storage("keys", 4 * room), device.storage("values", 4 * room))
            for _ in range(2)
        ]
        self.block, self.digits = cut.block, sort.first_digits(bits) if counted else None
        self.histograms = sort.histograms(room, bits)
        self.steps, self.at = sort.steps(
            self.counts,
            self.histograms,
            self.columns,
            bits=bits,
            source=Counts.VISIBLE,
            groups=Counts.SORT_VISIBLE_GROUPS,
            compact_counter=room if compact else None,
            has_histogram=counted,
        )

    def __call__(self, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the sorted keys, and the places that they came from."""
        counts = counting.initial(len(keys), 0)
        counts[Counts.VISIBLE] = len(keys)
        counts[Counts.SORT_VISIBLE_GROUPS] = -(-len(keys) // self.block)
        self.device.write(self.counts, counts)
        self.device.write(self.columns[0].keys, keys)
        self.device.write(self.columns[0].values, np.arange(len(keys), dtype=np.uint32))
        if self.digits is not None:
            result = first_digits_reference(keys, self.digits)
            columns = self.histograms[0].size // (4 * self.digits.values)
            table = np.pad(result, [(0, 0), (0, columns - result.shape[1])])
            self.device.write(self.histograms[0], table)
        encoder = self.device.raw.create_command_encoder()
        run(encoder, self.steps, "sort")
        self.device.raw.queue.submit([encoder.finish()])
        retained = int(self.device.read(self.counts, np.uint32, 2)[Counts.VISIBLE])
        keys_out, values_out = self.columns[self.at]
        return (
            self.device.read(keys_out, np.uint32, retained),
            self.device.read(values_out, np.uint32, retained),
        )


def scanned(scan: Scan, device: Device, numbers: np.ndarray) -> np.ndarray:
    """Return what a scan makes of numbers."""
    counts = device.storage("counts", counting.COUNTERS_BYTES)
    buffer = device.storage("numbers", 4 * len(numbers))
    device.write(counts, counting.initial(len(numbers), 0))
    device.write(buffer, numbers)
    encoder = device.raw.create_command_encoder()
    run(encoder, scan.steps(counts, buffer, source=Counts.GAUSSIANS, block=1), "scan")
    device.raw.queue.submit([encoder.finish()])
    return device.read(buffer, np.uint32, len(numbers))
