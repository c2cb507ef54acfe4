"""Rules of packed rows (GV): finite values, opacity, saturation, row count and padding rows.

NaN fails every comparison. Rows that are not finite are reported by GV001 and GV002 alone, so
that one cause gives one finding.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gsgen.contract._array_types import Bool, Float
from gsgen.contract.model.graph import static_dims
from gsgen.contract.probing.outputs import ModelOutputs, Rows
from gsgen.contract.spec.layout import CULL_OPACITY, MOSTLY_INVISIBLE_SHARE, OPACITY, OPACITY_SLACK
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.units import FLOAT16_MAX
from gsgen.contract.validation.finding import Location, Violation, line_hint
from gsgen.contract.validation.gates import ORDERED_ROWS, PACKED_ROWS
from gsgen.contract.validation.rule import rule

_MAX_EXAMPLES = 8
_INF_BITS = {2: 0x7C00, 4: 0x7F800000}

# One unit in the last place of float16 below 1 is 2⁻¹¹; a sigmoid may round up by that much.


def _nonfinite_violations(
    rows: Rows, row_mask: Bool[np.ndarray, " n"], checked: int
) -> Iterator[Violation]:
    """Yield a violation for each output with NaN or infinity in the rows that ``row_mask`` selects."""
    if not checked:
        return
    is_non_finite_row = ~np.isfinite(rows.float32_columns).all(axis=0) & row_mask
    expected = "finite values"
    if (
        rows.packed.dtype == np.float16
        and np.isinf(rows.float32_columns[:, is_non_finite_row]).any()
    ):
        expected += f"; float16 overflows to infinity beyond {FLOAT16_MAX:g}: use float32 or metres"
    yield Violation.rows(
        Location(rows.emission.rows_label),
        is_non_finite_row,
        rows.packed,
        expected,
        checked=checked,
    )
    color = rows.color
    if color is None or not color.size:
        return
    invalid = (rows.color_peak >= _INF_BITS[color.itemsize]) & row_mask
    examples = np.zeros((len(rows), 1), color.dtype)
    first = np.flatnonzero(invalid)[:_MAX_EXAMPLES]  # the rows in the report
    is_non_finite = ~np.isfinite(color[first])
    examples[first] = np.take_along_axis(
        color[first], is_non_finite.argmax(axis=1)[:, None], axis=1
    )
    yield Violation.rows(
        Location(rows.emission.color_label), invalid, examples, "finite values", checked=checked
    )


@rule("GV001", Severity.ERROR, needs=PACKED_ROWS)
def rows_finite(rows: Rows) -> Iterator[Violation]:
    """Every value of every live row (before the row count) is finite.

    Why:
        NaN passes every cull test, since all comparisons with it are false: the Gaussian is drawn
        with a depth that sorts on top of everything.

    Hint:
        Find the division, logarithm or norm that sees zero, and clamp before it; to hide such rows
        meanwhile, end on `rows = torch.where((rows.abs() < 3e38).all(1, True), rows, 0)`. Where float16
        overflows, scale the scene or emit float32. The row and the probe are given.
    """
    yield from _nonfinite_violations(rows, rows.counted, rows.live_rows)


@rule("GV002", Severity.ERROR, needs=PACKED_ROWS)
def padding_finite(rows: Rows) -> Iterator[Violation]:
    """Every value of the padding rows (after the row count) is finite.

    Why:
        Some viewers draw all rows regardless of the count, and NaN is then drawn on top.

    Hint:
        Pad with constants, as `gsgen fix MODEL -o COPY` does, not with arithmetic on live rows: x − x
        is NaN where x is infinite.
    """
    yield from _nonfinite_violations(rows, ~rows.counted, len(rows) - rows.live_rows)


@rule("GV003", Severity.ERROR, needs=ORDERED_ROWS, at_moments=True)
def opacity_range(rows: Rows) -> Iterator[Violation]:
    """Opacity lies in [0, 1] in every live row (before the row count).

    Why:
        Blending multiplies by it unclamped: an opacity of 1.7 subtracts light behind it. Values
        below zero usually are logits whose sigmoid was forgotten.

    Hint:
        Apply the activation, usually a sigmoid, once and before packing; divide bytes by 255, and
        clamp what a network gives beyond 1.
    """
    opacity = rows.opacity
    in_range_mask = (opacity >= -OPACITY_SLACK) & (opacity <= 1 + OPACITY_SLACK)
    invalid = ~in_range_mask & rows.counted & rows.finite
    expected, cause = "0 <= opacity <= 1", None
    if invalid.any():
        from gsgen.contract.causes.activations import explain_opacity

        cause = explain_opacity(opacity[rows.counted & rows.finite])
    violation = Violation.rows(
        Location(rows.emission.rows_label, "opacity"),
        invalid,
        opacity,
        expected,
        checked=rows.live_rows,
        magnitude=np.abs(opacity - 0.5),
        cause=cause,
        can_be_zeroed=True,
    )
    clamp = line_hint("rows[:, 3] = rows[:, 3].clamp(0, 1)")
    general = (
        "Apply the activation, usually a sigmoid, once and before packing. "
        f"If a network gives such: {clamp}"
    )
    yield replace(violation, hint=violation.hint or general)


@rule("GV004", Severity.WARNING, needs=(*ORDERED_ROWS, "GV054"))
def mostly_visible(rows: Rows) -> Iterator[Violation]:
    """Most live Gaussians (rows before the row count) are opaque enough to change a pixel.

    Why:
        A Gaussian below 1/255 is never drawn, but it is decoded, uploaded and sorted every frame.
        If nearly all are, the activation is probably missing or applied twice.

    Hint:
        Check the opacity activation; prune dead Gaussians before export. If the model culls, check
        that +z is forward, and the matrix order.
    """
    invisible_rows = rows.counted & rows.finite & (rows.opacity < CULL_OPACITY)
    yield Violation.rows(
        Location(rows.emission.rows_label, "opacity"),
        invisible_rows,
        rows.opacity,
        f"at least 1/255 in more than {100 * (1 - MOSTLY_INVISIBLE_SHARE):.0f} % of live rows",
        checked=rows.live_rows,
        min_fraction=MOSTLY_INVISIBLE_SHARE,
    )


@rule("GV010", Severity.ERROR, needs=PACKED_ROWS, at_moments=True)
def float16_saturation(rows: Rows) -> Iterator[Violation]:
    """No float16 value is as large as the largest float16.

    Why:
        65504 means that the value was clamped on its way into float16: the true one is lost.

    Hint:
        Centre and scale the scene, or emit float32.
    """
    if rows.packed.dtype == np.float16:
        max_magnitude = np.abs(rows.float32_columns).max(axis=0, initial=0)
        yield _saturation_violation(rows, rows.emission.rows_label, max_magnitude)
    if rows.color is not None and rows.color.dtype == np.float16:
        max_magnitude = rows.color_peak.view(np.float16).astype(np.float32)
        yield _saturation_violation(rows, rows.emission.color_label, max_magnitude)


def _saturation_violation(
    rows: Rows, subject: str, max_magnitude: Float[np.ndarray, " n"]
) -> Violation:
    saturated_mask = (max_magnitude >= FLOAT16_MAX) & rows.counted & rows.finite
    expected = f"magnitudes below {FLOAT16_MAX:g}"
    return Violation.rows(
        Location(subject),
        saturated_mask,
        max_magnitude,
        expected,
        checked=rows.live_rows,
        can_be_zeroed=True,
    )


@rule("GV016", Severity.ERROR, needs=("GV025", "GO001", "GO002", "GO010", "GO011"))
def count_range(emission: ModelOutputs) -> Iterator[Violation]:
    """The row count lies between 0 and the number of packed rows, at every probe (test inputs).

    Why:
        A renderer that believes a count above the capacity reads beyond the buffer. A viewer takes
        9 of 5 rows as 5, and a count below 0 as 0.

    Hint:
        Clamp the count to the number of rows that are returned.
    """
    declared = emission.subject.declared_count
    capacity = 0 if emission.gaussians is None else len(emission.gaussians)
    if declared is None or emission.gaussians is None:
        return
    tensor = emission.subject.gaussians
    dims = static_dims(tensor) if tensor else None
    if dims is not None and dims[0] != capacity:
        return  # GV024 reports that the graph declares another shape
    value = emission.outputs[declared.name].reshape(-1)
    if value.size and not 0 <= int(value[0]) <= capacity:
        expected = f"0 to {capacity}, the capacity"
        line = line_hint(f"{declared.name} = {declared.name}.clamp(0, {capacity})")
        hint = line if value[0] > 0 else ""
        actual = f"count {int(value[0])}"
        yield Violation.at(f"output {declared.name}", actual, expected, hint=hint)


@rule("GV018", Severity.ERROR, needs=(*ORDERED_ROWS, "GV032"), at_moments=True)
def padding_inert(rows: Rows) -> Iterator[Violation]:
    """Opacity is 0 in every padding row (after the row count).

    Why:
        Some viewers ignore the count and draw all rows: a visible row there is seen.

    Hint:
        Move the live rows to the front, in both outputs, and fill rows behind the count with zeros,
        as the SDK and `gsgen fix MODEL -o COPY` do.
    """
    visible_padding = ~rows.counted & np.isfinite(rows.opacity) & (rows.opacity != 0)
    expected = "opacity 0 in rows behind the count"
    if visible_padding.any():
        expected += _diagnose_padding(rows.emission)
    yield Violation.rows(
        Location(rows.emission.rows_label, "opacity"),
        visible_padding,
        rows.opacity,
        expected,
        checked=len(rows) - rows.live_rows,
        magnitude=rows.opacity,
    )


def _diagnose_padding(emission: ModelOutputs) -> str:
    """Return the likely cause of visible padding rows, for a message; empty if unclear."""
    if emission.gaussians is None:
        return ""
    visible_mask = emission.gaussians[:, OPACITY] != 0
    if not visible_mask[: emission.count].all():
        return (
            f"; of the {emission.count} rows before it {np.count_nonzero(visible_mask[: emission.count])}"
            " are visible: live rows do not stand first, sort them to the front"
        )
    return ""
