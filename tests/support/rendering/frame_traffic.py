"""Counts the bytes and dispatches of a frame from its recorded plan, without a GPU.

    PYTHONPATH=tests .venv/bin/python -m support.rendering.frame_traffic

The rules: a pass moves each element of an array that it walks once; an element that is read by its
index moves a sector of 32 bytes, the least that GPUs read; atomic additions move the bytes of their
table once in each direction, since it fits the cache. The histograms of a sort count with the sort,
whichever kernel adds to them and wherever they are cleared. Numbers of splats and pairs are
assumptions, those of ``design/gpu.md``: two thirds of the Gaussians are visible, with three 16-pixel
tiles each.
"""

import json
import math
import re
import sys
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.splat_residency import GPU_PAGE_ROWS
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.kernel import Step
from gsgen.runtime.kernels.shared.shader import TILE
from gsgen.runtime.renderer.frame_plan import Plan
from gsgen.runtime.renderer.kernel_set import Kernels
from gsgen.runtime.renderer.plan_options import ImageSpec, RasterMethod
from web_client.recording import APPEARANCES, recorded_pages
from web_client.recording_device import RecordingDevice

SECTOR = 32
ROW = 40
HARMONICS = 192
SORTS = {"sort": "project", "group": "emit"}
"""The stages that sort, with the kernels that write their keys."""
DEGREE_3 = next(kind for kind in APPEARANCES if kind.channels == 48 and not kind.half)


@dataclass(frozen=True, slots=True, kw_only=True)
class Workload:
    """A frame: Gaussians of degree 3, and how many splats and pairs of small tiles they make."""

    gaussians: int = 6_060_000
    visible: int = 4_000_000
    small_pairs: int = 12_000_000
    size: tuple[int, int] = (1920, 1080)

    def pairs(self, tile: int) -> int:
        """Return the pairs with tiles of ``tile`` pixels, of square splats at random places."""
        width = TILE * (math.sqrt(self.small_pairs / self.visible) - 1)
        return round(self.visible * (1 + width / tile) ** 2)

    def tiles(self, tile: int) -> int:
        return -(-self.size[0] // tile) * -(-self.size[1] // tile)


def recorded_plan(workload: Workload) -> tuple[Plan, Kernels]:
    """Return the plan of a frame on a GPU whose bindings have any size."""
    device = Device(RecordingDevice())
    kernels = Kernels(device)
    n = workload.gaussians
    capacities = [min(GPU_PAGE_ROWS, n - first) for first in range(0, n, GPU_PAGE_ROWS)]
    placed = recorded_pages([DEGREE_3] * len(capacities), capacities)
    pairs = workload.pairs(kernels.sort_config.tile)
    image, method = ImageSpec(size=workload.size), RasterMethod(pair_capacity=pairs)
    return Plan(kernels, placed, image, method), kernels


def digit_words(step: Step) -> dict[str, int]:
    """Return what the uniform of a step of the sort says."""
    uniform: Any = step.bind_groups[0].entries[0][0]
    names = ("shift", "bits", "source", "first", "next_bits", "rows")
    words = np.frombuffer(uniform.data[0], np.uint32)
    return dict(zip(names, words.tolist(), strict=False))


def sort_bytes(step: Step, workload: Workload, pairs: int, block: int) -> int:
    """Return the bytes of a step of the sort."""
    digit = digit_words(step)
    numbers = {Counts.GAUSSIANS: workload.gaussians, Counts.VISIBLE: workload.visible}
    keys = numbers.get(Counts(digit["source"]), pairs)
    table = 4 * -(-keys // block) << digit["bits"]
    if step.kernel.label == "count":
        return 4 * keys + table
    if step.kernel.label == "scan_rows":
        return (3 if digit["next_bits"] else 2) * table  # read, written, and the next one cleared
    written = workload.visible if digit["first"] else keys
    values = 0 if digit["first"] else 4 * keys
    next_table = 4 * -(-written // block) << digit["next_bits"] if digit["next_bits"] else 0
    return 4 * keys + values + 8 * written + table + 2 * next_table


KEYS, HISTOGRAM = 2, 4  # bindings of the sort


def bound(step: Step, binding: int) -> Any:
    """Return a buffer that a recorded step of the sort binds."""
    binds: Any = step.bind_groups
    return binds[0].entries[binding][0]


def names_of(step: Step, buffer: Any) -> list[str]:
    """Return the variables of a recorded step that name a buffer which it may write."""
    binds, pipeline = step.bind_groups, step.kernel.pipeline  # type: Any, Any
    return [
        name
        for group, bind in enumerate(binds)
        for number, (entry, *_) in enumerate(bind.entries)
        if entry is buffer
        for name in re.findall(
            rf"@group\({group}\) @binding\({number}\) var<storage, read_write> (\w+)",
            pipeline.module.code,
        )
    ]


def only_writes(step: Step, buffer: Any) -> bool:
    """Return whether a recorded step writes a buffer, and its shader reads no element of it."""
    pipeline: Any = step.kernel.pipeline
    uses = [
        assigned
        for name in names_of(step, buffer)
        for assigned in re.findall(rf"\b{name}\[(?:[^][]|\[[^]]*\])*\]( = )?", pipeline.module.code)
    ]
    return bool(uses) and all(uses)


def counting_steps(plan: Plan, stage: str) -> list[Step]:
    """Return the steps of other stages that count the first digits of a sort.

    They bind its first histogram to write, as the kernels that write the keys do, and a frame begins
    with its clearing.
    """
    first = next(step for step in plan.stages[stage] if step.kernel.label == "scan_rows")
    histogram = bound(first, HISTOGRAM)
    actual = [
        step
        for name, steps in plan.stages.items()
        for step in steps
        if name != stage and names_of(step, histogram)
    ]
    assert not actual or (histogram, 0, None) in plan.buffer_clears
    return actual


def first_histogram_bytes(
    plan: Plan, stage: str, workload: Workload, pairs: int, block: int
) -> int:
    """Return the bytes of clearing and adding to a first histogram, where other stages count."""
    if not counting_steps(plan, stage):
        return 0
    keys = workload.gaussians if stage == "sort" else pairs
    first = next(step for step in plan.stages[stage] if step.kernel.label == "scan_rows")
    return 3 * (4 * -(-keys // block) * digit_words(first)["rows"])


def stage_bytes(workload: Workload) -> dict[str, int]:
    """Return the bytes of each stage of a recorded frame."""
    plan, kernels = recorded_plan(workload)
    pairs, visible = workload.pairs(kernels.sort_config.tile), workload.visible
    pixels, tiles = math.prod(workload.size), workload.tiles(kernels.sort_config.tile)
    runs = visible // kernels.sort_config.walk_rows
    splat = SECTOR if kernels.records(workload.gaussians) else 2 * SECTOR
    project = workload.gaussians * (ROW + 8) + visible * (HARMONICS + 48)
    sizes = {
        "project": project // len(plan.stages["project"]),
        "scan": 0,  # hundreds of numbers
        "order_ties": 4 * visible,
        "measure": visible * (4 + SECTOR) + 4 * runs,
        "reduce": 4 * runs,
        "spread": 8 * runs,
        "emit": visible * (4 + splat) + 4 * runs + 8 * pairs,
        "mark": 4 * pairs + 8 * tiles,
        "blend": pairs * (4 + splat + SECTOR) + 8 * tiles + 16 * pixels,
    }
    block = kernels.sort_config.block
    result = {
        name: sum(
            sizes[step.kernel.label]
            if step.kernel.label in sizes
            else sort_bytes(step, workload, pairs, block)
            for step in steps
        )
        for name, steps in plan.stages.items()
    }
    for name in SORTS:
        result[name] += first_histogram_bytes(plan, name, workload, pairs, block)
    return result


def earlier_bytes(workload: Workload) -> dict[str, int]:
    """Return the bytes of each stage by the same rules, with the kernels of before November 23.

    They sorted four bits a pass, read keys three times a pass, had tiles of 16 pixels, and three
    arrays of vectors.
    """
    n, visible, pairs = workload.gaussians, workload.visible, workload.small_pairs
    runs = visible // 4
    grouping = -(-(workload.tiles(TILE) - 1).bit_length() // 4)
    return {
        "project": n * (ROW + 8) + visible * (HARMONICS + 48),
        "sort": 12 * n + 8 * visible + 7 * 24 * visible + 4 * visible,
        "bin": visible * (4 + SECTOR) + 20 * runs + visible * (4 + 2 * SECTOR) + 8 * pairs,
        "group": grouping * 24 * pairs + 4 * pairs + 8 * workload.tiles(TILE),
        "blend": pairs * (4 + 3 * SECTOR) + 8 * workload.tiles(TILE)
        + 16 * math.prod(workload.size),
    }  # fmt: skip


EARLIER_DISPATCHES = 92
"""As recorded from the commit c1ef8800: 24 + 41 + 5 + 21 + 1."""


def dispatches(workload: Workload) -> dict[str, int]:
    """Return the number of dispatches of each stage."""
    return {name: len(steps) for name, steps in recorded_plan(workload)[0].stages.items()}


def key_reads(workload: Workload) -> dict[str, list[int]]:
    """Return how often each pass of the two sorts reads its keys."""
    plan, _ = recorded_plan(workload)
    reads = {}
    for name, writer in SORTS.items():
        steps = [step for step in plan.stages[name] if step.kernel.label in ("count", "scatter")]
        passes = Counter(digit_words(step)["shift"] for step in steps)
        reads[name] = [passes[shift] for shift in sorted(passes)]
        # Digits that no step of the sort counts are counted where the keys are written.
        if "count" not in [step.kernel.label for step in steps]:
            keys = bound(next(step for step in steps if step.kernel.label == "scatter"), KEYS)
            writers = [
                step
                for stage in plan.stages.values()
                for step in stage
                if step.kernel.label == writer and names_of(step, keys)
            ]
            assert writers
            assert counting_steps(plan, name) == writers
            assert all(only_writes(step, keys) for step in writers)
    return reads


def table(workload: Workload) -> dict[str, Any]:
    """Return the counted figures of a frame, before and now."""
    now, earlier, steps = stage_bytes(workload), earlier_bytes(workload), dispatches(workload)
    return {
        "MB": {name: [earlier[name] / 1e6, size / 1e6] for name, size in now.items()},
        "share of the bytes": sum(now.values()) / sum(earlier.values()),
        "dispatches": steps | {"sum": sum(steps.values()), "earlier": EARLIER_DISPATCHES},
        "reads of keys in each pass": key_reads(workload),
        "pairs": {
            size: workload.pairs(size)
            for size in (TILE, recorded_plan(workload)[1].sort_config.tile)
        },
    }


if __name__ == "__main__":
    sys.stdout.write(json.dumps(table(Workload()), indent=2) + "\n")
