"""The radix sort is NumPy's stable sort."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared import counts as counting
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.kernel import run
from gsgen.runtime.kernels.shared.shader import NO_ID
from gsgen.runtime.kernels.sort.scan import Scan
from gsgen.runtime.kernels.sort.sort import SortConfig, sort_config_for
from references.sorting import scan_reference, sort_reference
from support.rendering.sorting import GPU, KEYS, Bench, keys_of

KEY_CAPACITY = 1 << 16
MANY_KEYS = 300_000
SMALL = SortConfig(threads=256, run=4, digit_bits=4, walk_rows=4, tile=32)


@pytest.fixture(scope="module", params=["this device", "many invocations"])
def cut(request: pytest.FixtureRequest, device: Device) -> SortConfig:
    return sort_config_for(device) if request.param == "this device" else GPU


@pytest.fixture(scope="module", params=["this device", "many invocations", "counted before"])
def compacting(request: pytest.FixtureRequest, device: Device) -> Bench:
    cut = sort_config_for(device) if request.param == "this device" else GPU
    return Bench(
        device, cut, 32, KEY_CAPACITY, compact=True, counted=request.param == "counted before"
    )


@pytest.mark.parametrize("kind", KEYS)
@pytest.mark.parametrize("n", [0, 1, 7, 4096, 4097, 65_536])
def test_compacting_sort_agrees_with_numpy(compacting: Bench, n: int, kind: str) -> None:
    # Keys behind the n are absent: the first pass looks at all there is room for.
    keys = np.full(KEY_CAPACITY, NO_ID, np.uint32)
    keys[:n] = keys_of(n, kind)
    keys_out, places = compacting(keys)
    expected = sort_reference(keys, 32)
    np.testing.assert_array_equal(places, expected)
    np.testing.assert_array_equal(keys_out, keys[expected])


@settings(max_examples=25, deadline=None)
@given(st.lists(st.sampled_from([0, 1, 2, 255, 256, 1 << 31, NO_ID - 1, NO_ID])))
def test_arbitrary_keys_are_sorted(compacting_here: Bench, keys: list[int]) -> None:
    padded_keys = np.full(KEY_CAPACITY, NO_ID, np.uint32)
    padded_keys[: len(keys)] = keys
    np.testing.assert_array_equal(compacting_here(padded_keys)[1], sort_reference(padded_keys, 32))


@pytest.fixture(scope="module")
def compacting_here(device: Device) -> Bench:
    return Bench(device, sort_config_for(device), 32, KEY_CAPACITY, compact=True)


@pytest.mark.parametrize("bits", [1, 2, 8, 11, 13, 24])
def test_precounted_low_bits_are_sorted_with_values(device: Device, bits: int) -> None:
    """No kernel counts them again."""
    keys = keys_of(5000, "random", seed=bits) & np.uint32((1 << bits) - 1)
    sort = Bench(device, GPU, bits, 6000, compact=False, counted=True)
    assert "count" not in [step.kernel.label for step in sort.steps]
    keys_out, places = sort(keys)
    order = np.argsort(keys, kind="stable")
    np.testing.assert_array_equal(places, order)
    np.testing.assert_array_equal(keys_out, keys[order])


@pytest.mark.parametrize("bits", [1, 5, 12, 13, 17])
@pytest.mark.parametrize("n", [0, 1, 5000])
def test_low_bits_are_sorted_with_values(
    device: Device, cut: SortConfig, bits: int, n: int
) -> None:
    keys = keys_of(n, "random", seed=bits) & np.uint32((1 << bits) - 1)
    keys_out, places = Bench(device, cut, bits, 6000, compact=False)(keys)
    order = np.argsort(keys, kind="stable")
    np.testing.assert_array_equal(places, order)
    np.testing.assert_array_equal(keys_out, keys[order])


def test_few_keys_take_few_workgroups(device: Device) -> None:
    """Rows of a histogram are divided among as many workgroups as there are blocks of keys."""
    steps = Bench(device, GPU, 32, 3 * GPU.block, compact=True).steps
    scans = [step.groups for step in steps if step.kernel.label == "scan_rows"]
    assert scans == [step.groups for step in steps if step.kernel.label == "scatter"]
    assert scans[0] == (3, 1, 1)


@pytest.mark.parametrize("kind", KEYS)
def test_many_keys_are_sorted(many: Bench, kind: str) -> None:
    """As many as let the scan of a GPU go by blocks; `make fuzz-sort` has four million."""
    keys = keys_of(MANY_KEYS, kind, seed=4)
    keys_out, places = many(keys)
    expected = sort_reference(keys, 32)
    np.testing.assert_array_equal(places, expected)
    np.testing.assert_array_equal(keys_out, keys[expected])


@pytest.fixture(scope="module", params=["this device", "small blocks"])
def many(request: pytest.FixtureRequest, device: Device) -> Bench:
    cut = sort_config_for(device) if request.param == "this device" else SMALL
    return Bench(device, cut, 32, MANY_KEYS, compact=True)


@pytest.fixture(scope="module", params=["in one workgroup", "by blocks"])
def scan(request: pytest.FixtureRequest, device: Device) -> Scan:
    other = Device(device.raw)
    other.software = request.param == "in one workgroup"
    return Scan(other, 4096, 64, 256)


@pytest.mark.parametrize("n", [0, 1, 255, 256, 257, 6144, 10_000, 300_001])
@pytest.mark.parametrize("most", [5, 1 << 31])
def test_scan_agrees_with_cumulative_sum(device: Device, scan: Scan, n: int, most: int) -> None:
    numbers = np.random.default_rng(n).integers(0, most, n, np.uint32) // np.uint32(2)
    counts, room = device.storage("counts", counting.COUNTERS_BYTES), n + 5000
    buffer = device.storage("numbers", 4 * room)
    result = counting.initial(n, 77)
    trailing_values = np.full(room - n, 7, np.uint32)  # is neither added nor touched
    device.write(counts, result)
    device.write(buffer, np.append(numbers, trailing_values))
    steps = scan.steps(counts, buffer, source=Counts.GAUSSIANS, block=1, total=Counts.PAIRS)
    if room > 100_000:  # many blocks, which one workgroup would take long for
        assert len(steps) == (1 if scan._device.software else 3)
    encoder = device.raw.create_command_encoder()
    run(encoder, steps, "scan")
    device.raw.queue.submit([encoder.finish()])
    left = device.read(buffer, np.uint32, room)
    np.testing.assert_array_equal(left[:n], scan_reference(numbers))
    np.testing.assert_array_equal(left[n:], trailing_values)
    after = device.read(counts, np.uint32, counting.COUNTERS_BYTES // 4)
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
def test_scan_of_arbitrary_numbers_agrees_with_cumulative_sum(
    by_blocks: Scan, n: int, rows: int, most: int, seed: int
) -> None:
    """Of rows × ⌈n / 3⌉ numbers, whatever they are."""
    device = by_blocks._device
    length = rows * -(-n // 3)
    rng = np.random.default_rng(seed)
    numbers = rng.integers(0, most, length, np.uint32, endpoint=True)
    counts = device.storage("counts", counting.COUNTERS_BYTES)
    buffer = device.storage("numbers", 4 * 4 * 3000)
    device.write(counts, counting.initial(n, 0))
    device.write(buffer, numbers)
    steps = by_blocks.steps(counts, buffer, source=Counts.GAUSSIANS, block=3, rows=rows)
    encoder = device.raw.create_command_encoder()
    run(encoder, steps, "scan")
    device.raw.queue.submit([encoder.finish()])
    result = device.read(buffer, np.uint32, length)
    np.testing.assert_array_equal(result, scan_reference(numbers))


@pytest.fixture(scope="module")
def by_blocks(device: Device) -> Scan:
    other = Device(device.raw)
    other.software = False
    return Scan(other, 4096, 64, 256)
