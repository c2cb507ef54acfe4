"""The frame plans of the browser: the written document holds what Python makes, at all sizes."""

import base64
import gzip
import json
import random
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.splat_residency import Page
from gsgen.runtime.renderer.frame_plan import Plan
from gsgen.runtime.renderer.kernel_set import Kernels
from gsgen.runtime.renderer.plan_options import ImageSpec, RasterMethod
from gsgen.runtime.scene.splat_pool import SLOT_ROWS
from gsgen.runtime.web.pages import client_file
from runtime.web.plan_executor import choose
from web_client.formulas import Formula, evaluate
from web_client.plan_tables import PlanTables
from web_client.plans import LAYERS, pool_kinds
from web_client.recording import (
    APPEARANCES,
    Appearance,
    Shape,
    record,
    recorded_pages,
    recorded_pool_pages,
)
from web_client.recording_device import RecordingDevice
from web_client.write import WRITTEN


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    return dict(json.loads(client_file("plans.json")))


@pytest.mark.parametrize("name", WRITTEN)
def test_the_committed_file_is_what_the_tool_writes(name: str) -> None:
    assert client_file(name).decode() == WRITTEN[name](), "run `make web`"


@pytest.mark.parametrize(
    ("name", "limit"), [("contract_rules.js", 40_500), ("plans.json", 120_000)]
)
def test_the_written_file_is_small(name: str, limit: int) -> None:
    assert len(gzip.compress(client_file(name))) <= limit


Pools = Sequence[tuple[Appearance, int]]
"""The pages of splat pools: the format of each page's appearance, and its number of slots."""


def kind_name(kind: Appearance) -> str:
    return f"{'float16' if kind.half else 'float32'} {kind.appearance_stride}"


def pool_kind(kind: Appearance) -> str:
    return f"pool of {kind_name(kind)}"


class Reading:
    """Evaluates a plan of the document: bytes of buffers, and steps, at given sizes."""

    def __init__(self, document: dict[str, Any], plan: dict[str, Any], sizes: dict[str, int],
                 kinds: list[Appearance], capacities: list[int],
                 cells: list[int] | None = None, pools: Pools = ()) -> None:  # fmt: skip
        self.document, self.plan, self.sizes = document, plan, sizes
        self.kinds, self.capacities = kinds, capacities
        self.cells = [0] * len(kinds) if cells is None else cells
        self.pools = pools

    def buffer(self, row: int) -> tuple[str, int, int, bytes]:
        entry = self.document["buffers"][row]
        words = np.frombuffer(base64.b64decode(entry.get("data", "")), np.uint32).copy()
        for offset, name in entry.get("sizes", ()):
            words[offset // 4] = self.sizes[name]
        label = entry["label"].rstrip("0123456789").rstrip()
        return label, self.rounded(entry["size"], {}), entry["usage"], words.tobytes()

    def rounded(self, tree: Any, page: dict[str, int]) -> int:
        return evaluate(tree, self.sizes | page)

    def steps(self) -> dict[str, list[Any]]:
        return {
            name: [step for entry in stage for step in self._each(entry)]
            for name, stage in self.plan["stages"].items()
        }

    def page_buffer(self, kind: str, name: str, page: dict[str, int]) -> tuple[Any, ...]:
        """Return a buffer of a pool's page as :func:`buffer_of` describes it."""
        entry = self.document["pools"][kind][name]
        data = base64.b64decode(entry.get("data", ""))
        return entry["label"], self.rounded(entry["size"], page), entry["usage"], data

    def clears(self) -> list[tuple[Any, ...]]:
        """Return label, offset and size of all cleared bytes, those of the pools' pages last."""
        own = [(self.buffer(row)[0], *remaining) for row, *remaining in self.plan["clears"]]
        return own + [
            (self.page_buffer(pool_kind(kind), name, {"slots": count})[0], *remaining)
            for kind, count in self.pools
            for name, *remaining in self.plan["pool_clears"]
        ]

    def _each(self, entry: int | dict[str, Any]) -> list[Any]:
        if isinstance(entry, int):
            return [self._step(entry, {})]
        if "set" in entry:
            return [
                self._step(entry["set"], {"slot": slot, "set_cells": count})
                for slot, count in enumerate(self.cells)
            ]
        return [
            self._step(
                entry[kind_name(kind)], {"slot": slot, "capacity": capacity, "set_cells": cells}
            )
            for slot, (kind, capacity, cells) in enumerate(
                zip(self.kinds, self.capacities, self.cells, strict=True)
            )
        ] + [
            self._step(row, {"slot": slot, "slots": count}, pool_kind(kind))
            for slot, (kind, count) in enumerate(self.pools, start=len(self.kinds))
            for row in np.atleast_1d(entry[pool_kind(kind)]).tolist()
        ]

    def _step(self, row: int, page: dict[str, int], pool: str | None = None) -> Any:
        step = self.document["steps"][row]
        pipeline = self.document["pipelines"][step["pipeline"]]
        module = self.document["modules"][pipeline["module"]]
        binds = [
            [self._entry(entry, page, pool) for entry in self.document["binds"][bind]["entries"]]
            for bind in step["binds"]
        ]
        if "indirect" in step:
            buffer, offset = step["indirect"]
            groups: Any = ((buffer, page["slot"]) if pool else self.buffer(buffer), offset)
        else:
            groups = tuple(self.rounded(count, page) for count in step["groups"])
        code = module["constants"] + self.document["texts"][module["text"]]
        return pipeline["entry"], code, tuple(pipeline["groups"]), binds, groups

    def _entry(self, entry: list[Any], page: dict[str, int], pool: str | None) -> Any:
        row, offset, size = entry
        if isinstance(row, str) and pool is not None and size is None:
            size = self.page_buffer(pool, row, page)[1]
        if isinstance(row, str):
            return row, page["slot"], self.rounded(offset, page), self.rounded(size, page)
        buffer = self.buffer(row)
        return buffer, self.rounded(offset, page), buffer[1] if size is None else size


SLOT_ARGUMENTS = ("table", "seen", "dispatch")


def buffer_of(buffer: Any) -> tuple[Any, ...]:
    return buffer.label, buffer.size, buffer.usage, buffer.data.get(0, b"")


def described(plan: Plan, pages: list[Page]) -> dict[str, list[Any]]:
    """Describe the steps of a plan of plain integers as :class:`Reading` does."""
    slots: dict[Any, tuple[str, int]] = {}
    for slot, page in enumerate(pages):
        slots |= {page.rows: ("rows", slot), page.appearance: ("appearance", slot)}
        slots |= {page.cells: ("cells", slot)}
        if page.slots is not None:
            slots |= {getattr(page.slots, name): (name, slot) for name in SLOT_ARGUMENTS}

    def groups_of(groups: Any) -> Any:
        if len(groups) != 2:
            return groups
        buffer, offset = groups
        return slots[buffer] if buffer in slots else buffer_of(buffer), offset

    def entry_of(buffer: Any, offset: int, size: int) -> Any:
        if buffer in slots:
            return (*slots[buffer], offset, size)
        return buffer_of(buffer), offset, size

    result = {}
    for name, steps in plan.stages.items():
        result[name] = [
            (
                step.kernel.pipeline.entry,
                step.kernel.pipeline.module.code,
                step.kernel.pipeline.groups,
                [[entry_of(*entry) for entry in bind.entries] for bind in step.bind_groups],
                groups_of(step.groups),
            )
            for step in steps
        ]
    return result


def fresh_plan(
    outputs: list[str], sizes: dict[str, int], kinds: list[Appearance], capacities: list[int],
    cells: list[int] | None = None, *, panorama: bool, deep: bool, layers: int = 0,
    pools: Pools = (), slot_rows: int = SLOT_ROWS,
) -> tuple[Plan, list[Page]]:  # fmt: skip
    device = Device(RecordingDevice())
    placed = recorded_pages(kinds, capacities, cells)
    if pools:
        placed += recorded_pool_pages(device, *zip(*pools, strict=True), slot_rows)
    image = ImageSpec(
        size=(sizes["width"], sizes["height"]),
        outputs=frozenset(outputs),
        projection="panorama" if panorama else "plane",
    )
    method = RasterMethod(pair_capacity=sizes["pairs"], sort="deep" if deep else "by key")
    plan = Plan(Kernels(device, is_single_shape=True), placed, image, method, layers=layers)
    return plan, [page for _, page in placed]


@pytest.mark.parametrize("seed", range(36))
def test_formulas_give_the_buffers_and_dispatches_of_python(
    seed: int, document: dict[str, Any]
) -> None:
    rng = random.Random(seed)
    panorama, deep, weighted = bool(seed & 1), bool(seed & 2), 16 <= seed < 32
    layers = LAYERS if seed >= 32 else 0
    panorama &= not layers
    outputs = [["color"], ["depth"], ["normal"], ["color", "depth"]][seed // 4 % 4]
    kinds = rng.choices(APPEARANCES, k=rng.randint(1, 6))
    capacities = [rng.choice([1, 2, 63, 64, 65, rng.randint(1, 1 << 18)]) for _ in kinds]
    cells = [-(-capacity // 5) for capacity in capacities] if weighted else None
    sizes = {
        "width": rng.choice([1, 16, 17, rng.randint(1, 4096)]),
        "height": rng.choice([1, 16, 17, rng.randint(1, 4096)]),
        "pairs": rng.choice([1, 4096, rng.randint(1, 1 << 26)]),
        "gaussians": sum(capacities),
        "pages": len(kinds),
        "cells": sum(cells or []),
    }
    shape = {"panorama": panorama, "deep": deep, "layers": layers}
    chosen = choose(document, sizes, outputs=outputs, weighted=weighted, **shape)
    plan, pages = fresh_plan(outputs, sizes, kinds, capacities, cells, **shape)
    reading = Reading(document, chosen, sizes, kinds, capacities, cells)
    assert reading.steps() == described(plan, pages)
    for name, row in chosen["images"].items():
        assert reading.buffer(row)[1] == plan.images[name].size
    for name, row in chosen["inputs"].items():
        assert reading.buffer(row)[:2] == (plan.inputs[name].label, plan.inputs[name].size)
    assert reading.clears() == [
        (buffer.label, *clear_range) for buffer, *clear_range in plan.buffer_clears
    ]


@pytest.mark.parametrize("seed", range(24))
def test_formulas_of_pools_give_the_buffers_and_dispatches_of_python(
    seed: int, document: dict[str, Any]
) -> None:
    """A scene of pages and splat pools, at random numbers of slots, rows of slots and pairs."""
    rng = random.Random(seed)
    layers = LAYERS if seed >= 16 else 0
    outputs = [["color"], ["depth"], ["normal"], ["color", "depth"]][0 if layers else seed % 4]
    shape = {"panorama": bool(seed & 4) and not layers, "deep": bool(seed & 8), "layers": layers}
    kinds = rng.choices(APPEARANCES, k=rng.randint(0, 3))
    capacities = [rng.choice([1, 64, rng.randint(1, 1 << 18)]) for _ in kinds]
    pools = [(rng.choice(APPEARANCES), rng.choice([1, 2, rng.randint(1, 64)]))
             for _ in range(rng.randint(1, 5))]  # fmt: skip
    slot_rows = rng.choice([SLOT_ROWS, 64, 64 * rng.randint(1, 128)])
    sizes = {
        "width": rng.choice([1, 17, rng.randint(1, 4096)]),
        "height": rng.choice([1, 17, rng.randint(1, 4096)]),
        "pairs": rng.choice([1, 4096, rng.randint(1, 1 << 26)]),
        "gaussians": sum(capacities) + slot_rows * sum(count for _, count in pools),
        "pages": len(kinds) + len(pools),
    }
    if slot_rows != SLOT_ROWS:  # a kernel's constant: pools of other slots are other plans
        document = pool_document(slot_rows, outputs, **shape)
    chosen = choose(document, sizes, outputs=outputs, weighted=False, **shape)
    reading = Reading(document, chosen, sizes, kinds, capacities, pools=pools)
    plan, pages = fresh_plan(
        outputs, sizes, kinds, capacities, pools=pools, slot_rows=slot_rows, **shape
    )
    assert reading.steps() == described(plan, pages)
    assert reading.clears() == [
        (buffer.label, *clear_range) for buffer, *clear_range in plan.buffer_clears
    ]
    for (kind, count), page in zip(pools, pages[len(kinds) :], strict=True):
        assert page.slots is not None
        buffers = {"rows": page.rows, "appearance": page.appearance}
        buffers |= {name: getattr(page.slots, name) for name in SLOT_ARGUMENTS}
        assert buffers.keys() == document["pools"][pool_kind(kind)].keys()
        for name, buffer in buffers.items():
            described_buffer = reading.page_buffer(pool_kind(kind), name, {"slots": count})
            assert described_buffer == buffer_of(buffer)


def pool_document(slot_rows: int, outputs: list[Any], **shape: Any) -> dict[str, Any]:
    """Record the plans of one shape for pools whose slots have another number of rows."""
    tables = PlanTables()
    for side in (512, 8192):  # one pass of the tile sort, and two
        tables.add(
            record(Shape(outputs=tuple(outputs), size=(side, side), slot_rows=slot_rows, **shape))
        )
    pools = pool_kinds(tables, slot_rows)
    return dict(json.loads(json.dumps({"plans": tables.plans, "pools": pools, **tables.tables})))


@pytest.mark.parametrize("name", ["slots", "gaussians", "pages"])
def test_a_wrong_formula_of_pools_is_noticed(name: str, document: dict[str, Any]) -> None:
    """The comparison above sees another size of a pool."""
    pools = [(APPEARANCES[3], 5), (APPEARANCES[0], 64)]
    sizes = {"width": 61, "height": 47, "pairs": 5000, "gaussians": 69 * SLOT_ROWS, "pages": 2}
    chosen = choose(document, sizes, outputs=["normal"], panorama=False, deep=False, layers=0)
    plan, pages = fresh_plan(["normal"], sizes, [], [], pools=pools, panorama=False, deep=False)
    expected = described(plan, pages)
    assert Reading(document, chosen, sizes, [], [], pools=pools).steps() == expected
    wrong = [(kind, count + (name == "slots")) for kind, count in pools]
    sizes |= {name: 7}
    assert Reading(document, chosen, sizes, [], [], pools=wrong).steps() != expected


def test_a_wrong_formula_is_noticed(document: dict[str, Any]) -> None:
    """The comparison above sees a change of any part of a plan."""
    sizes = {"width": 61, "height": 47, "pairs": 5000, "gaussians": 300, "pages": 1}
    kinds, capacities = [APPEARANCES[3]], [300]
    chosen = choose(document, sizes, outputs=["color"], panorama=False, deep=False)
    plan, pages = fresh_plan(["color"], sizes, kinds, capacities, panorama=False, deep=False)
    expected = described(plan, pages)
    for name in ("gaussians", "width", "pairs"):
        wrong = sizes | {name: 2 * sizes[name]}
        assert Reading(document, chosen, wrong, kinds, capacities).steps() != expected
    assert Reading(document, chosen, sizes, kinds, capacities).steps() == expected


def test_every_device_can_bind_what_a_pipeline_binds(document: dict[str, Any]) -> None:
    """WebGPU's default limits are eight storage buffers and twelve uniform buffers."""
    for pipeline in document["pipelines"]:
        kinds = "".join(pipeline["groups"])
        assert len(kinds.replace("u", "")) <= 8, pipeline["label"]
        assert kinds.count("u") <= 12


def test_every_plan_has_few_guards(document: dict[str, Any]) -> None:
    """A guard too many would leave sizes without a plan."""
    for plan in document["plans"]:
        assert [guard[0] for guard in plan["guards"]] == ["le"]


@pytest.mark.parametrize("seed", range(50))
def test_a_formula_computes_what_integers_compute(seed: int) -> None:
    rng = random.Random(seed)
    value, other = rng.randint(0, 10_000), rng.randint(1, 500)
    guards: list[Any] = []
    a = Formula(value, "a", guards)
    results = [
        a + other, other + a, a - other, other - a, a * other, other * a, a // other,
        -(-a // other), a % other, abs(a - other), -a, -(-other // (a + 1)),
    ]  # fmt: skip
    expected = [
        value + other, other + value, value - other, other - value, value * other, other * value,
        value // other, -(-value // other), value % other, abs(value - other), -value,
        -(-other // (value + 1)),
    ]  # fmt: skip
    for formula, number in zip(results, expected, strict=True):
        assert int(formula) == number == evaluate(formula.tree, {"a": value})
    assert guards == []
    assert (a < other) == (value < other)
    assert (a == other) == (value == other)
    assert len(guards) == 2
    assert all(evaluate(guard, {"a": value}) for guard in guards)
    bits = a.bit_length()
    assert bits == value.bit_length()
    assert evaluate(guards[-1], {"a": value})
    assert not evaluate(guards[-1], {"a": 1 << bits})
