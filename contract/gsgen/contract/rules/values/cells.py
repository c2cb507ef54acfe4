"""Validation rules of cells (groups of Gaussians) for weighted blending: sizes and values."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gsgen.contract._array_types import Bool, Float
from gsgen.contract.model.graph import Tensor
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.outputs import ModelOutputs
from gsgen.contract.spec.geometry import PSD_FLOOR, PSD_SLACK, smallest_eigenvalue
from gsgen.contract.spec.layout import (
    COVARIANCE,
    CULL_OPACITY,
    OPACITY,
    POSITION,
    ROW_LENGTH,
    VISIBILITY,
)
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.units import FLOAT16_EPSILON, FLOAT16_MAX
from gsgen.contract.validation.finding import Location, Violation, line_hint, set_hint, size_hint
from gsgen.contract.validation.gates import CELL_RULES, MANIFEST_PARSED
from gsgen.contract.validation.rule import rule

# A sigmoid in float16 may round up by one unit in the last place.
_VISIBILITY_SLACK = 1e-3
# A renderer draws a cell within twice its longest standard deviation.
_CELL_EXTENT_SIGMAS = 2.0


@rule("GM017", Severity.ERROR, needs=MANIFEST_PARSED)
def weighted_sum_complete(subject: InspectedModel) -> Iterator[Violation]:
    """`blend: wsr`, `weighted_sum` and `outputs.cells` are declared together or not at all.

    Why:
        A weighted sum is taken cell by cell, with weights that the manifest gives. A renderer that
        knows two of the three has to make up the third, or blends in another way than was meant.

    Hint:
        Declare the tensor of cells as outputs.cells and the weights as weighted_sum, or blend by
        alpha and declare neither.
    """
    generator = subject.generator
    if generator is None:
        return
    declarations = {
        "blend: wsr": generator.blend == "wsr",
        "weighted_sum": generator.weighted_sum is not None,
        "outputs.cells": generator.outputs.cells is not None,
    }
    if any(declarations.values()) and not all(declarations.values()):
        present_text, missing_text = (
            " and ".join(name for name, value in declarations.items() if value is is_declared_cells)
            for is_declared_cells in (True, False)
        )
        yield Violation.at(
            "manifest", f"{present_text} without {missing_text}", "all three, or none"
        )


@rule("GO020", Severity.ERROR, needs=("GM004", "GM017"))
def cell_row_has_10(subject: InspectedModel) -> Iterator[Violation]:
    """The output with cells (groups of Gaussians) is a matrix of ten columns and fixed row count.

    Why:
        A row is x y z visibility xx xy xz yy yz zz, read by position. Buffers are allocated before
        the first frame, and a recorded frame has fixed shapes.

    Hint:
        Return one [C, 10] tensor; the SDK packs it from `gsgen.sdk.Cells`.
    """
    tensor = subject.cells
    if tensor is None:
        return
    dims = tensor.dims or ()
    rows = dims[0] if dims else None
    has_row_count = isinstance(rows, int) and rows > 0
    if not (len(dims) == 2 and dims[1] == ROW_LENGTH and has_row_count):
        expected = f"[C, {ROW_LENGTH}] with a fixed C"
        hint = _matrix_hint(subject, tensor)
        yield Violation.at(f"output {tensor.name}", f"shape {tensor}", expected, hint=hint)


def _matrix_hint(subject: InspectedModel, tensor: Tensor) -> str:
    """Return the hint to drop a batch axis, or to give a symbolic number of cells its size."""
    dims, declared, gaussians = (
        tensor.dims or (),
        subject.declared_cells,
        subject.declared_gaussians,
    )
    if len(dims) == 3 and dims[0] == 1:
        return line_hint("rows = rows[0]")
    symbol = dims[0] if len(dims) == 2 else None
    if not isinstance(symbol, str) or not symbol or declared is None or gaussians is None:
        return ""
    return size_hint(symbol, gaussians.capacity // declared.per_cell)


@rule("GO021", Severity.ERROR, needs=("GO020", "GO002", "GO004"))
def cells_hold_all_rows(subject: InspectedModel) -> Iterator[Violation]:
    """The number of cells, times the rows of each (`per_cell`), is the number of packed Gaussians.

    Why:
        Row r belongs to cell r // per_cell, and to no other. With too few cells the last rows
        belong to none, and a renderer reads beyond the buffer; with too many, cells are empty.

    Hint:
        Give every cell the same number of rows, and fill the last ones with inert rows.
    """
    declared, tensor, rows = subject.declared_cells, subject.cells, subject.gaussians
    if declared is None or tensor is None or rows is None:
        return
    assert tensor.dims is not None
    assert rows.dims is not None
    cells, capacity = tensor.dims[0], rows.dims[0]
    if isinstance(cells, int) and cells * declared.per_cell != capacity:
        actual = f"{cells} cells of {declared.per_cell} rows"
        hint = _count_hint(cells, declared.per_cell, capacity)
        expected = f"cells for {capacity} rows"
        yield Violation.at(f"output {tensor.name}", actual, expected, hint=hint)


def _count_hint(cells: int, per_cell: int, capacity: int | str | None) -> str:
    """Return the hint to leave out cells beyond the rows, or to declare other rows per cell."""
    if not isinstance(capacity, int) or not capacity or not cells:
        return ""
    if capacity % per_cell == 0 and capacity // per_cell < cells:
        line = line_hint(f"rows = rows[:{capacity // per_cell}]")
        return f"If the last cells are empty: {line}"
    is_even = capacity % cells == 0
    return set_hint("outputs.cells.per_cell", capacity // cells) if is_even else ""


def _finite_mask(cells: Float[np.ndarray, "c 10"]) -> Bool[np.ndarray, " c"]:
    is_finite = np.isfinite(cells).all(axis=1)
    if cells.dtype == np.float16:
        is_finite &= np.abs(cells).max(axis=1, initial=0) < FLOAT16_MAX
    return np.asarray(is_finite)


def _rows_per_cell(emission: ModelOutputs) -> int:
    declared = emission.subject.declared_cells
    assert declared is not None
    return declared.per_cell


def _live_cells(emission: ModelOutputs) -> Bool[np.ndarray, " c"]:
    """Return the mask of cells (groups of Gaussians) with a row before the row count."""
    assert emission.cells is not None
    first = np.arange(len(emission.cells)) * _rows_per_cell(emission)
    return np.asarray(first < emission.count)


@rule("GV026", Severity.ERROR, needs=CELL_RULES)
def cells_finite(emission: ModelOutputs) -> Iterator[Violation]:
    """Every value of the cells output is finite; float16 values are below the largest float16.

    Why:
        Renderers sort cells: a NaN sorts anywhere, and takes all Gaussians of the cell along.
        65504 means that the value was clamped on its way into float16.

    Hint:
        Find the division, logarithm or norm that sees zero, such as the mean of quaternions whose
        weights are all zero, and clamp before it. To hide such cells and rows meanwhile, end on
        `rows = torch.where((rows.abs() < 65504).all(1, True), rows, 0)`.
    """
    cells = emission.cells
    if cells is not None and not emission.zeros:
        location, expected = Location(emission.cells_label), "finite values"
        yield Violation.rows(location, ~_finite_mask(cells), cells, expected, checked=len(cells))


@rule("GV027", Severity.ERROR, needs=CELL_RULES, at_moments=True)
def visibility_range(emission: ModelOutputs) -> Iterator[Violation]:
    """The visibility of each cell (group of Gaussians), column 3, lies in [0, 1].

    Why:
        The weight of every Gaussian of the cell is multiplied by it: beyond 1 the cell outweighs
        cells in front of it, and below 0 it takes away from the sum.

    Hint:
        Apply the activation, usually a sigmoid, before packing.
    """
    if emission.cells is None:
        return
    visibility = emission.cells[:, VISIBILITY].astype(np.float64)
    in_range_mask = (visibility >= -_VISIBILITY_SLACK) & (visibility <= 1 + _VISIBILITY_SLACK)
    checked = _finite_mask(emission.cells)
    has_logits = bool((visibility > 1).any() and (~in_range_mask & checked).all())
    function = "sigmoid()" if has_logits else "clamp(0, 1)"
    violation = Violation.rows(
        Location(emission.cells_label, "visibility"),
        ~in_range_mask & checked,
        visibility,
        "0 <= visibility <= 1",
        checked=int(np.count_nonzero(checked)),
        magnitude=np.abs(visibility - 0.5),
    )
    yield replace(violation, hint=line_hint(f"rows[:, 3] = rows[:, 3].{function}"))


@rule("GV028", Severity.ERROR, needs=CELL_RULES, at_moments=True)
def cell_covariance_psd(emission: ModelOutputs) -> Iterator[Violation]:
    """The covariance of every visible cell (group of Gaussians) is positive semi-definite.

    Why:
        A renderer looks for a cell's Gaussians where its ellipsoid shows. An indefinite one
        shows nowhere, or everywhere.

    Hint:
        Build the covariance as R S Sᵀ Rᵀ with a normalised rotation, and check the order of the
        six entries: xx xy xz yy yz zz.
    """
    cells = emission.cells
    if cells is None:
        return
    checked = _finite_mask(cells) & (cells[:, VISIBILITY] > 0)
    upper = np.where(checked[:, None], cells[:, COVARIANCE], 0).astype(np.float64)
    slack, eigenvalue_floor = PSD_SLACK[cells.itemsize], PSD_FLOOR[cells.itemsize]
    min_eigenvalue = smallest_eigenvalue(upper)
    size = np.abs(upper[:, [0, 3, 5]]).sum(axis=1)
    yield Violation.rows(
        Location(emission.cells_label, "covariance"),
        checked & ~(min_eigenvalue >= -slack * size - eigenvalue_floor),
        min_eigenvalue,
        f"smallest eigenvalue >= -{slack:.2g} of the trace",
        checked=int(np.count_nonzero(checked)),
        magnitude=-min_eigenvalue,
        can_be_zeroed=True,
    )


@rule("GV029", Severity.WARNING, needs=(*CELL_RULES, "GO010", "GO011"))
def hidden_cells_inert(emission: ModelOutputs) -> Iterator[Violation]:
    """The Gaussians (rows) of a cell with visibility 0 have opacity 0.

    Why:
        Renderers without a weighted sum blend the rows by sorting, and know nothing of visibility:
        they show what the model hides, such as levels of detail that are too fine.

    Hint:
        Multiply opacities by the mask that hides the cell.
    """
    cells, rows = emission.cells, emission.gaussians
    if cells is None or rows is None:
        return
    is_hidden_row = np.repeat(cells[:, VISIBILITY] == 0, _rows_per_cell(emission))[: emission.count]
    opacity = rows[: emission.count, OPACITY].astype(np.float32)
    cells_name = emission.cells_label.removeprefix("output ")
    mask = f"({cells_name}[:, 3] > 0).repeat_interleave({_rows_per_cell(emission)})"
    violation = Violation.rows(
        Location(emission.rows_label, "opacity"),
        is_hidden_row & np.isfinite(opacity) & (opacity != 0),
        opacity,
        "opacity 0 in rows of cells with visibility 0",
        checked=int(np.count_nonzero(is_hidden_row)),
        magnitude=opacity,
    )
    hint = line_hint(f"rows[:, 3] = rows[:, 3] * {mask}[:{len(rows)}]")
    yield replace(violation, hint=f"Multiply opacities by the mask that hides the cell. {hint}")


@rule("GV030", Severity.ERROR, needs=(*CELL_RULES, "GO010", "GO011"), at_moments=True)
def empty_cells_inert(emission: ModelOutputs) -> Iterator[Violation]:
    """The visibility of every cell without a live Gaussian (a row before the row count) is 0.

    Why:
        Renderers sort all cells that are visible, and look for their Gaussians in every tile that
        they touch: an empty cell costs as much as a full one.

    Hint:
        Fill cells behind the count with zeros; the SDK does it for you.
    """
    if emission.cells is None:
        return
    visibility = emission.cells[:, VISIBILITY].astype(np.float32)
    empty_mask = ~_live_cells(emission)
    declared, per_cell = emission.subject.declared_count, _rows_per_cell(emission)
    first_rows = f"torch.arange({len(visibility)}) * {per_cell}"
    mask = f"({first_rows} < {declared.name})" if declared else ""
    violation = Violation.rows(
        Location(emission.cells_label, "visibility"),
        empty_mask & np.isfinite(visibility) & (visibility != 0),
        visibility,
        "visibility 0 in cells behind the count",
        checked=int(np.count_nonzero(empty_mask)),
        magnitude=visibility,
    )
    hint = line_hint(f"rows[:, 3] = rows[:, 3] * {mask}" if mask else "")
    yield replace(violation, hint=f"Fill cells behind the count with zeros. {hint}".strip())


@rule("GV031", Severity.WARNING, needs=CELL_RULES)
def rows_near_their_cell(emission: ModelOutputs) -> Iterator[Violation]:
    """Every drawn Gaussian's centre is within two sizes of its cell (group) from the cell's centre.

    Why:
        A renderer draws a cell's Gaussians only where the cell is, within twice its longest
        standard deviation: parts beyond that are cut off in straight lines. If many do, rows and
        cells probably stand in different orders.

    Hint:
        Row r belongs to cell r // per_cell: check the order of both, and that the covariance is
        that of the cell, in square units. The size is the square root of its trace.
    """
    cells, rows = emission.cells, emission.gaussians
    if cells is None or rows is None or emission.zeros:
        return
    float_cells, live = (cells.astype(np.float32), np.asarray(rows[: emission.count], np.float32))
    trace = np.maximum(float_cells[:, COVARIANCE][:, [0, 3, 5]].sum(axis=1), 0)
    size = _CELL_EXTENT_SIGMAS * np.sqrt(trace)
    if np.float16 in (cells.dtype, rows.dtype):
        size += FLOAT16_EPSILON * np.abs(float_cells[:, POSITION]).sum(axis=1)
    visible_mask = np.isfinite(float_cells).all(axis=1) & (float_cells[:, VISIBILITY] > 0)
    centre, cell_radius, visible_mask = (
        np.repeat(values, _rows_per_cell(emission), axis=0)[: len(live)]
        for values in (float_cells[:, POSITION], size, visible_mask)
    )
    drawn = visible_mask & np.isfinite(live).all(axis=1) & (live[:, OPACITY] >= CULL_OPACITY)
    center_distance = np.linalg.norm(live[:, POSITION] - centre, axis=1)
    yield Violation.rows(
        Location(emission.rows_label, "position"),
        drawn & ~(center_distance <= cell_radius),
        np.stack([center_distance, cell_radius], axis=1),
        "distances from the cell's centre of at most twice its size",
        checked=int(np.count_nonzero(drawn)),
        magnitude=center_distance - cell_radius,
    )
