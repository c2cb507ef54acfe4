"""Writes the recorded GPU work of frames as JSON tables, which store equal parts once."""

__all__ = ["PlanTables"]

import base64
from collections.abc import Mapping
from typing import Any, Final, final

import numpy as np

from gsgen.runtime.gpu.splat_residency import Page
from gsgen.runtime.kernels.project.project import PAGE
from gsgen.runtime.kernels.shared.kernel import Step
from web_client.formulas import Formula, Tree, replaced, tree_of
from web_client.recording import RecordedPlan, page_kind
from web_client.recording_device import (
    RecordedBind,
    RecordedBuffer,
    RecordedModule,
    RecordedPipeline,
)

_FOLLOWED: Final = ("gaussians", "pairs", "cells")
"""Sizes that plans write into buffers."""

_OF_SLOTS: Final = ("table", "seen", "dispatch")
"""Names of the GPU buffers of a splat pool (streamed tiles) besides rows and appearance."""


@final
class PlanTables:
    """JSON tables of shaders, buffers, bind groups and dispatches of recorded frame plans.

    A plan is a list of stages, a stage a list of steps. A step is the number of its row in the
    table. Steps that every page has are a mapping from the kind of a page to such a number, or to
    the numbers of several steps, as pages of splat pools have them.

    Attributes:
        tables: Rows by name of the table, as JSON values.
        plans: The plans, as JSON values.
    """

    def __init__(self) -> None:
        names = ("texts", "modules", "pipelines", "buffers", "binds", "steps")
        self.tables: dict[str, list[Any]] = {name: [] for name in names}
        self.plans: list[dict[str, Any]] = []
        self._rows: dict[tuple[str, str], int] = {}

    def pipeline(self, pipeline: RecordedPipeline) -> int:
        """Return the row index of a recorded compute pipeline in the JSON table of pipelines."""
        row = {
            "label": pipeline.label,
            "module": self.row("modules", module_row(self, pipeline.module)),
            "entry": pipeline.entry,
            "groups": list(pipeline.groups),
        }
        return self.row("pipelines", row)

    def add(self, recorded: RecordedPlan) -> None:
        """Add a recorded frame plan (GPU work of a frame) to the JSON tables."""
        self.plans.append(_PlanWriter(self, recorded).plan())

    def pool_buffers(self, page: Page, slots: str) -> dict[str, dict[str, Any]]:
        """Return the buffers of a splat pool (streamed tiles); sizes are formulas of the slots.

        Args:
            page: A recorded page.
            slots: Name of its number of slots in the recorded formulas.
        """
        assert page.slots is not None
        buffers = {"rows": page.rows, "appearance": page.appearance}
        buffers |= {name: getattr(page.slots, name) for name in _OF_SLOTS}
        return {
            name: {
                "label": buffer.label,
                "size": replaced(tree_of(buffer.size), slots, "slots"),
                "usage": buffer.usage,
                **_data(buffer, {}),
            }
            for name, buffer in buffers.items()
        }

    def row(self, table: str, value: Any) -> int:
        """Return the row index of a value in a JSON table; append the value if it is new."""
        key = (table, repr(value))
        if key not in self._rows:
            self._rows[key] = len(self.tables[table])
            self.tables[table].append(value)
        return self._rows[key]


@final
class _PlanWriter:
    """Writes one recorded frame plan (GPU work of a frame) into JSON tables."""

    def __init__(self, tables: PlanTables, recorded: RecordedPlan) -> None:
        self._tables, self._recorded = tables, recorded
        self._labels: dict[str, int] = {}
        self._buffers: dict[RecordedBuffer, int | str] = {}
        self._kinds, self._sets = {}, {}
        inputs = recorded.plan.inputs
        self._page_uniforms = [inputs[name] for name in ("pages", "sets") if name in inputs]
        for slot, page in enumerate(recorded.pages):
            self._kinds[page.rows] = slot
            self._buffers |= {page.rows: "rows", page.appearance: "appearance"}
            if page.cells is not None:
                self._buffers[page.cells] = "cells"
                self._sets[page.cells] = slot
            if page.slots is not None:
                self._buffers |= {getattr(page.slots, name): name for name in _OF_SLOTS}

    def plan(self) -> dict[str, Any]:
        """Return the recorded GPU work of a frame as a JSON object."""
        recorded = self._recorded
        plan, shape = recorded.plan, recorded.shape
        stages = {name: self._steps(steps) for name, steps in plan.stages.items()}
        clears = [
            [self._buffer(buffer), offset, size] for buffer, offset, size in plan.buffer_clears
        ]
        written = {
            "outputs": list(shape.outputs),
            "panorama": shape.panorama,
            "deep": shape.deep,
            "weighted": shape.weighted,
            "layers": shape.layers,
            "guards": [self._tree(guard) for guard in recorded.guards],
            "clears": [clear for clear in clears if isinstance(clear[0], int)],
            # What every page of a pool clears; all have the same.
            "pool_clears": [
                list(clear)
                for clear in dict.fromkeys(tuple(clear) for clear in clears)
                if isinstance(clear[0], str)
            ],
            "stages": stages,
            "images": {name: self._buffer(image) for name, image in plan.images.items()},
            "inputs": {name: self._buffer(buffer) for name, buffer in plan.inputs.items()},
        }
        rows = {row for row in self._buffers.values() if isinstance(row, int)}
        return written | {"buffers": sorted(rows)}

    def _steps(self, steps: list[Step]) -> list[int | dict[str, int | list[int]]]:
        """Return the indices of a drawing stage's dispatches in the frame plan's JSON table.

        Steps repeated per GPU page are a mapping by the page's kind; those per set, by ``set``.
        """
        result: list[int | dict[str, int | list[int]]] = []
        run: dict[int, list[int]] = {}
        for step, following in zip(steps, [*steps[1:], None], strict=True):
            slot = self._slot(step)
            if slot is None:
                result.append(self._step(step, None))
                continue
            run.setdefault(slot, []).append(self._step(step, slot))
            next_slot = None if following is None else self._slot(following)
            if next_slot is None or next_slot < slot:
                result.append(self._repeated(run, of_sets=not self._binds(step, self._kinds)))
                run = {}
        return result

    def _repeated(
        self, run: Mapping[int, list[int]], *, of_sets: bool
    ) -> dict[str, int | list[int]]:
        """Return the dispatches that repeat for every page (splat buffers), by data format."""
        slots = list(run)
        assert slots == list(range(len(self._recorded.pages))), f"pages are out of order: {slots}"
        rows_of: dict[str, list[int]] = {}
        for slot, rows in run.items():
            kind = "set" if of_sets else page_kind(self._recorded.pages[slot])
            # Pages of one kind differ in sizes alone, which formulas name.
            assert rows_of.setdefault(kind, rows) == rows, f"steps of two {kind} pages differ"
        return {kind: rows[0] if len(rows) == 1 else rows for kind, rows in rows_of.items()}

    def _slot(self, step: Step) -> int | None:
        """Return the index of the page (splat buffers) that a dispatch reads; None without one."""
        slots = self._binds(step, self._kinds) or self._binds(step, self._sets)
        assert len(slots) < 2, "a step reads several pages"
        return slots.pop() if slots else None

    def _binds(self, step: Step, slots: Mapping[RecordedBuffer, int]) -> set[int]:
        """Return the indices of the pages (splat buffers) that a recorded dispatch binds."""
        entries = [entry for bind in step.bind_groups for entry in bind.entries]
        return {slots[buffer] for buffer, _, _ in entries if buffer in slots}

    def _step(self, step: Step, slot: int | None) -> int:
        row: dict[str, Any] = {
            "pipeline": self._tables.pipeline(step.kernel.pipeline),
            "binds": [self._bind(bind, slot) for bind in step.bind_groups],
        }
        if len(step.groups) == 2:
            buffer, offset = step.groups
            row["indirect"] = [self._buffer(buffer), offset]
        else:
            row["groups"] = [self._tree(tree_of(count), slot) for count in step.groups]
        return self._tables.row("steps", row)

    def _bind(self, bind: RecordedBind, slot: int | None) -> int:
        entries = []
        for buffer, offset, size in bind.entries:
            if slot is not None and buffer in self._page_uniforms:
                assert (offset, size) == (PAGE.itemsize * slot, PAGE.itemsize)
                offset = Formula(offset, ["mul", PAGE.itemsize, "slot"], [])
            row = self._buffer(buffer)
            # Buffers that others make may be larger than their bound part; those of pools are not.
            is_own = isinstance(row, int) or self._recorded.pages[slot or 0].slots is not None
            whole = is_own and tree_of(size) == tree_of(buffer.size)
            formulas = [self._tree(tree_of(number), slot) for number in (offset, size)]
            entries.append([row, formulas[0], None if whole else formulas[1]])
        return self._tables.row("binds", {"kinds": bind.kinds, "entries": entries})

    def _buffer(self, buffer: RecordedBuffer) -> int | str:
        """Return a buffer's row in the JSON table of GPU buffers; repeated labels get a number."""
        if buffer not in self._buffers:
            number, sizes = self._labels.get(buffer.label, 0), self._recorded.sizes
            self._labels[buffer.label] = number + 1
            row = {
                "label": f"{buffer.label} {number}" if number else buffer.label,
                "size": self._size(buffer),
                "usage": buffer.usage,
                **_data(buffer, {name: sizes[name] for name in _FOLLOWED}),
            }
            self._buffers[buffer] = self._tables.row("buffers", row)
        return self._buffers[buffer]

    def _size(self, buffer: RecordedBuffer) -> Tree:
        if buffer in self._page_uniforms:
            assert buffer.size == PAGE.itemsize * len(self._recorded.pages)
            return ["mul", PAGE.itemsize, "pages"]
        return self._tree(tree_of(buffer.size))

    def _tree(self, tree: Tree, slot: int | None = None) -> Tree:
        """Replace recorded sizes in a formula by the names that the browser client has for them."""
        for name, total in self._recorded.totals.items():
            tree = replaced(tree, total, name)
        if slot is None:
            return tree
        for name, of_page in (("capacity", "capacity"), ("cells", "set_cells"), ("slots", "slots")):
            tree = replaced(tree, f"{name} {slot}", of_page)
        return tree


def _data(buffer: RecordedBuffer, recorded_sizes: Mapping[str, int]) -> dict[str, Any]:
    """Return a buffer's initial bytes, and the offsets where recorded sizes are filled in."""
    if not buffer.data:
        return {}
    assert list(buffer.data) == [0], f"{buffer.label} is written in parts"
    words = np.frombuffer(buffer.data[0], np.uint32).copy()
    sizes: list[list[int | str]] = []
    for name, value in recorded_sizes.items():
        for index in np.flatnonzero(words == value).tolist():
            sizes.append([4 * index, name])
            words[index] = 0
    data: dict[str, Any] = {"data": base64.b64encode(words.tobytes()).decode()}
    return data | ({"sizes": sizes} if sizes else {})


def module_row(tables: PlanTables, module: RecordedModule) -> dict[str, Any]:
    """Convert a shader module to a JSON table entry: constants, and index of its WGSL text."""
    lines = module.code.splitlines(keepends=True)
    first = next(i for i, line in enumerate(lines) if not line.startswith("const "))
    return {
        "label": module.label,
        "constants": "".join(lines[:first]),
        "text": tables.row("texts", "".join(lines[first:])),
    }
