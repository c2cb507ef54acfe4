"""Rules of named moments (GB): each single run is valid where people look first, and in every frame."""

from collections.abc import Iterator

from gsgen.contract.probing.run_comparison import Behaviour
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.gates import AT_MOMENTS, FINITE_OUTPUTS, ORDERED_ROWS, REPRODUCIBLE
from gsgen.contract.validation.rule import rule

# What divides by zero in models that read pictures, in place of a distance to the camera.
_PICTURE_HINT = (
    "Find the division, logarithm or norm that sees a black pixel or a picture of one colour, and "
    "clamp before it."
)


@rule(
    "GB043", Severity.ERROR, needs=(*REPRODUCIBLE, *FINITE_OUTPUTS, "GB013"), kinds=MANIFEST_KINDS
)
def views_and_frames_finite(behaviour: Behaviour) -> Iterator[Violation]:
    """Every output is finite at every named moment: defaults, frames, cameras all around, pictures.

    Why:
        People fly through scenes: a camera in a Gaussian's centre makes a direction of length zero.
        One broken frame of a motion flashes once in every loop.

    Hint:
        Guard the division by the distance to the camera, such as max(distance, 1e-8), or look at the
        named frame's part of the table. To hide such rows meanwhile, end on
        `rows = torch.where((rows.abs() < 3e38).all(1, True), rows, 0)`.
    """
    runs = behaviour.moments
    failed_runs = [run for run in runs if run.error or run.not_finite]
    if failed_runs:
        first = failed_runs[0]
        where = f"output {first.not_finite[0]}" if first.not_finite else "ONNX Runtime"
        problem = "not finite" if first.not_finite else first.error
        share = f"{len(failed_runs)} of {len(runs)} named moments"
        actual = f"{problem} at {first.probe.label!r}, {share}"
        hint = _PICTURE_HINT if behaviour.subject.inputs_of("image") else ""
        yield Violation.at(where, actual, "finite values everywhere", hint=hint)


@rule(
    AT_MOMENTS,
    Severity.ERROR,
    needs=(*REPRODUCIBLE, *ORDERED_ROWS, "GV003", "GV005", "GV016", "GB043"),
    kinds=MANIFEST_KINDS,
)
def views_and_frames_in_range(behaviour: Behaviour) -> Iterator[Violation]:
    """Row count, rows, padding and pictures are valid at every named moment, as in the first runs.

    Why:
        Probes of the level values lie on one line through the inputs. People stand inside the
        scene, put several sliders to their ends, and play every frame.

    Hint:
        Apply the activations after all other terms are added, and clamp the count to the capacity.
    """
    # The engine checks the rules of rows and pictures at these moments as well.
    counted = behaviour.subject.declared_count
    runs = [(run, run.row_count) for run in behaviour.moments if run.row_count is not None]
    faulty_runs = [(run, rows) for run, rows in runs if not 0 <= rows.count <= rows.capacity]
    if counted is not None and faulty_runs:
        run, rows = faulty_runs[0]
        share = f"{len(faulty_runs)} of {len(runs)} named moments"
        actual = f"{rows.count} at {run.probe.label!r}, {share}"
        yield Violation.at(f"output {counted.name}", actual, f"0 to {rows.capacity}, the capacity")
