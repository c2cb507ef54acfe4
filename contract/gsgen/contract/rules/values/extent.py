"""Rules of extent (GV): column order, size and position of Gaussians, float16 resolution."""

from collections.abc import Iterator

import numpy as np

from gsgen.contract.probing.outputs import ModelOutputs, Rows, chunks, read_outputs
from gsgen.contract.probing.run_comparison import ProbeRuns
from gsgen.contract.spec.layout import CULL_OPACITY, FIELDS, OPACITY
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.units import FLOAT16_EPSILON, FLOAT16_MAX, FLOAT16_SMALLEST_NORMAL
from gsgen.contract.validation.finding import Location, Violation, set_hint
from gsgen.contract.validation.gates import ORDERED_ROWS, PACKED_ROWS
from gsgen.contract.validation.rule import rule

# In float32, so that arrays of rows stay float32.
_SMALLEST_NORMAL = np.float32(FLOAT16_SMALLEST_NORMAL)
_FLOAT16_EPSILON = np.float32(FLOAT16_EPSILON)
_MIN_COARSE_SHARE = 0.01
_OUTSIDE_SHARE = 1e-3
_OUTSIDE_SLACK = 1e-3
# Below this number of rows, a Gaussian may fill its bounds or repeat by design.
_MIN_ROWS = 16
_ROWS_PER_BLOCK = 4096
_MAX_EQUAL_SHARE = 0.1
# Bounds over all inputs are larger than what some runs show, but not by so much.
_MAX_BOUNDS_RATIO = 100.0


@rule("GO016", Severity.ERROR, needs=PACKED_ROWS, at_moments=True)
def fields_in_order(emission: ModelOutputs) -> Iterator[Violation]:
    """The columns of a packed row are x y z opacity xx xy xz yy yz zz, in this order.

    Why:
        The contract fixes the order, and readers take it by position. With another one opacities
        and covariances are invalid, and Gaussians become spikes. Rules of values are not applied
        to such rows, since they would name consequences.

    Hint:
        Reorder the columns before packing; build the covariance as R S Sᵀ Rᵀ of scales and
        quaternion; transpose planes before they are reshaped. The SDK packs for you.
    """
    order = emission.explanation
    if order is not None and order.kind == "order":
        actual = (
            f"{100 * order.declared:.3g} % of {order.rows} rows are no valid Gaussian, "
            f"{100 * order.fraction:.3g} % if read as {order.name}"
        )
        yield Violation.at(emission.rows_label, actual, " ".join(FIELDS), hint=order.hint)


@rule("GV008", Severity.WARNING, needs=ORDERED_ROWS, limit="subnormal_permille")
def variance_not_subnormal(rows: Rows) -> Iterator[Violation]:
    """Float16 variances are not so small that shaders may flush them to zero.

    Why:
        WGSL lets a device flush numbers below 2⁻¹⁴ to zero. A Gaussian whose largest variance is
        below that, a standard deviation of 0.0078, then has no extent at all.

    Hint:
        Scale the scene up before float16, or emit float32.
    """
    if rows.packed.dtype != np.float16:
        return
    yield Violation.rows(
        Location(rows.emission.rows_label, "covariance"),
        rows.drawn & (rows.max_variance > 0) & (rows.max_variance < _SMALLEST_NORMAL),
        rows.max_variance,
        f"a largest variance of {_SMALLEST_NORMAL:.2g} or more in most rows",
        checked=rows.drawn_count,
        min_fraction=rows.emission.subject.target.limits["subnormal_permille"] / 1000,
    )


@rule("GV009", Severity.WARNING, needs=ORDERED_ROWS)
def position_resolution(rows: Rows) -> Iterator[Violation]:
    """The spacing of float numbers at a Gaussian's position does not exceed the Gaussian's size.

    Why:
        Float16 has steps of 0.0078 at 8 and of 0.5 at 512, float32 of 0.5 at 5,000,000, where UTM
        coordinates lie. Where a step is larger than a Gaussian's
        largest standard deviation, surfaces break into a grid, and motion jumps.

    Hint:
        Centre the scene, emit float32 for float16, or split it into tiles with origins of their own.
    """
    if rows.emission.zeros:
        return  # a frame of zeroed inputs only has to be finite
    is_half = rows.packed.dtype == np.float16
    epsilon = _FLOAT16_EPSILON if is_half else np.finfo(np.float32).eps
    # With NaN, all rows are checked.
    step_bound = np.square(np.abs(rows.corners).max(initial=0) * epsilon)
    max_coordinate, coarse_mask = np.zeros(len(rows), np.float32), np.zeros(len(rows), bool)
    small_rows = np.flatnonzero(
        rows.drawn & (rows.max_variance > 0) & ~(rows.max_variance >= step_bound)
    )
    if len(small_rows):
        max_position = np.abs(rows.position[:, small_rows]).max(axis=0)
        exponent = np.floor(np.log2(np.maximum(max_position, _SMALLEST_NORMAL)))
        is_step_above_sigma = np.square(np.exp2(exponent) * epsilon) > rows.max_variance[small_rows]
        coarse_mask[small_rows] = is_step_above_sigma & (
            (max_position < FLOAT16_MAX) | (not is_half)
        )
        max_coordinate[small_rows] = max_position
    yield Violation.rows(
        Location(rows.emission.rows_label, "position"),
        coarse_mask,
        rows.packed[:, :3],
        "steps below the largest standard deviation",
        checked=rows.drawn_count,
        magnitude=max_coordinate,
        min_fraction=_MIN_COARSE_SHARE,
    )


@rule("GV011", Severity.WARNING, needs=(*ORDERED_ROWS, "GM009", "GM019"))
def size_within_bounds(rows: Rows) -> Iterator[Violation]:
    """No Gaussian's standard deviation exceeds the diagonal of the bounds.

    Why:
        One such Gaussian covers the picture from everywhere, and costs as much as all others. It
        usually is a scale that was not activated, or diverged in training.

    Hint:
        Apply the activation (usually exp) once; clamp scales; prune outliers.
    """
    generator = rows.emission.subject.generator
    if generator is None or generator.bounds is None or rows.emission.count < _MIN_ROWS:
        return
    low, high = np.asarray([generator.bounds.min, generator.bounds.max])
    diagonal = float(np.linalg.norm(high - low))
    yield Violation.rows(
        Location(rows.emission.rows_label, "covariance"),
        rows.drawn & (rows.max_variance > diagonal**2),
        rows.max_variance,
        f"variances up to {diagonal**2:.4g}, the squared diagonal of the bounds",
        checked=rows.drawn_count,
        magnitude=rows.max_variance,
        can_be_zeroed=True,
    )


@rule("GV021", Severity.ERROR, needs=(*ORDERED_ROWS, "GM009", "GM019", "GV059"))
def centres_within_bounds(rows: Rows) -> Iterator[Violation]:
    """The declared bounds contain the centres of 99.9 % of the drawn rows, for all test inputs.

    Why:
        Viewers frame the camera, cull the whole model and choose near and far planes by the bounds:
        Gaussians outside are cut off, or seen from inside.

    Hint:
        Measure bounds over all times and poses; the SDK does. If a few Gaussians fly off, clamp
        them.
    """
    generator = rows.emission.subject.generator
    if generator is None or generator.bounds is None:
        return
    low, high = np.asarray([generator.bounds.min, generator.bounds.max], np.float64)
    slack = _OUTSIDE_SLACK * float(np.linalg.norm(high - low))
    if rows.packed.dtype == np.float16:
        slack += float(_FLOAT16_EPSILON * max(np.abs(low).max(), np.abs(high).max()))
    position, (lower_corner, upper_corner) = rows.position, rows.corners
    is_outside = np.zeros(len(rows), bool)
    if not ((lower_corner >= low - slack) & (upper_corner <= high + slack)).all():
        inside_mask = (position >= (low - slack)[:, None]) & (position <= (high + slack)[:, None])
        is_outside = rows.drawn & ~inside_mask.all(axis=0)
        if rows.packed.dtype == np.float16:  # GV010 reports saturated rows
            is_outside &= ~(np.abs(position).max(axis=0) >= FLOAT16_MAX)
    yield Violation.rows(
        Location(rows.emission.rows_label, "position"),
        is_outside,
        rows.packed[:, :3],
        f"centres within {generator.bounds.min} to {generator.bounds.max}",
        checked=rows.drawn_count,
        min_fraction=_OUTSIDE_SHARE,
    )


@rule("GV020", Severity.WARNING, needs=PACKED_ROWS)
def rows_differ(emission: ModelOutputs) -> Iterator[Violation]:
    """Drawn Gaussians (rows) are not copies of each other.

    Why:
        Copies are sorted and blended one over the other: they cost as much as other rows, and only
        make the first more opaque.

    Hint:
        Drop the copies, and raise the opacity of the remaining rows.
    """
    if emission.gaussians is None or emission.zeros:
        return
    block = emission.gaussians[: min(emission.count, _ROWS_PER_BLOCK)]
    block = np.ascontiguousarray(block[block[:, OPACITY].astype(np.float32) >= CULL_OPACITY])
    if len(block) < _MIN_ROWS:
        return
    distinct_count = len({row.tobytes() for row in block})
    copy_count = len(block) - distinct_count
    if copy_count > _MAX_EQUAL_SHARE * len(block):
        actual = f"{copy_count} of the first {len(block)} drawn rows equal another"
        yield Violation.at(emission.rows_label, actual, f"{100 * _MAX_EQUAL_SHARE:g} % at most")


@rule("GV065", Severity.WARNING, needs=(*PACKED_ROWS, "GM009", "GM019"))
def bounds_fit_content(probe_runs: ProbeRuns) -> Iterator[Violation]:
    """The diagonal of the bounds is at most a hundred times that of the Gaussians of all runs.

    Why:
        Viewers place the camera and their near and far planes by the bounds: in a box of another
        scale, or of a few stray rows, the scene is a dot.

    Hint:
        Measure the bounds over all times and poses; the SDK does. Prune stray Gaussians.
    """
    generator, declared = probe_runs.subject.generator, probe_runs.subject.declared_gaussians
    if generator is None or generator.bounds is None or declared is None:
        return
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for index in {run.sample for run in probe_runs.execution.runs[: probe_runs.plan.values]}:
        emission = read_outputs(probe_runs.subject, "", probe_runs.execution.samples[index].outputs)
        for rows in chunks(emission):
            # A Gaussian takes up room beside its centre.
            size = 2 * np.sqrt(np.maximum(rows.max_variance[rows.drawn], 0))
            position = rows.position[:, rows.drawn]
            low = np.minimum(low, (position - size).min(axis=1, initial=np.inf))
            high = np.maximum(high, (position + size).max(axis=1, initial=-np.inf))
    content = float(np.linalg.norm(np.maximum(high - low, 0)))
    diagonal = float(np.linalg.norm(np.subtract(generator.bounds.max, generator.bounds.min)))
    if 0 < content < np.inf and diagonal > _MAX_BOUNDS_RATIO * content:
        actual = f"a diagonal of {diagonal:.4g}, {diagonal / content:.3g} times the Gaussians'"
        expected = f"at most {_MAX_BOUNDS_RATIO:g} times their {content:.4g}"
        # Rounded outwards to four digits behind the first one of the content's size.
        digits = 4 - int(np.floor(np.log10(content)))
        ends = np.floor(low * 10.0**digits), np.ceil(high * 10.0**digits)
        corners = {
            name: (end / 10.0**digits).tolist()
            for name, end in zip(("min", "max"), ends, strict=True)
        }
        yield Violation.at("manifest bounds", actual, expected, hint=set_hint("bounds", corners))
