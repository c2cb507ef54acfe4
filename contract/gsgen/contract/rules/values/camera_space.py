"""Validation rules of camera conventions: positions in local space, camera along +z."""

from collections.abc import Iterator

import numpy as np

from gsgen.contract.probing.run_comparison import ProbeRuns, isolated_views, read_seen_rows
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.gates import MODEL_RUNS, NOT_RANDOM
from gsgen.contract.validation.rule import rule

# Culling is backwards if this fraction of the rows that are drawn behind the camera, or less, is
# drawn in front of it.
_MAX_VISIBLE_RATIO = 0.1
_NOTHING_DRAWN_HINT = (
    "Cull only rows behind the camera, whose depth along +z is below the near plane, and move a far "
    "plane back. If the model does not cull, load the checkpoint before the export."
)


@rule(
    "GV059",
    Severity.ERROR,
    needs=(MODEL_RUNS, *NOT_RANDOM, "GO001", "GO002", "GO010", "GO011", "GI001", "GM006"),
)
def rows_in_local_space(probe_runs: ProbeRuns) -> Iterator[Violation]:
    """Gaussian centres are given in local space: they do not move with the camera.

    Why:
        A renderer applies the view matrix to the rows. Rows that are in camera or clip space
        already are moved twice: the scene hangs before the camera, wherever that goes.

    Hint:
        Return the centres before the view and projection matrices are applied to them.
    """
    declared = probe_runs.subject.declared_gaussians
    from gsgen.contract.causes.camera_spaces import space_of_still_rows

    space = space_of_still_rows(isolated_views(probe_runs))
    if space is not None and declared is not None:
        part = f" of {space.declared:.0%} of the rows" if space.declared < 1 else ""
        actual = f"the centres{part} are {space.name}: they follow the camera"
        yield Violation.at(
            f"output {declared.name}", actual, "centres in local space", hint=space.hint
        )


@rule(
    "GV054",
    Severity.ERROR,
    needs=(MODEL_RUNS, *NOT_RANDOM, "GO001", "GO002", "GO010", "GO011", "GI001", "GM006"),
)
def camera_looks_along_z(probe_runs: ProbeRuns) -> Iterator[Violation]:
    """Culling keeps the Gaussians in front of the camera, along +z.

    Why:
        All probes look at the middle of the bounds. A model that culls as if the camera looked
        along −z, as in OpenGL, hides what is seen and draws what is behind: nothing is shown.

    Hint:
        Cull rows whose depth along +z is below the near plane; the view matrix is OpenCV's, with
        +x right, +y down and +z forward. A far plane before the scene hides as much: move it back.
    """
    declared = probe_runs.subject.declared_gaussians
    turned_away_indices = probe_runs.plan.trials.get("away", ())
    rows_behind_camera = (
        read_seen_rows(probe_runs, turned_away_indices[0]) if turned_away_indices else None
    )
    seen_rows = [read_seen_rows(probe_runs, index) for index in range(probe_runs.plan.values)]
    labels = probe_runs.plan.probes
    rows_before_camera = [
        s for s, probe in zip(seen_rows, labels, strict=False) if s is not None and not probe.zeros
    ]
    if rows_behind_camera is None or not rows_before_camera or declared is None:
        return
    hidden_share = float(np.mean(rows_behind_camera.drawn))
    visible_share = max(float(np.mean(entry.drawn)) for entry in rows_before_camera)
    if visible_share <= _MAX_VISIBLE_RATIO * hidden_share:
        expected, hint = "culling with +z forward, not -z", ""
        actual = (
            f"{visible_share:.1%} of the rows are drawn where the camera looks at the scene, "
            f"{hidden_share:.1%} where it looks away"
        )
        if not hidden_share:
            if not _has_live_rows(probe_runs):
                return  # another rule tells that the count is 0
            actual = (
                f"no row is drawn from any of {len(rows_before_camera)} places that see the scene"
            )
            expected, hint = "rows that a camera sees", _NOTHING_DRAWN_HINT
        yield Violation.at(f"output {declared.name}", actual, expected, hint=hint)


def _has_live_rows(probe_runs: ProbeRuns) -> bool:
    """Return whether the row count is above 0 at some probe."""
    declared = probe_runs.subject.declared_count
    runs = probe_runs.execution.runs[: probe_runs.plan.values]
    outputs = [probe_runs.execution.samples[run.sample].outputs for run in runs]
    return declared is not None and any(values[declared.name].any() for values in outputs)
