"""GV: the numbers that a model emits are Gaussians.

Comparisons are written so that NaN fails them; rows that are not finite belong to GV001 and
GV002 alone, so that one cause makes one finding.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float

from gsgen.contract.behaviour import Trial
from gsgen.contract.candidate import static_dims
from gsgen.contract.emission import Emission, Rows, peak_bits
from gsgen.contract.finding import Breach, Severity, Where
from gsgen.contract.geometry import smallest_eigenvalue
from gsgen.contract.layout import CULL_OPACITY
from gsgen.contract.roles import KINDS
from gsgen.contract.rule import rule
from gsgen.contract.subject import Subject

_LARGEST_HALF = 65504.0
_LARGEST_HALF_BITS = 0x7BFF
_INF_BITS = {2: 0x7C00, 4: 0x7F800000}

# One unit in the last place of float16 below 1 is 2⁻¹¹; a sigmoid may round up by that much.
_OPACITY_SLACK = 1e-3
_MOSTLY_DEAD = 0.9
# How negative an eigenvalue may be by rounding alone: relative to the trace, and, because the
# smallest float16 numbers are 2⁻²⁴ apart, for three entries a row that are off by half of that.
_PSD_SLACK = {2: 2.0**-10, 4: 1e-5}
_PSD_FLOOR = {2: 3 * 2.0**-25, 4: 0.0}
# What rounding may do to a determinant in float32, relative to its largest terms, and the size
# below which terms lose bits.
_DET_DOUBT = np.float32(2e-6)
_DET_FLOOR = np.float32(1e-30)
_COLOR_SLACK = 1e-2

_ROWS = ("GV025", "GO001", "GO002", "GO008")
_COLOR = (*_ROWS, "GO005", "GO006", "GO007")


def _subject(rows: Rows) -> str:
    declared = rows.emission.subject.declared_gaussians
    return f"output {declared.name if declared else '?'}"


def _color_subject(rows: Rows) -> str:
    declared = rows.emission.declared
    return f"output {declared.name if declared else '?'}"


def _not_finite(rows: Rows, among: Bool[np.ndarray, " n"], judged: int) -> Iterator[Breach]:
    """Report rows of ``among`` with a value that is NaN or infinite, output by output."""
    if not judged:
        return
    packed = ~np.isfinite(rows.wide).all(axis=0) & among
    yield Breach.rows(
        Where(_subject(rows)), packed, rows.packed, "finite values", judged=judged
    )
    color = rows.color
    if color is None:
        return
    bad, shown = np.zeros(len(rows), bool), color[:, :1]
    if peak_bits(color) >= _INF_BITS[color.itemsize]:
        broken = ~np.isfinite(color)
        bad = broken.any(axis=1) & among
        shown = np.take_along_axis(color, broken.argmax(axis=1)[:, None], axis=1)
    yield Breach.rows(
        Where(_color_subject(rows)), bad, shown, "finite values", judged=judged
    )


@rule("GV001", "rows-finite", Severity.ERROR, over="rows", fixture="nan_row", needs=_ROWS)
def rows_finite(rows: Rows) -> Iterator[Breach]:
    """Every value of every live row is finite.

    Why:
        NaN passes every cull test, since all comparisons with it are false: the Gaussian is drawn
        with a depth that sorts on top of everything.

    Mend:
        Find the division, logarithm or norm that sees zero, and clamp before it. The row and the
        probe are given.
    """
    if not rows.emission.zeros:
        yield from _not_finite(rows, rows.counted, rows.live_rows)


@rule(
    "GV002",
    "padding-finite",
    Severity.ERROR,
    over="rows",
    fixture="nan_padding",
    needs=_ROWS,
)
def padding_finite(rows: Rows) -> Iterator[Breach]:
    """Every value of the rows behind the count is finite.

    Why:
        Some viewers draw all rows whatever the count says, and NaN is then drawn on top.

    Mend:
        Pad with constants, not with arithmetic on live rows: x − x is NaN where x is infinite.
    """
    if not rows.emission.zeros:
        yield from _not_finite(rows, ~rows.counted, len(rows) - rows.live_rows)


@rule(
    "GV003",
    "opacity-range",
    Severity.ERROR,
    over="rows",
    fixture="opacity_is_logits",
    needs=_ROWS,
)
def opacity_range(rows: Rows) -> Iterator[Breach]:
    """Opacity lies in [0, 1] in every live row.

    Why:
        Blending multiplies by it unclamped: an opacity of 1.7 subtracts light behind it. Values
        below zero usually are logits whose sigmoid was forgotten.

    Mend:
        Apply the activation, usually a sigmoid, before packing.
    """
    opacity = rows.opacity
    kept = (opacity >= -_OPACITY_SLACK) & (opacity <= 1 + _OPACITY_SLACK)
    bad = ~kept & rows.counted & rows.finite
    yield Breach.rows(
        Where(_subject(rows), "opacity"),
        bad,
        opacity,
        "0 <= opacity <= 1",
        judged=rows.live_rows,
        badness=np.abs(opacity - 0.5),
    )


@rule(
    "GV004",
    "mostly-visible",
    Severity.WARNING,
    over="rows",
    fixture="all_transparent",
    needs=_ROWS,
)
def mostly_visible(rows: Rows) -> Iterator[Breach]:
    """Most live rows are opaque enough to change a pixel.

    Why:
        A Gaussian below 1/255 is never drawn, but it is decoded, uploaded and sorted every frame.
        If nearly all are, the activation is probably missing or applied twice.

    Mend:
        Check the opacity activation; prune dead Gaussians before export.
    """
    dead = rows.counted & rows.finite & (rows.opacity < CULL_OPACITY)
    yield Breach.rows(
        Where(_subject(rows), "opacity"),
        dead,
        rows.opacity,
        f"at least 1/255 in more than {100 * (1 - _MOSTLY_DEAD):.0f} % of live rows",
        judged=rows.live_rows,
        above_share=_MOSTLY_DEAD,
    )


@rule(
    "GV005",
    "variance-not-negative",
    Severity.ERROR,
    over="rows",
    fixture="negative_variance",
    needs=_ROWS,
)
def variance_not_negative(rows: Rows) -> Iterator[Breach]:
    """The variances xx, yy and zz are not negative in any drawn row.

    Why:
        A negative variance has no axes: the projected ellipse is NaN or covers the screen.

    Mend:
        Build the covariance as R S Sᵀ Rᵀ, and check the order of the six entries: xx xy xz yy yz zz.
    """
    lowest = rows.covariance[[0, 3, 5]].min(axis=0)
    yield Breach.rows(
        Where(_subject(rows), "covariance"),
        rows.drawn & ~(lowest >= 0),
        lowest,
        "xx, yy, zz >= 0",
        judged=rows.drawn_count,
        badness=-lowest,
    )


@rule(
    "GV006",
    "covariance-psd",
    Severity.ERROR,
    over="rows",
    fixture="indefinite_covariance",
    needs=_ROWS,
)
def covariance_psd(rows: Rows) -> Iterator[Breach]:
    """The covariance of every drawn row is positive semi-definite, up to rounding.

    Why:
        A renderer clamps the smaller eigenvalue of the projected ellipse, which hides the fault
        until the other axis is hundreds of pixels long: a spike.

    Mend:
        Build the covariance as R S Sᵀ Rᵀ with a normalised rotation; in float16, scale the scene
        so that variances do not underflow.
    """
    slack, floor = _PSD_SLACK[rows.packed.itemsize], _PSD_FLOOR[rows.packed.itemsize]
    suspects = np.flatnonzero(rows.drawn & ~_surely_psd(rows, slack))
    bad = np.zeros(len(rows), bool)
    lowest = np.zeros(len(rows))
    if len(suspects):
        upper = rows.covariance[:, suspects].T.astype(np.float64)
        diagonal = upper[:, [0, 3, 5]]
        smallest = smallest_eigenvalue(upper)
        lowest[suspects] = smallest
        broken = ~(smallest >= -slack * np.abs(diagonal).sum(axis=1) - floor)
        bad[suspects] = broken & (diagonal >= 0).all(axis=1)  # negative ones are GV005's
    yield Breach.rows(
        Where(_subject(rows), "covariance"),
        bad,
        lowest,
        f"smallest eigenvalue >= -{slack:.2g} of the trace",
        judged=rows.drawn_count,
        badness=-lowest,
    )


def _surely_psd(rows: Rows, slack: float) -> Bool[np.ndarray, " n"]:
    """Sylvester's criterion on Σ + slack·tr(Σ)·I in float32: true only if well inside."""
    xx, xy, xz, yy, yz, zz = rows.covariance
    lift = np.float32(slack) * rows.trace
    a, b, c = xx + lift, yy + lift, zz + lift
    minor = a * b - xy * xy
    taken = a * yz * yz + b * xz * xz
    det = c * minor - taken + 2 * xy * xz * yz
    doubt = np.maximum(_DET_DOUBT * (a * b * c + taken), _DET_FLOOR)
    return np.asarray((a > 0) & (minor > 0) & (det > doubt))


@rule(
    "GV007",
    "covariance-not-zero",
    Severity.WARNING,
    over="rows",
    fixture="zero_covariance",
    needs=_ROWS,
)
def covariance_not_zero(rows: Rows) -> Iterator[Breach]:
    """The covariance of a drawn row is not all zero.

    Why:
        The Gaussian has no extent of its own and shows only as the renderer's low-pass filter. A
        zero quaternion, or float16 underflow of a variance below 6e-8, gives such rows.

    Mend:
        Normalise rotations safely; scale the scene up before float16.
    """
    yield Breach.rows(
        Where(_subject(rows), "covariance"),
        rows.drawn & (rows.trace == 0) & (rows.covariance == 0).all(axis=0),
        rows.trace,
        "a trace above 0",
        judged=rows.drawn_count,
    )


@rule(
    "GV010",
    "float16-saturation",
    Severity.ERROR,
    over="rows",
    fixture="saturated_half",
    needs=_ROWS,
)
def float16_saturation(rows: Rows) -> Iterator[Breach]:
    """No float16 value is as large as float16 can be.

    Why:
        65504 means that the value was clamped on its way into float16: the true one is lost.

    Mend:
        Centre and scale the scene, or emit float32.
    """
    if rows.packed.dtype == np.float16:
        peak = np.abs(rows.wide).max(axis=0, initial=0)
        yield _saturated(rows, _subject(rows), peak)
    if rows.color is not None and rows.color.dtype == np.float16:
        peak = np.zeros(len(rows), np.float32)
        if peak_bits(rows.color) >= _LARGEST_HALF_BITS:
            peak = np.abs(rows.color.astype(np.float32)).max(axis=1)
        yield _saturated(rows, _color_subject(rows), peak)


def _saturated(rows: Rows, subject: str, peak: Float[np.ndarray, " n"]) -> Breach:
    bad = (peak >= _LARGEST_HALF) & rows.counted & rows.finite
    want = f"magnitudes below {_LARGEST_HALF:g}"
    return Breach.rows(Where(subject), bad, peak, want, judged=rows.live_rows)


@rule(
    "GV012",
    "rgb-range",
    Severity.WARNING,
    over="rows",
    fixture="rgb_in_bytes",
    needs=_COLOR,
)
def rgb_range(rows: Rows) -> Iterator[Breach]:
    """Raw RGB lies in [0, 1] in every drawn row.

    Why:
        Values up to 255 are bytes that were not divided, and show as white. Values around zero
        are SH coefficients passed as colours, and show as black.

    Mend:
        Divide bytes by 255; turn the SH constant term into colour as 0.5 + 0.28209479 · f_dc.
    """
    declared, color = rows.emission.declared, rows.color
    if declared is None or declared.space != "rgb" or color is None:
        return
    shown = color[:, :3].astype(np.float32)
    kept = ((shown >= -_COLOR_SLACK) & (shown <= 1 + _COLOR_SLACK)).all(axis=1)
    yield Breach.rows(
        Where(_color_subject(rows), "rgb"),
        rows.drawn & ~kept,
        shown,
        "0 <= rgb <= 1",
        judged=rows.drawn_count,
        badness=np.nan_to_num(np.abs(shown - 0.5).max(axis=1)),
    )


@rule(
    "GV016",
    "count-range",
    Severity.ERROR,
    over="emission",
    fixture="count_above_capacity",
    needs=("GV025", "GO001", "GO002", "GO010", "GO011"),
)
def count_range(emission: Emission) -> Iterator[Breach]:
    """The row count lies between 0 and the capacity, at every probe.

    Why:
        A renderer that believes a count above the capacity reads beyond the buffer.

    Mend:
        Clamp the count to the number of rows that are returned.
    """
    declared = emission.subject.declared_count
    capacity = 0 if emission.gaussians is None else len(emission.gaussians)
    if declared is None or emission.gaussians is None:
        return
    value = emission.outputs[declared.name].reshape(-1)
    if value.size and not 0 <= int(value[0]) <= capacity:
        want = f"0 to {capacity}, the capacity"
        yield Breach.at(f"output {declared.name}", f"count {int(value[0])}", want)


@rule(
    "GV018",
    "padding-inert",
    Severity.ERROR,
    over="rows",
    fixture="opaque_padding",
    needs=_ROWS,
)
def padding_inert(rows: Rows) -> Iterator[Breach]:
    """Opacity is 0 in every row behind the count.

    Why:
        Some viewers ignore the count and draw all rows: whatever stands there is seen.

    Mend:
        Fill rows behind the count with zeros; the SDK pads so.
    """
    yield Breach.rows(
        Where(_subject(rows), "opacity"),
        ~rows.counted & np.isfinite(rows.opacity) & (rows.opacity != 0),
        rows.opacity,
        "opacity 0 in rows behind the count",
        judged=len(rows) - rows.live_rows,
        badness=rows.opacity,
    )


@rule(
    "GV024",
    "shapes-as-declared",
    Severity.ERROR,
    over="emission",
    fixture="shape_differs_at_run",
    needs=("GV025",),
)
def shapes_as_declared(emission: Emission) -> Iterator[Breach]:
    """At run time every output has the shape and dtype that the graph declares.

    Why:
        ONNX Runtime only logs a warning where they differ, and readers have sized their buffers by
        the declaration.

    Mend:
        Declare what the operators compute, or give data-dependent outputs a fixed capacity.
    """
    subject: Subject = emission.subject
    for tensor in subject.graph.outputs:
        value = emission.outputs.get(tensor.name)
        if value is None or tensor.dims is None:
            continue
        dims = static_dims(tensor)
        wrong_shape = dims is not None and tuple(dims) != value.shape
        if wrong_shape or (
            tensor.dtype in ("float32", "float16") and tensor.dtype != value.dtype
        ):
            saw = f"{value.dtype} {list(value.shape)}"
            yield Breach.at(f"output {tensor.name}", saw, f"{tensor}, as declared")


@rule(
    "GV025",
    "model-runs",
    Severity.ERROR,
    over="execution",
    fixture="fails_at_run",
    kinds=KINDS,
    needs=(
        "GM002",
        "GM003",
        "GM004",
        "GI001",
        "GI002",
        "GI003",
        "GI004",
        "GI005",
        "GG001",
        "GG002",
        "GG019",
        "GS001",
        "GS002",
        "GS004",
    ),
)
def model_runs(trial: Trial) -> Iterator[Breach]:
    """ONNX Runtime loads the model and runs it at every probe.

    Why:
        What does not run here, on the CPU with the reference kernels, runs nowhere.

    Mend:
        The message is ONNX Runtime's own; the probe's inputs are what it was given.
    """
    fault = trial.execution.fault
    if fault is not None and fault.stage not in ("time", "memory"):
        probe = (
            ""
            if fault.probe is None
            else f" at probe {trial.plan.probes[fault.probe].label!r}"
        )
        saw = f"{fault.stage}{probe}: {fault.message}"
        yield Breach.at("ONNX Runtime", saw, "no error")
