"""Rules of cameras (GI, GV, GB): matrix order, projection sign, no holes where rows are culled."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gsgen.contract._array_types import Bool, Float, UInt
from gsgen.contract.probing.differences import largest_difference
from gsgen.contract.probing.probes import Probe, SceneExtent
from gsgen.contract.probing.run_comparison import Behaviour
from gsgen.contract.spec.fields.roles import CAMERA_ROLES
from gsgen.contract.spec.layout import COVARIANCE, OPACITY, POSITION
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Statistic, Violation, line_hint, set_hint
from gsgen.contract.validation.gates import REPRODUCIBLE
from gsgen.contract.validation.rule import rule

if TYPE_CHECKING:
    from gsgen.contract.rules.behaviour.coverage_pictures import Lens


@rule("GI007", Severity.ERROR, needs=(*REPRODUCIBLE, "GI001", "GM006"))
def matrix_order(behaviour: Behaviour) -> Iterator[Violation]:
    """The model reads the view matrix in the memory order that the manifest declares.

    Why:
        The same sixteen numbers are a matrix or its transpose. Read as the other one, the
        translation is lost and the rotation turned around: the camera seems to stand still at the
        origin.

    Hint:
        Declare the order that the model reads as space.matrix_order, or transpose inside the model.
    """
    runs = behaviour.trial_runs("moved")
    if len(runs) < 3 or not all(run.digest for run in runs):
        return
    base_digest, moved_digest, transposed = (run.digest for run in runs)
    space = behaviour.subject.generator.space if behaviour.subject.generator else None
    order = space.matrix_order if space else "column"
    if moved_digest == base_digest and transposed != base_digest:
        actual = f"a moved camera changes nothing, read in {order} order; transposed it does"
        name = next(iter(behaviour.subject.inputs_of("view")))[0].name
        hint = set_hint("space.matrix_order", "row" if order == "column" else "column")
        yield Violation.at(f"input {name}", actual, f"the {order} order, as declared", hint=hint)


@rule("GI008", Severity.WARNING, needs=(*REPRODUCIBLE, "GI002"))
def projection_y_sign(behaviour: Behaviour) -> Iterator[Violation]:
    """Negating the y axis of clip space in the projection matrix changes no output.

    Why:
        Some hosts pass a projection with +y up, some with +y down, and a generator has no use for
        the sign: culling and level of detail are the same for both.

    Hint:
        Use absolute values of clip coordinates, or the view matrix alone.
    """
    runs = behaviour.trial_runs("flipped")
    if len(runs) < 2 or not all(run.digest for run in runs):
        return
    unflipped_run, flipped_run = runs
    if unflipped_run.digest != flipped_run.digest:
        for name, value in unflipped_run.outputs.items():
            largest = largest_difference(value, flipped_run.outputs[name])
            if largest > 0:
                actual = f"differs by up to {largest:.3g} with row 1 of the projection negated"
                lens = behaviour.subject.inputs_of("projection")[0][0].name
                space = behaviour.subject.generator.space if behaviour.subject.generator else None
                row = f"{lens}[1]" if space and space.matrix_order == "row" else f"{lens}[:, 1]"
                line = line_hint(f"{row} = {row} * {lens}[1, 1].sign()", first=True)
                hint = f"Take the scale of y as positive, or use the view matrix alone. {line}"
                yield Violation.at(f"output {name}", actual, "the same for both signs", hint=hint)


@rule("GV017", Severity.WARNING, needs=("GV025", "GO010", "GO011", "GV016"))
def count_not_zero(behaviour: Behaviour) -> Iterator[Violation]:
    """No camera that sees the declared bounds gets 0 Gaussians if other cameras get some.

    Why:
        These probes look at the middle of the bounds. A count of zero for some of them is culling
        with a wrong matrix or sign.

    Hint:
        Check the matrix order, and that +z is forward.
    """
    from gsgen.contract.probing.survey_probes import SIDE_LABEL

    subject = behaviour.subject
    declared = subject.declared_count
    roles = ("view", "projection", "camera_position")
    if declared is None or not any(subject.inputs_of(role) for role in roles):
        return
    counts = {
        probe.label: int(outputs[declared.name].reshape(-1)[0])
        for probe, outputs in behaviour.probe_outputs
    }
    counts |= {
        run.probe.label: run.row_count.count
        for run in behaviour.trial_runs("survey")
        if run.row_count is not None and run.probe.label.startswith(SIDE_LABEL)
    }
    empty_view_labels = [label for label, count in counts.items() if count == 0]
    if empty_view_labels and len(empty_view_labels) < len(counts):
        actual = (
            f"0 at {len(empty_view_labels)} of {len(counts)} probes, first {empty_view_labels[0]!r}"
        )
        expected = "rows for every camera that sees the bounds"
        yield Violation.at(f"output {declared.name}", actual, expected, certainty="possible")


# Rows nearer than this share of the bounds' half diagonal are too near for a picture.
_NEAR_SHARE = 0.1
# Rows count as in view within this share of the picture's half width and half height.
_MAX_VIEW_SHARE = 0.95
_MIN_HIDDEN_ROWS, _MIN_SEEING_CAMERAS = 3, 3
# A pixel is a hole if the full picture covers it, and less than this share of that is left, or what
# is left is farther away by this factor.
_MIN_COVERAGE, _MIN_LEFT_SHARE, _MAX_DEPTH_RATIO = 0.05, 0.5, 1.3
# The statistic is the share of the covered picture that is holes, at the worst camera. Right models
# have 0; levels of detail that merge few rows coarsely up to 0.16; wrong planes, lenses, sides and
# distances 0.64 to 1.
_MAX_HOLE_SHARE = 0.35
# A smaller part of the picture, in pixels of 576, says nothing.
_MIN_PICTURE_AREA = 8.0
# Hidden and drawn rows differ by one number, such as the depth, in this share of all pairs.
_MIN_SEPARATION = 0.9
# From nearby, a model draws at least this share of the rows in view that it draws from afar, where
# it is this many times as far. Right levels draw as many or more, reversed ones 0.1 to 0.4.
_MIN_DETAIL_SHARE, _MIN_DETAIL_ROWS, _MIN_DISTANCE_RATIO = 0.5, 24, 1.8
# Rows and pictures at most that are drawn.
_PICTURE_ROWS, _PICTURE_COUNT = 1024, 4


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sight:
    """One camera of a model, and what it draws.

    Attributes:
        probe: Its probe.
        view: Its world→camera matrix.
        lens: Its lens.
        rows: The drawn rows.
        keys: A hash of each one's position.
        is_drawn: Which rows of all cameras together are drawn.
        is_in_view: Which of them are in view.
        depth: The depth of each of them.
        place: Their places in the picture, from −1 to 1 within it.
        slope: The larger of x / z and y / z of each of them.
    """

    probe: Probe
    view: Float[np.ndarray, "4 4"]
    lens: "Lens"
    rows: Float[np.ndarray, "n 10"]
    keys: UInt[np.ndarray, " n"]
    is_drawn: Bool[np.ndarray, " m"]
    is_in_view: Bool[np.ndarray, " m"]
    depth: Float[np.ndarray, " m"]
    place: Float[np.ndarray, "m 2"]
    slope: Float[np.ndarray, " m"]

    @property
    def is_hidden(self) -> Bool[np.ndarray, " m"]:
        """Which rows are in view, and not drawn."""
        return np.asarray(self.is_in_view & ~self.is_drawn)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Scene:
    """The rows that any camera draws, and the cameras.

    Attributes:
        rows: The rows, with the mean of their opacities.
        keys: A hash of each one's position, in ascending order.
        sights: The cameras.
        near: Depths below this are left out.
    """

    rows: Float[np.ndarray, "m 10"]
    keys: UInt[np.ndarray, " m"]
    sights: list[_Sight]
    near: float


@rule("GB067", Severity.WARNING, needs=(*REPRODUCIBLE, "GO001", "GO002", "GI007", "GM006", "GV017"))
def detail_grows_nearby(behaviour: Behaviour) -> Iterator[Violation]:
    """From nearby, a model draws at least half of the rows in view that it draws from afar.

    Why:
        Levels of detail in the reverse order, or chosen by another distance than that of the
        camera, leave a few coarse Gaussians where people look closely.

    Hint:
        Let the finest level have the smallest distance; take the distance from the camera's centre
        −Rᵀ t to the row.
    """
    scene = _read_scene(behaviour)
    for near in scene.sights if scene else ():
        for far in scene.sights if scene else ():
            region = near.is_in_view & far.is_in_view
            counts = [int(np.count_nonzero(region & sight.is_drawn)) for sight in (near, far)]
            if counts[1] < _MIN_DETAIL_ROWS or counts[0] >= _MIN_DETAIL_SHARE * counts[1]:
                continue
            ratio = float(np.median(far.depth[region]) / np.median(near.depth[region]))
            if ratio >= _MIN_DISTANCE_RATIO and counts[0] and not _separation(near):
                actual = (
                    f"{counts[0]} of the rows in view are drawn at {near.probe.label!r}, and "
                    f"{counts[1]} of them at {far.probe.label!r}, {ratio:.2g} times as far away"
                )
                statistic = Statistic(
                    "rows nearby over rows from afar", counts[0] / counts[1], _MIN_DETAIL_SHARE
                )
                yield _violation(behaviour, actual, "more rows the nearer the camera", statistic)
                return


@rule(
    "GB008",
    Severity.WARNING,
    needs=(*REPRODUCIBLE, "GO001", "GO002", "GI007", "GM006", "GV017", "GV054", "GB067"),
)
def culling_conservative(behaviour: Behaviour) -> Iterator[Violation]:
    """Rows that a camera does not draw leave no hole in its picture, compared with all rows.

    Why:
        Models cull by an opacity of zero. A wrong matrix, sign, lens or margin makes holes that
        move with the camera. Pictures are drawn from inside, near and far.

    Hint:
        Cull behind the camera and outside the frustum of the fed projection, widened by a tenth;
        check the matrix order, and that +z is forward. Keep the near plane below a hundredth of the
        scene.
    """
    scene = _read_scene(behaviour)
    if scene is None:
        return
    suspects = [s for s in scene.sights if np.count_nonzero(s.is_hidden) >= _MIN_HIDDEN_ROWS]
    suspects.sort(key=lambda sight: -float(sight.is_hidden.sum() / max(sight.is_in_view.sum(), 1)))
    shares = [_hole_share(scene, sight) for sight in suspects[:_PICTURE_COUNT]]
    if shares and max(shares) > _MAX_HOLE_SHARE:
        share, sight = max(zip(shares, suspects, strict=False), key=lambda entry: entry[0])
        words = _separation(sight) or "all over the picture"
        actual = (
            f"holes in {share:.0%} of the picture at {sight.probe.label!r}: "
            f"{np.count_nonzero(sight.is_hidden)} of {np.count_nonzero(sight.is_in_view)} rows in "
            f"view are not drawn, {words}"
        )
        statistic = Statistic("share of holes", share, 0.0, _MAX_HOLE_SHARE)
        yield _violation(behaviour, actual, "a picture as that of all rows", statistic)


def _violation(behaviour: Behaviour, actual: str, expected: str, statistic: Statistic) -> Violation:
    declared = behaviour.subject.declared_gaussians
    where = f"output {declared.name if declared else '?'}"
    return Violation.at(where, actual, expected, certainty="possible", statistic=statistic)


def _read_scene(behaviour: Behaviour) -> _Scene | None:
    """Return the rows that the cameras of one moment draw; None if all draw the same ones."""
    manifest = behaviour.subject.generator
    if manifest is None or manifest.outputs.gaussians is None:
        return None
    drawn = list(_drawn_by_cameras(behaviour, manifest))  # each rule notes runs that are missing
    if "scene" not in behaviour.readings:
        behaviour.readings["scene"] = _scene_of_cameras(manifest, drawn)
    scene: _Scene | None = behaviour.readings["scene"]
    return scene


def _scene_of_cameras(
    manifest: GeneratorManifest, drawn: list[tuple[Probe, Float[np.ndarray, "n 10"]]]
) -> _Scene | None:
    from gsgen.contract.probing.row_screen import row_keys

    keys = [row_keys(rows[:, POSITION]) for _, rows in drawn]
    if len(drawn) < 2 or all(np.array_equal(own, keys[0]) for own in keys):
        return None
    from gsgen.contract.rules.behaviour.coverage_pictures import (
        lens_of_probe,
        project,
        view_of_probe,
    )

    rows = np.concatenate([rows for _, rows in drawn])
    known, first, inverse = np.unique(np.concatenate(keys), return_index=True, return_inverse=True)
    counts = np.bincount(inverse)
    union = rows[first].astype(np.float64)
    union[:, OPACITY] = np.bincount(inverse, rows[:, OPACITY]) / counts
    # Rows that move with the camera, such as those of a sky, are drawn at other places each time.
    stays = counts >= _MIN_SEEING_CAMERAS
    known, union = known[stays], union[stays]
    ends = np.cumsum([len(own_keys) for own_keys in keys])[:-1]
    near = _NEAR_SHARE * SceneExtent.from_manifest(manifest).radius
    sights = []
    for (probe, own_rows), own_keys, own in zip(drawn, keys, np.split(inverse, ends), strict=True):
        is_drawn = np.zeros(len(stays), bool)
        is_drawn[own] = True
        view = view_of_probe(manifest, probe)
        if view is None:
            return None
        lens = lens_of_probe(manifest, probe)
        projected = project(union, view, lens, near)
        depth, place = np.zeros(len(union)), np.full((len(union), 2), np.inf)
        depth[projected.indices], place[projected.indices] = projected.depth, projected.place
        sights.append(
            _Sight(
                probe=probe,
                view=view,
                lens=lens,
                rows=own_rows,
                keys=own_keys,
                is_drawn=is_drawn[stays],
                is_in_view=np.abs(place).max(axis=1) <= _MAX_VIEW_SHARE,
                depth=depth,
                place=place,
                slope=np.abs(place / np.array(lens)).max(axis=1),
            )
        )
    return _Scene(rows=union, keys=known, sights=sights, near=near)


def _drawn_by_cameras(
    behaviour: Behaviour, manifest: GeneratorManifest
) -> Iterator[tuple[Probe, Float[np.ndarray, "n 10"]]]:
    """Yield the runs that differ from the base run in the camera alone, and their drawn rows."""
    from gsgen.contract.probing.row_screen import drawn_rows

    base = behaviour.base.probe.inputs
    others = [entry.name for entry in manifest.inputs if entry.role not in CAMERA_ROLES]
    for run in (*behaviour.trial_runs("survey"), *behaviour.trial_runs("screens")):
        drawn = run.sample.drawn if run.sample is not None else None
        is_same_moment = all(np.array_equal(run.probe.inputs[k], base[k]) for k in others)
        if drawn is not None and is_same_moment:
            yield run.probe, drawn
    count, gaussians = manifest.outputs.count, manifest.outputs.gaussians
    assert gaussians is not None
    roles = ("view", "camera_position")
    role = next((role for role in roles if behaviour.subject.inputs_of(role)), "")
    for probe, outputs in behaviour.variants(role):
        rows = drawn_rows(outputs[gaussians.name], outputs.get(count.name) if count else None)
        if rows is not None:
            yield probe, rows


def _hole_share(scene: _Scene, sight: _Sight) -> float:
    """Return the share of a camera's picture that is missing, compared with all rows."""
    from gsgen.contract.rules.behaviour.coverage_pictures import draw_coverage

    # Few of many rows are drawn, and larger ones, so that surfaces remain closed.
    step = -(-int(np.count_nonzero(sight.is_in_view)) // _PICTURE_ROWS)
    pictures = []
    for rows, keys in ((scene.rows, scene.keys), (sight.rows, sight.keys)):
        sample = rows[keys % np.uint64(max(step, 1)) == 0].astype(np.float64)
        sample[:, COVARIANCE] *= step
        pictures.append(draw_coverage(sample, sight.view, sight.lens, scene.near))
    (full, full_depth), (left, left_depth) = pictures
    is_covered = full >= _MIN_COVERAGE
    is_hole = is_covered & (
        (left < _MIN_LEFT_SHARE * full) | (left_depth > _MAX_DEPTH_RATIO * full_depth)
    )
    area = float(full[is_covered].sum())
    return float(full[is_hole].sum()) / area if area >= _MIN_PICTURE_AREA else 0.0


def _separation(sight: _Sight) -> str:
    """Return by which number hidden rows differ from drawn ones; empty if by none."""
    hidden, shown = sight.is_hidden, sight.is_in_view & sight.is_drawn
    if not shown.any():
        return "which are all of them"
    numbers = {
        "the nearest": -sight.depth,
        "the farthest": sight.depth,
        "those at the rim": np.abs(sight.place).max(axis=1),
        "those beyond an angle": sight.slope,
        "those at the left and at the right": np.abs(sight.place[:, 0]),
        "those at the top and at the bottom": np.abs(sight.place[:, 1]),
        "those at the left": -sight.place[:, 0],
        "those at the right": sight.place[:, 0],
        "those at the top": -sight.place[:, 1],
        "those at the bottom": sight.place[:, 1],
    }
    separations = {
        words: _share_above(values[hidden], values[shown]) for words, values in numbers.items()
    }
    words, share = max(separations.items(), key=lambda entry: entry[1])
    return words if share >= _MIN_SEPARATION else ""


def _share_above(values: Float[np.ndarray, " h"], others: Float[np.ndarray, " s"]) -> float:
    """Return in which share of all pairs the first number is above the second."""
    if not len(values):
        return 0.0
    return float(np.searchsorted(np.sort(others), values).mean() / len(others))
