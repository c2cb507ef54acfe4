"""Counted figures of a frame of six million Gaussians on a GPU, from its recorded plan."""

from pathlib import Path

from support.rendering import frame_traffic
from support.rendering.frame_traffic import Workload

GUIDE = Path(__file__).parents[3] / "docs/guides/how-the-renderer-works.md"
H100 = 3.35e12  # bytes a second


def test_the_guide_has_these_figures() -> None:
    workload = Workload()
    now = frame_traffic.stage_bytes(workload)
    earlier = frame_traffic.earlier_bytes(workload)
    steps = frame_traffic.dispatches(workload)
    text = GUIDE.read_text("utf-8")
    for name, size in now.items():
        row = f"| {name} | {earlier[name] / 1e6:.0f} | {size / 1e6:.0f} | {1e3 * size / H100:.2f} |"
        assert f"{row} not measured | {steps[name]} |" in text
    sums = sum(earlier.values()) / 1e6, sum(now.values()) / 1e6, 1e3 * sum(now.values()) / H100
    row = "| frame | **{:.0f}** | **{:.0f}** | **{:.2f}** |".format(*sums)
    assert (
        f"{row} not measured | **{sum(steps.values())}** | **{frame_traffic.EARLIER_DISPATCHES}** |"
        in text
    )


def test_a_frame_moves_at_most_60_percent_of_the_earlier_bytes() -> None:
    workload = Workload()
    now = frame_traffic.stage_bytes(workload)
    earlier = frame_traffic.earlier_bytes(workload)
    assert now.keys() == earlier.keys()
    assert sum(now.values()) <= 0.6 * sum(earlier.values())
    assert all(now[name] <= earlier[name] for name in now)


def test_a_frame_has_at_most_45_dispatches() -> None:
    assert sum(frame_traffic.dispatches(Workload()).values()) <= 45


def test_a_pass_of_the_sort_reads_its_keys_once() -> None:
    """The kernels that write the keys count the digits of the first pass, without reading them."""
    reads = frame_traffic.key_reads(Workload())
    assert reads == {"sort": [1, 1, 1, 1], "group": [1, 1]}


def test_reads_of_a_written_buffer_are_noticed() -> None:
    """The order is written and read by the step that orders ties, and only written by the sort."""
    plan, _ = frame_traffic.recorded_plan(Workload())
    *_, scatter, ties = plan.stages["sort"]
    order = plan.buffers["values of Gaussians a"]
    assert frame_traffic.only_writes(scatter, order)
    assert frame_traffic.names_of(ties, order) == ["order"]
    assert not frame_traffic.only_writes(ties, order)


def test_more_splats_move_more_bytes() -> None:
    small_load, large_load = Workload(visible=1_000_000, small_pairs=3_000_000), Workload()
    small_bytes, more = map(frame_traffic.stage_bytes, (small_load, large_load))
    assert all(small_bytes[name] < more[name] for name in more)
