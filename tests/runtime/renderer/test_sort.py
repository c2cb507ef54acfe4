"""The radix sort is NumPy's stable sort."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.runtime.device import Device
from gsgen.runtime.kernels import counts as counting
from gsgen.runtime.kernels.counts import Counts
from gsgen.runtime.kernels.kernel import run
from gsgen.runtime.kernels.scan import Scan, scan_reference
from gsgen.runtime.kernels.shader import ABSENT
from gsgen.runtime.kernels.sort import Columns, Cut, RadixSort, cut_for, sort_reference

ROOM = 1 << 16
GPU = Cut(256, 16, 4, 4)  # how work is cut where there are many invocations


class Bench:
    """A sort of up to ``room`` keys, with what it reads and writes."""

    def __init__(
        self, device: Device, cut: Cut, bits: int, room: int, compact: bool
    ) -> None:
        self.device, self.room, self.compact = device, room, compact
        self.scan = Scan(device, cut.block, 64, 256)
        sort = RadixSort(device, cut, self.scan)
        self.counts = device.storage("counts", counting.BYTES, extra="INDIRECT")
        self.columns = [
            Columns(device.storage("keys", 4 * room), device.storage("values", 4 * room))
            for _ in range(2)
        ]
        self.block = cut.block
        self.steps, self.at = sort.steps(
            self.counts,
            sort.histogram(room),
            self.columns,
            bits=bits,
            source=Counts.VISIBLE,
            groups=Counts.SORT_VISIBLE_GROUPS,
            compacting=room if compact else None,
        )

    def __call__(self, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the sorted keys, and the places that they came from."""
        counts = counting.initial(len(keys), 0)
        counts[Counts.VISIBLE] = len(keys)
        counts[Counts.SORT_VISIBLE_GROUPS] = -(-len(keys) // self.block)
        self.device.write(self.counts, counts)
        self.device.write(self.columns[0].keys, keys)
        self.device.write(self.columns[0].values, np.arange(len(keys), dtype=np.uint32))
        encoder = self.device.raw.create_command_encoder()
        run(encoder, self.steps, "sort")
        self.device.raw.queue.submit([encoder.finish()])
        kept = int(self.device.read(self.counts, np.uint32, 2)[Counts.VISIBLE])
        keys_out, values_out = self.columns[self.at]
        return (
            self.device.read(keys_out, np.uint32, kept),
            self.device.read(values_out, np.uint32, kept),
        )


@pytest.fixture(scope="module", params=["this device", "many invocations"])
def cut(request: pytest.FixtureRequest, device: Device) -> Cut:
    return cut_for(device) if request.param == "this device" else GPU


@pytest.fixture(scope="module")
def compacting(device: Device, cut: Cut) -> Bench:
    return Bench(device, cut, 32, ROOM, compact=True)


def keys_of(n: int, kind: str, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    if kind == "random":
        return rng.integers(0, ABSENT, n, np.uint32)
    if kind == "few":
        return rng.integers(0, 3, n, np.uint32) << np.uint32(20)
    if kind == "depths":
        return rng.uniform(0.01, 1000, n).astype(np.float32).view(np.uint32)
    keys = rng.integers(0, ABSENT, n, np.uint32)
    keys[rng.random(n) < 0.6] = ABSENT
    return keys


@pytest.mark.parametrize("kind", ["random", "few", "depths", "absent"])
@pytest.mark.parametrize("n", [0, 1, 7, 8, 4095, 4096, 4097, 65_536])
def test_sorted_is_numpys(compacting: Bench, n: int, kind: str) -> None:
    # Keys behind the n are absent: the first pass looks at all there is room for.
    keys = np.full(ROOM, ABSENT, np.uint32)
    keys[:n] = keys_of(n, kind)
    keys_out, places = compacting(keys)
    wanted = sort_reference(keys, 32)
    np.testing.assert_array_equal(places, wanted)
    np.testing.assert_array_equal(keys_out, keys[wanted])


@settings(max_examples=25, deadline=None)
@given(st.lists(st.sampled_from([0, 1, 2, 255, 256, 1 << 31, ABSENT - 1, ABSENT])))
def test_any_keys(compacting_here: Bench, keys: list[int]) -> None:
    held = np.full(ROOM, ABSENT, np.uint32)
    held[: len(keys)] = keys
    np.testing.assert_array_equal(compacting_here(held)[1], sort_reference(held, 32))


@pytest.fixture(scope="module")
def compacting_here(device: Device) -> Bench:
    return Bench(device, cut_for(device), 32, ROOM, compact=True)


@pytest.mark.parametrize("bits", [1, 5, 12, 13, 17])
@pytest.mark.parametrize("n", [0, 1, 5000])
def test_low_bits_with_values(device: Device, cut: Cut, bits: int, n: int) -> None:
    keys = keys_of(n, "random", seed=bits) & np.uint32((1 << bits) - 1)
    keys_out, places = Bench(device, cut, bits, 6000, compact=False)(keys)
    wanted = np.argsort(keys, kind="stable")
    np.testing.assert_array_equal(places, wanted)
    np.testing.assert_array_equal(keys_out, keys[wanted])


def test_a_million_keys(device: Device) -> None:
    keys = keys_of(1_000_000, "depths", seed=4)
    keys[::7] = ABSENT
    bench = Bench(device, cut_for(device), 32, len(keys), compact=True)
    np.testing.assert_array_equal(bench(keys)[1], sort_reference(keys, 32))


@pytest.fixture(scope="module", params=["in one workgroup", "by blocks"])
def scan(request: pytest.FixtureRequest, device: Device) -> Scan:
    other = Device(device.raw)
    other.software = request.param == "in one workgroup"
    return Scan(other, 4096, 64, 256)


@pytest.mark.parametrize("n", [0, 1, 255, 256, 257, 6144, 10_000, 300_001])
@pytest.mark.parametrize("most", [5, 1 << 31])
def test_scan(device: Device, scan: Scan, n: int, most: int) -> None:
    numbers = np.random.default_rng(n).integers(0, most, n, np.uint32) // np.uint32(2)
    counts, room = device.storage("counts", counting.BYTES), n + 5000
    buffer = device.storage("numbers", 4 * room)
    made = counting.initial(n, 77)
    behind = np.full(room - n, 7, np.uint32)  # is neither added nor touched
    device.write(counts, made)
    device.write(buffer, np.append(numbers, behind))
    steps = scan.steps(counts, buffer, source=Counts.GAUSSIANS, block=1, total=Counts.PAIRS)
    encoder = device.raw.create_command_encoder()
    run(encoder, steps, "scan")
    device.raw.queue.submit([encoder.finish()])
    left = device.read(buffer, np.uint32, room)
    np.testing.assert_array_equal(left[:n], scan_reference(numbers))
    np.testing.assert_array_equal(left[n:], behind)
    after = device.read(counts, np.uint32, counting.BYTES // 4)
    total = min(int(numbers.sum(dtype=np.uint64)), 0x7FFFFFFF)
    assert after[Counts.WANTED_PAIRS] == total
    assert after[Counts.PAIRS] == min(total, 77)
    assert after[Counts.SORT_PAIRS_GROUPS] == -(-min(total, 77) // 4096)
    assert after[Counts.SORT_PAIRS_GROUPS + 1 :][:2].tolist() == [1, 1]


@settings(max_examples=20, deadline=None)
@given(
    st.integers(0, 9000),
    st.integers(0, 4),
    st.sampled_from([1, 3, 1000, 0x7FFFFFFF]),
    st.integers(0, 1 << 32),
)
def test_any_scan(by_blocks: Scan, n: int, rows: int, most: int, seed: int) -> None:
    """Of rows × ⌈n / 3⌉ numbers, whatever they are."""
    device = by_blocks._device
    length = rows * -(-n // 3)
    rng = np.random.default_rng(seed)
    numbers = rng.integers(0, most, length, np.uint32, endpoint=True)
    counts = device.storage("counts", counting.BYTES)
    buffer = device.storage("numbers", 4 * 4 * 3000)
    device.write(counts, counting.initial(n, 0))
    device.write(buffer, numbers)
    steps = by_blocks.steps(counts, buffer, source=Counts.GAUSSIANS, block=3, rows=rows)
    encoder = device.raw.create_command_encoder()
    run(encoder, steps, "scan")
    device.raw.queue.submit([encoder.finish()])
    made = device.read(buffer, np.uint32, length)
    np.testing.assert_array_equal(made, scan_reference(numbers))


@pytest.fixture(scope="module")
def by_blocks(device: Device) -> Scan:
    other = Device(device.raw)
    other.software = False
    return Scan(other, 4096, 64, 256)
