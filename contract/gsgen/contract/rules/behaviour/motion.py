"""Rules of time (GB): loops close, motion has no jumps, births fade, every frame is reached."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from gsgen.contract.probing.behaviour_probes import HIGH_END, ORDER, STEP_OFFSETS, STEPS
from gsgen.contract.probing.differences import largest_difference
from gsgen.contract.probing.run_comparison import Behaviour, ProbeRun
from gsgen.contract.spec.layout import CULL_OPACITY, OPACITY, POSITION
from gsgen.contract.spec.manifest import Input
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation, remove_hint
from gsgen.contract.validation.gates import REPRODUCIBLE
from gsgen.contract.validation.rule import rule

# The end may differ from the start by this share of a frame's step: 0 in right loops, 1 in those
# that are a frame short. Of frames that are shown one by one, the last may stay until the end.
_MAX_JUMP_RATIO, _MAX_STEPPED_JUMP_RATIO = 0.5, 3.0
# The rounding error, relative to the largest value.
_ROUNDING = 2e-3
# The step between two frames is this much larger than all others, and the step from the last frame
# to the first no more than the second number: 4 and 1 where a sequence is shifted by one frame.
_MIN_BREAK_RATIO, _MAX_CLOSING_RATIO = 4.0, 2.0
# Frames are nearly empty with fewer drawn rows than this share of the most; so are at most half.
_MIN_DRAWN_SHARE, _MAX_EMPTY_SHARE = 0.01, 0.5
# The largest motion between two pictures, as a fraction of the bounds' diagonal.
_MAX_POP_FRACTION = 0.1
# The opacity of a Gaussian that is not drawn 1/60 s before or after. One that fades within a frame's
# time has at most half of its own up to 30 frames a second, and up to 60 around a frame's beginning.
_MIN_POP_OPACITY, _FADING_FPS, _FADING_FPS_AROUND = 0.6, 30.0, 60.0
# Narrow windows of trained scenes may rise so fast, a few at a time: at most this share of drawn rows.
_MAX_POPPING_SHARE = 1e-3
# More than this share at once is a cut, in which a clip goes on elsewhere.
_MIN_CUT_SHARE = 0.5


def _float_outputs(run: ProbeRun) -> dict[str, np.ndarray]:
    floats = {n: v for n, v in run.outputs.items() if v.dtype.kind == "f"}
    return floats if all(np.isfinite(v).all() for v in floats.values()) else {}


def _count(behaviour: Behaviour, run: ProbeRun) -> np.ndarray:
    """Return the row count that a run outputs; an empty array if the manifest declares none."""
    declared, no_count = behaviour.subject.declared_count, np.zeros(0)
    return no_count if declared is None else run.outputs.get(declared.name, no_count)


_LOOP_MEND = (
    "let the end of the range show what its start shows: divide by the number of frames, not by "
    "one less, and take radians, 2 π a turn"
)


@rule("GB004", Severity.ERROR, needs=(*REPRODUCIBLE, "GM010", "GB003", "GI006"))
def time_loops(behaviour: Behaviour) -> Iterator[Violation]:
    """If time is declared to loop, the outputs at its end continue those at its start.

    Why:
        Viewers wrap around at the end of the range: any difference there is a jump in every loop.

    Hint:
        Let the end of the range show what its start shows: divide by the number of frames, not by
        one less, and take radians, 2 π a turn. Or do not declare "loop".
    """
    runs = behaviour.trial_runs("loop")
    if len(runs) < 4:
        return
    inputs = behaviour.subject.manifest.inputs if behaviour.subject.manifest else ()
    looping = next((index for index, entry in enumerate(inputs) if entry.loop), 0)
    hint = remove_hint(f"inputs.{looping}.loop", _LOOP_MEND)
    start, frame_after_start, frame_before_end, end = (_float_outputs(run) for run in runs[:4])
    for name in start.keys() & frame_after_start.keys() & frame_before_end.keys() & end.keys():
        loop_jump = largest_difference(start[name], end[name])
        step = max(
            largest_difference(start[name], frame_after_start[name]),
            largest_difference(frame_before_end[name], end[name]),
        )
        max_magnitude = float(np.abs(start[name].astype(np.float64)).max(initial=0))
        is_stepped = not largest_difference(frame_before_end[name], end[name])
        max_ratio = _MAX_STEPPED_JUMP_RATIO if is_stepped else _MAX_JUMP_RATIO
        if loop_jump > max_ratio * step + _ROUNDING * max_magnitude:
            actual = f"jumps by up to {loop_jump:.3g} from the end to the start"
            expected = f"the same outputs, where a frame's step before and after is {step:.3g}"
            yield Violation.at(f"output {name}", actual, expected, hint=hint)


@rule("GB005", Severity.INFO, needs=(*REPRODUCIBLE, "GM009", "GM010", "GO001", "GO002"))
def time_continuous(behaviour: Behaviour) -> Iterator[Violation]:
    """No visible Gaussian moves a tenth of the bounds between two refreshes of a 60 Hz screen.

    Why:
        At the declared speed the eye sees a jump instead of motion. Usually two frames are not of
        the same Gaussians, or the declared frames per second are wrong.

    Hint:
        Interpolate between frames of the same Gaussians; fade what appears. Check frames and fps.
    """
    generator, declared = behaviour.subject.generator, behaviour.subject.declared_gaussians
    runs = behaviour.trial_runs("paces")
    if generator is None or generator.bounds is None or declared is None:
        return
    diagonal = np.linalg.norm(np.subtract(generator.bounds.max, generator.bounds.min))
    for first_run, second_run in zip(runs[::2], runs[1::2], strict=False):
        a, b = (_float_outputs(run).get(declared.name) for run in (first_run, second_run))
        if a is None or b is None or a.shape != b.shape:
            continue
        if not np.array_equal(_count(behaviour, first_run), _count(behaviour, second_run)):
            continue  # rows behind a dropped one are those of other Gaussians
        drawn = np.minimum(a[:, OPACITY], b[:, OPACITY]) >= CULL_OPACITY
        paths = (a[drawn, POSITION].astype(np.float64), b[drawn, POSITION])
        max_distance = float(np.linalg.norm(paths[0] - paths[1], axis=1).max(initial=0.0))
        if max_distance > _MAX_POP_FRACTION * diagonal:
            actual = f"moves by {max_distance:.3g} within 1/60 s, {first_run.probe.label!r}"
            expected = (
                f"{_MAX_POP_FRACTION * diagonal:.3g} at most, a tenth of the bounds' diagonal"
            )
            yield Violation.at(f"output {declared.name}", actual, expected, certainty="possible")


@rule("GB073", Severity.WARNING, needs=(*REPRODUCIBLE, "GM010", "GO001", "GO002", "GB069"))
def births_fade(behaviour: Behaviour) -> Iterator[Violation]:
    """Where outputs change within frames, Gaussians that are born or die fade, and do not pop.

    Why:
        Motion that is interpolated looks smooth; a Gaussian that is there from one picture to the
        next flickers, and with hundreds in each frame the whole scene does.

    Hint:
        Interpolate opacities as positions are, from 0 in the frame before the birth to 0 in the one
        after the death, instead of comparing the time with both.
    """
    declared, clock = behaviour.subject.declared_gaussians, _clock(behaviour)
    runs, steps = behaviour.trial_runs("paces"), behaviour.trial_runs(STEPS)
    within_frame = {run.digest for run in steps[: len(STEP_OFFSETS)]}
    if declared is None or clock is None or len(within_frame) == 1:
        return  # of frames that are shown one by one, all rows change
    for number, (first_run, second_run) in enumerate(zip(runs[::2], runs[1::2], strict=False)):
        if (clock.fps or 0) > (_FADING_FPS_AROUND if number == 1 else _FADING_FPS):
            continue
        a, b = (_float_outputs(run).get(declared.name) for run in (first_run, second_run))
        if a is None or b is None or a.shape != b.shape:
            continue
        if not np.array_equal(_count(behaviour, first_run), _count(behaviour, second_run)):
            continue  # rows behind a dropped one are those of other Gaussians
        low, high = (part(a[:, OPACITY], b[:, OPACITY]) for part in (np.minimum, np.maximum))
        drawn = int(np.count_nonzero(high >= CULL_OPACITY))
        popping = (low < CULL_OPACITY) & (high > _MIN_POP_OPACITY)
        count = int(np.count_nonzero(popping))
        if _MAX_POPPING_SHARE * drawn < count <= _MIN_CUT_SHARE * drawn:
            actual = (
                f"{count} of {drawn} drawn rows appear or disappear within 1/60 s, "
                f"{second_run.probe.label!r}, row {int(popping.argmax())} first, whose opacity is "
                f"{high[popping][0]:.2g} or 0"
            )
            expected = f"at most {_MIN_POP_OPACITY:g} beside a moment in which it is not drawn"
            yield Violation.at(f"output {declared.name}", actual, expected, certainty="possible")
            return


def _clock(behaviour: Behaviour) -> Input | None:
    """Return the input that chooses frames: one that declares their number comes first."""
    manifest = behaviour.subject.manifest
    entries = [
        e for e in (manifest.inputs if manifest else ()) if e.role in ("time", "frame_index")
    ]
    return min(entries, key=lambda entry: not entry.frames, default=None)


def _where(behaviour: Behaviour) -> str:
    clock = _clock(behaviour)
    return f"role {clock.role if clock else 'time'}"


def _frame_runs(behaviour: Behaviour) -> list[ProbeRun]:
    """Return the runs at the beginning of each declared frame."""
    from gsgen.contract.probing.named_moments import FRAMES

    entry = _clock(behaviour)
    has_frames = entry is not None and entry.frames
    return [run for run in behaviour.trial_runs(FRAMES) if has_frames and run.digest]


@rule("GB006", Severity.WARNING, needs=(*REPRODUCIBLE, "GM010", "GB003", "GI006", "GB040", "GB069"))
def every_frame_reached(behaviour: Behaviour) -> Iterator[Violation]:
    """Each declared frame shows something, gives other outputs than the one before, and follows it.

    Why:
        A number of frames that is one too small shows a frame twice, and the last one never;
        numbering from 1 shows the last frame first. Without 0.001, float32 may show the frame
        before where one begins.

    Hint:
        Take frame floor(time · frames + 0.001), clamped to the last, for a time from 0 to 1; number
        frames from 0. If the scene stands still for a while, ignore this rule.
    """
    yield from _empty_frames(behaviour)
    yield from _breaks_of_order(behaviour)
    runs = _frame_runs(behaviour)
    within_runs = [run for run in behaviour.trial_runs("within frames") if run.digest]
    repeated_labels = [
        later_run.probe.label
        for earlier_run, later_run in (*pairwise(runs), *pairwise(within_runs))
        if earlier_run.digest == later_run.digest
    ]
    late_beginnings = list(_late_beginnings(behaviour))
    yield from late_beginnings
    if repeated_labels and not late_beginnings:
        actual = (
            f"{len(repeated_labels)} of {len(runs) + len(within_runs)} runs show what the frame "
            f"before did, {repeated_labels[0]!r} first"
        )
        yield Violation.at(
            _where(behaviour), actual, "other outputs in each frame", certainty="possible"
        )


def _late_beginnings(behaviour: Behaviour) -> Iterator[Violation]:
    """Yield a violation if frames show the one before at the very number where they begin."""
    from gsgen.contract.probing.named_moments import FRAMES

    entry = _clock(behaviour)
    if entry is None or entry.role != "time":
        return

    def frames_of(group: str) -> Iterator[tuple[int, float, str]]:
        for run in behaviour.trial_runs(group):
            time = float(run.probe.inputs[entry.name].flat[0])
            if run.digest:  # of a run that failed there is none
                yield entry.frame_at(time), time, run.digest

    # What frames show is known where a run lies within them.
    shown = {
        frame: digest
        for group in (STEPS, ORDER, "within frames")
        for frame, _, digest in frames_of(group)
    }
    beginnings = [
        begin
        for begin in frames_of(FRAMES)
        if len({shown.get(begin[0] - k) for k in (0, 1)} - {None}) == 2
    ]
    late = [(frame, time) for frame, time, digest in beginnings if digest == shown[frame - 1]]
    if late:
        frame, time = late[0]
        actual = (
            f"{len(late)} of {len(beginnings)} frames show the one before where they begin, frame "
            f"{frame} first, at {time:.9g}: rounded down in float32"
        )
        yield Violation.at(
            "role time",
            actual,
            "frame k from t(k) on",
            hint="Add 0.001 frames before you round down: floor(frames · (t − a) / (b − a) + 0.001).",
        )


def _empty_frames(behaviour: Behaviour) -> Iterator[Violation]:
    counts = [run.row_count.drawn for run in _frame_runs(behaviour) if run.row_count is not None]
    if len(counts) < 3 or not any(counts):
        return  # where nothing is ever drawn, another rule tells it
    empty_count = sum(count <= _MIN_DRAWN_SHARE * max(counts) for count in counts)
    if empty_count > _MAX_EMPTY_SHARE * len(counts):
        actual = (
            f"in {empty_count} of {len(counts)} frames hardly any row is opaque enough to be drawn, "
            f"where another shows {max(counts)} rows"
        )
        hint = "Widen the window of time in which rows are opaque: check its unit and its width."
        yield Violation.at(
            _where(behaviour), actual, "rows in most frames", certainty="possible", hint=hint
        )


def _breaks_of_order(behaviour: Behaviour) -> Iterator[Violation]:
    declared = behaviour.subject.declared_gaussians
    rows = (
        [run.outputs.get(declared.name) for run in behaviour.trial_runs(ORDER)] if declared else []
    )
    positions = [part[:, POSITION].astype(np.float64) for part in rows if part is not None]
    if len(positions) < 6 or len({points.shape for points in positions}) > 1:
        return
    # Steps 0 → 1 → 2 and F − 3 → F − 2 → F − 1, and from the last frame to the first.
    steps = [_typical_motion(positions[k], positions[k + 1]) for k in (0, 1, 3, 4)]
    closing = _typical_motion(positions[-1], positions[0])
    for number, words in ((0, "the first frame"), (3, "the last frame")):
        others = max(step for k, step in enumerate(steps) if k != number)
        # Where all others stand still, there is no step to compare with.
        if steps[number] > _MIN_BREAK_RATIO * others > 0 and closing <= _MAX_CLOSING_RATIO * others:
            actual = (
                f"{words} is {steps[number] / others:.3g} steps from its neighbour, and "
                "continues the other end of the sequence: frames are numbered from 1, or one too far"
            )
            hint = "Subtract 1 from the frame number, or stop subtracting it: frame 0 is the first."
            yield Violation.at(
                _where(behaviour), actual, "frames in their order", certainty="possible", hint=hint
            )
            return


def _typical_motion(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.median(np.linalg.norm(second - first, axis=1)))


@rule("GB069", Severity.ERROR, needs=(*REPRODUCIBLE, "GM010", "GI006", "GB040"))
def steps_begin_with_frames(behaviour: Behaviour) -> Iterator[Violation]:
    """Where outputs stand still within frames, they change where one begins; the last one ends them.

    Why:
        Sound, captions and other models run on the same clock. Frames at k / (F − 1), or rounded to
        the nearest, come too early, and the last one never, or too short. A clock stops at the high
        end.

    Hint:
        Take frame floor(time · frames + 0.001), clamped to the last, for a time from 0 to 1: neither
        Round, nor frames − 1, nor Mod.
    """
    digests = [run.digest for run in behaviour.trial_runs(STEPS)]
    count = len(STEP_OFFSETS)
    if len(digests) != 2 * count or not all(digests):
        return
    changes = [earlier != later for earlier, later in pairwise(digests)]
    within = changes[: count - 1], changes[count:]
    if not changes[count - 1] and all(sum(part) == 1 for part in within):
        offset = STEP_OFFSETS[within[0].index(True) + 1]
        actual = (
            f"frames change within a declared frame, before {offset:g} of it, and not between two"
        )
        yield Violation.at("role time", actual, "frame k from t(k) on")
    last = [run for run in behaviour.trial_runs("within frames") if run.digest][-1:]
    ends = [run for run in behaviour.trial_runs(HIGH_END) if run.digest]
    # What rests in the middle of its motion stands still there, too, but does not step.
    is_stepped = changes[count - 1] and not any(map(any, within))
    is_stepped = is_stepped and not any(_breaks_of_order(behaviour))
    if is_stepped and last and ends and ends[0].digest != last[0].digest:
        first = [run.digest for run in _frame_runs(behaviour)[:1]]
        words = "frame 0" if first == [ends[0].digest] else "another one"
        actual = f"the high end of the time shows {words}, and not the last frame"
        hint = (
            "Clamp the frame's number to the last, min(floor(time · frames + 0.001), frames − 1). "
            'Where frame 0 follows the last one, declare "loop": true instead.'
        )
        yield Violation.at("role time", actual, "the last frame, without loop", hint=hint)


@rule("GB040", Severity.ERROR, needs=(*REPRODUCIBLE, "GM010", "GI025", "GI006"))
def frames_are_distinct(behaviour: Behaviour) -> Iterator[Violation]:
    """If the manifest declares frames, most frames differ from each other.

    Why:
        The manifest says how many distinct frames there are. A division of whole numbers, or a
        time in another unit than the range, repeats a few of them: the scene seems to stand still.

    Hint:
        Divide in float32, and check the unit of the range and the number of frames.
    """
    runs = _frame_runs(behaviour)
    distinct_digest_count = len({run.digest for run in runs})
    if len(runs) > 2 and 2 * distinct_digest_count <= len(runs):
        actual, hint = f"{distinct_digest_count} of {len(runs)} frames differ", ""
        if distinct_digest_count == 1:
            actual += ": the time has no effect"
            hint = "Export without detaching the time (`.item()`, numpy, its shape alone in use)."
        yield Violation.at(
            _where(behaviour), actual, "distinct frames, as many as declared", hint=hint
        )
