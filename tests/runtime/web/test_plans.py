"""The frame plans of the browser: the written document holds what Python makes, at all sizes."""

import base64
import gzip
import json
import random
from typing import Any

import numpy as np
import pytest

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.splat_residency import Page
from gsgen.runtime.renderer.frame_plan import Plan
from gsgen.runtime.renderer.kernel_set import Kernels
from gsgen.runtime.web import plans
from gsgen.runtime.web.formulas import Formula, evaluate
from gsgen.runtime.web.plans import LAYERS
from gsgen.runtime.web.recording import APPEARANCES, Appearance, recorded_pages
from gsgen.runtime.web.recording_device import RecordingDevice


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    return dict(json.loads(plans.written_plans()))


def test_the_written_plans_are_current() -> None:
    assert plans.written_plans() == plans.plans_text(), "run `make web`"


def test_the_written_plans_are_small() -> None:
    assert len(gzip.compress(plans.written_plans().encode())) <= 120_000


def kind_name(kind: Appearance) -> str:
    return f"{'float16' if kind.half else 'float32'} {kind.stride}"


def choose(document: dict[str, Any], sizes: dict[str, int], **shape: object) -> dict[str, Any]:
    """Return the first plan of a shape whose guards hold, as the client does."""
    return next(
        plan
        for plan in document["plans"]
        if all(plan[name] == value for name, value in shape.items())
        and all(evaluate(guard, sizes) for guard in plan["guards"])
    )


class Reading:
    """Evaluates a plan of the document: bytes of buffers, and steps, at given sizes."""

    def __init__(self, document: dict[str, Any], plan: dict[str, Any], sizes: dict[str, int],
                 kinds: list[Appearance], capacities: list[int],
                 cells: list[int] | None = None) -> None:  # fmt: skip
        self.document, self.plan, self.sizes = document, plan, sizes
        self.kinds, self.capacities = kinds, capacities
        self.cells = [0] * len(kinds) if cells is None else cells

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

    def _each(self, entry: int | dict[str, int]) -> list[Any]:
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
        ]

    def _step(self, row: int, page: dict[str, int]) -> Any:
        step = self.document["steps"][row]
        pipeline = self.document["pipelines"][step["pipeline"]]
        module = self.document["modules"][pipeline["module"]]
        binds = [
            [self._entry(entry, page) for entry in self.document["binds"][bind]["entries"]]
            for bind in step["binds"]
        ]
        if "indirect" in step:
            groups: Any = (self.buffer(step["indirect"][0]), step["indirect"][1])
        else:
            groups = tuple(self.rounded(count, page) for count in step["groups"])
        code = module["constants"] + self.document["texts"][module["text"]]
        return pipeline["entry"], code, tuple(pipeline["groups"]), binds, groups

    def _entry(self, entry: list[Any], page: dict[str, int]) -> Any:
        row, offset, size = entry
        if isinstance(row, str):
            return row, page["slot"], self.rounded(offset, page), self.rounded(size, page)
        buffer = self.buffer(row)
        return buffer, self.rounded(offset, page), buffer[1] if size is None else size


def described(plan: Plan, pages: list[Page]) -> dict[str, list[Any]]:
    """Describe the steps of a plan of plain integers as :class:`Reading` does."""
    slots: dict[Any, tuple[str, int]] = {}
    for slot, page in enumerate(pages):
        slots |= {page.rows: ("rows", slot), page.appearance: ("appearance", slot)}
        slots |= {page.cells: ("cells", slot)}

    def buffer_of(buffer: Any) -> Any:
        return buffer.label, buffer.size, buffer.usage, buffer.data.get(0, b"")

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
                [[entry_of(*entry) for entry in bind.entries] for bind in step.binds],
                (buffer_of(step.groups[0]), step.groups[1])
                if len(step.groups) == 2
                else step.groups,
            )
            for step in steps
        ]
    return result


def fresh_plan(
    outputs: list[str], sizes: dict[str, int], kinds: list[Appearance], capacities: list[int],
    cells: list[int] | None = None, *, panorama: bool, deep: bool, layers: int = 0,
) -> tuple[Plan, list[Page]]:  # fmt: skip
    device = Device(RecordingDevice())
    placed = recorded_pages(kinds, capacities, cells)
    plan = Plan(
        device,
        Kernels(device, one_shape=True),
        placed,
        (sizes["width"], sizes["height"]),
        frozenset(outputs),
        sizes["pairs"],
        panorama=panorama,
        deep=deep,
        layers=layers,
    )
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
    clears = [(reading.buffer(row)[0], *rest) for row, *rest in chosen["clears"]]
    assert clears == [(buffer.label, *rest) for buffer, *rest in plan.clears]


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
