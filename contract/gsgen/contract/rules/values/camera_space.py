"""Validation rules of camera conventions: positions in local space, camera along +z."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gsgen.contract._array_types import Bool, Float
from gsgen.contract.probing.probes import as_tensor
from gsgen.contract.probing.run_comparison import ProbeRuns
from gsgen.contract.spec.fields.roles import CAMERA_ROLES
from gsgen.contract.spec.layout import CULL_OPACITY, OPACITY, POSITION, ROW_LENGTH
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.gates import MODEL_RUNS, NOT_RANDOM
from gsgen.contract.validation.rule import rule

_MIN_ROWS = 4
# Positions follow the camera if they move by more than the first fraction of their spread, and by
# less than the second once the camera is undone.
_MIN_MOTION_RATIO = 0.05
_MAX_RESIDUAL_RATIO = 2e-3
# Culling is backwards if this fraction of the rows that are drawn behind the camera, or less, is
# drawn in front of it.
_MAX_VISIBLE_RATIO = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class _RowsInCameras:
    """The Gaussians that a model shows to one camera.

    Attributes:
        view: The matrix from local to camera space.
        projection: The matrix from camera to clip space; None without that input.
        position: Centres of all rows.
        drawn: Mask of the rows that are drawn.
    """

    view: Float[np.ndarray, "4 4"]
    projection: Float[np.ndarray, "4 4"] | None
    position: Float[np.ndarray, "n 3"]
    drawn: Bool[np.ndarray, " n"]


def _read_seen_rows(probe_runs: ProbeRuns, index: int) -> _RowsInCameras | None:
    subject, probe = probe_runs.subject, probe_runs.plan.probes[index]
    run = probe_runs.execution.runs[index] if index < len(probe_runs.execution.runs) else None
    declared, count = subject.declared_gaussians, subject.declared_count
    views, lenses = subject.inputs_of("view"), subject.inputs_of("projection")
    if run is None or run.sample < 0 or declared is None or count is None or not views:
        return None
    outputs = probe_runs.execution.samples[run.sample].outputs
    rows, live = outputs.get(declared.name), outputs.get(count.name)
    if (
        rows is None
        or rows.ndim != 2
        or rows.shape[1] != ROW_LENGTH
        or live is None
        or not live.size
    ):
        return None
    space = subject.generator.space if subject.generator else None
    order = space.matrix_order if space else "column"

    def matrix(name: str) -> Float[np.ndarray, "4 4"]:
        return as_tensor(probe.inputs[name], order).astype(np.float64)

    lens = matrix(lenses[0][0].name) if lenses else None
    drawn = np.asarray(rows[:, OPACITY] >= CULL_OPACITY)
    live_share = max(0, int(live.reshape(-1)[0])) / max(declared.capacity, 1)
    drawn[math.ceil(live_share * len(rows)) :] = False  # of many rows, a part was kept
    return _RowsInCameras(
        view=matrix(views[0][0].name),
        projection=lens,
        position=rows[:, POSITION].astype(np.float64),
        drawn=drawn,
    )


def _isolated_views(probe_runs: ProbeRuns) -> list[_RowsInCameras]:
    """Return cameras and Gaussians of all model runs whose inputs differ in the camera alone."""
    plan = probe_runs.plan
    base, variants = plan.variants.get("view", (0, ()))
    indices = [base, *variants] if variants else []
    manifest = probe_runs.subject.manifest
    roles = {entry.role for entry in manifest.inputs} if manifest else set()
    if not indices and roles <= set(CAMERA_ROLES):
        indices = [index for index in range(plan.values) if not plan.probes[index].zeros]
    seen_rows = (_read_seen_rows(probe_runs, index) for index in indices)
    return [entry for entry in seen_rows if entry is not None]


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
    runs = _isolated_views(probe_runs)
    for first, second in combinations(runs[:3], 2):
        if first.position.shape != second.position.shape:
            continue
        drawn = first.drawn & second.drawn
        if np.count_nonzero(drawn) < _MIN_ROWS or declared is None:
            continue
        for space in ("camera space", "clip space"):
            if _does_follow_camera(first, second, drawn, space):
                actual = f"the centres are in {space}: they follow the view matrix"
                yield Violation.at(f"output {declared.name}", actual, "centres in local space")
                return


def _does_follow_camera(
    first: _RowsInCameras, second: _RowsInCameras, drawn: Bool[np.ndarray, " n"], space: str
) -> bool:
    """Return whether the Gaussian centres of two model runs agree only in camera space."""
    local_positions = [_local_positions(seen_rows, space) for seen_rows in (first, second)]
    if local_positions[0] is None or local_positions[1] is None:
        return False
    drawn_positions = [points[drawn] for points in local_positions if points is not None]
    spread = float(np.linalg.norm(np.ptp(drawn_positions[0], axis=0)))
    if not np.isfinite(drawn_positions).all() or spread <= 0:
        return False
    row_motion = np.linalg.norm(first.position[drawn] - second.position[drawn], axis=1)
    residual_motion = np.linalg.norm(drawn_positions[0] - drawn_positions[1], axis=1)
    scene_size = float(np.linalg.norm(np.ptp(first.position[drawn], axis=0)))
    return bool(
        np.median(row_motion) > _MIN_MOTION_RATIO * scene_size
        and residual_motion.max() < _MAX_RESIDUAL_RATIO * spread
    )


def _local_positions(seen_rows: _RowsInCameras, space: str) -> Float[np.ndarray, "n 3"] | None:
    matrix = seen_rows.view
    if space == "clip space":
        if seen_rows.projection is None:
            return None
        matrix = seen_rows.projection @ seen_rows.view
    if abs(np.linalg.det(matrix)) < np.finfo(np.float64).eps:
        return None
    points = np.concatenate([seen_rows.position, np.ones((len(seen_rows.position), 1))], axis=1)
    positions = points @ np.linalg.inv(matrix).T
    return np.asarray(positions[:, :3] / positions[:, 3:])


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
        +x right, +y down and +z forward.
    """
    declared = probe_runs.subject.declared_gaussians
    turned_away_indices = probe_runs.plan.trials.get("away", ())
    rows_behind_camera = (
        _read_seen_rows(probe_runs, turned_away_indices[0]) if turned_away_indices else None
    )
    seen_rows = [_read_seen_rows(probe_runs, index) for index in range(probe_runs.plan.values)]
    labels = probe_runs.plan.probes
    rows_before_camera = [
        s for s, probe in zip(seen_rows, labels, strict=False) if s is not None and not probe.zeros
    ]
    if rows_behind_camera is None or not rows_before_camera or declared is None:
        return
    hidden_share = float(np.mean(rows_behind_camera.drawn))
    visible_share = max(float(np.mean(entry.drawn)) for entry in rows_before_camera)
    if hidden_share > 0 and visible_share <= _MAX_VISIBLE_RATIO * hidden_share:
        actual = (
            f"{visible_share:.1%} of the rows are drawn where the camera looks at the scene, "
            f"{hidden_share:.1%} where it looks away"
        )
        yield Violation.at(f"output {declared.name}", actual, "culling with +z forward, not -z")
