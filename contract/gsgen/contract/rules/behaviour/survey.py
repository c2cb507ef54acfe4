"""Rules of views and frames (GB): outputs are valid for cameras all around, in every frame."""

from collections.abc import Iterator

from gsgen.contract.probing.run_comparison import Behaviour, ProbeRun
from gsgen.contract.probing.sandbox import Extremes
from gsgen.contract.spec.layout import OPACITY, OPACITY_SLACK, VARIANCES
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Location, Violation
from gsgen.contract.validation.gates import FINITE_OUTPUTS, ORDERED_ROWS, REPRODUCIBLE
from gsgen.contract.validation.rule import rule

# Rounding of a variance that is zero, relative to the largest one.
_VARIANCE_SLACK = 1e-5


def _surveyed_runs(behaviour: Behaviour) -> list[ProbeRun]:
    return [*behaviour.trial_runs("survey"), *behaviour.trial_runs("frames")]


@rule("GB043", Severity.ERROR, needs=(*REPRODUCIBLE, *FINITE_OUTPUTS, "GB013"))
def views_and_frames_finite(behaviour: Behaviour) -> Iterator[Violation]:
    """Every output is finite for cameras inside, far away and on all sides, and in every frame.

    Why:
        People fly through scenes: a camera in a Gaussian's centre makes a direction of length zero.
        One broken frame of a motion flashes once in every loop.

    Hint:
        Guard the division by the distance to the camera, such as max(distance, 1e-8). If a frame is
        named, look at its part of the table, or at the floor and the clamp of its index.
    """
    runs = _surveyed_runs(behaviour)
    failed_runs = [run for run in runs if run.error or run.not_finite]
    if failed_runs:
        first = failed_runs[0]
        where = f"output {first.not_finite[0]}" if first.not_finite else "ONNX Runtime"
        problem = "not finite" if first.not_finite else first.error
        share = f"{len(failed_runs)} of {len(runs)} views and frames"
        actual = f"{problem} at {first.probe.label!r}, {share}"
        yield Violation.at(where, actual, "finite values everywhere")


@rule(
    "GB044",
    Severity.ERROR,
    needs=(*REPRODUCIBLE, *ORDERED_ROWS, "GV003", "GV005", "GV016", "GB043"),
)
def views_and_frames_in_range(behaviour: Behaviour) -> Iterator[Violation]:
    """Row count, opacity and variances are in range for cameras all around and in every frame.

    Why:
        Probes of the level values lie on one line through the inputs. People stand inside the
        scene, put several sliders to their ends, and play every frame.

    Hint:
        Apply the activations after all other terms are added, and clamp the count to the capacity.
    """
    declared, counted = behaviour.subject.declared_gaussians, behaviour.subject.declared_count
    if declared is None:
        return
    runs = [(run, run.extremes) for run in _surveyed_runs(behaviour) if run.extremes is not None]
    places = {
        "count": Location(f"output {counted.name if counted else '?'}"),
        "opacity": Location(f"output {declared.name}", "opacity"),
        "covariance": Location(f"output {declared.name}", "covariance"),
    }
    expected = {
        "count": "0 <= count <= capacity",
        "opacity": "0 <= opacity <= 1",
        "covariance": "xx, yy, zz >= 0",
    }
    for field, where in places.items():
        faulty_runs = [
            (run, text) for run, extremes in runs if (text := _out_of_range_text(field, extremes))
        ]
        if faulty_runs:
            run, text = faulty_runs[0]
            actual = (
                f"{text} at {run.probe.label!r}, {len(faulty_runs)} of {len(runs)} views and frames"
            )
            yield Violation(where=where, expected=expected[field], actual=actual)


def _out_of_range_text(field: str, extremes: Extremes) -> str:
    """Return an out-of-range row count, opacity or variance as text; empty if all are in range."""
    if field == "count":
        return "" if 0 <= extremes.count <= extremes.capacity else f"{extremes.count}"
    if not extremes.low:
        return ""
    if field == "opacity":
        low, high = extremes.low[OPACITY], extremes.high[OPACITY]
        if high > 1 + OPACITY_SLACK:
            return f"{high:.4g}"
        return f"{low:.4g}" if low < -OPACITY_SLACK else ""
    min_variance = min(extremes.low[k] for k in VARIANCES)
    largest = max(extremes.high[k] for k in VARIANCES)
    return f"{min_variance:.4g}" if min_variance < -_VARIANCE_SLACK * largest else ""
