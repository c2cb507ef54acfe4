"""Frames begin where the manifest says, follow each other, and loops close."""

from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures.builders.arrays import f32
from gsgen.conformance.fixtures.builders.moving import (
    SHIFT_NODE,
    drifting_model,
    input_driven_model,
)
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.spec.manifest import Bounds, CountOutput, Input
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validator import validate

FRAMES = 12
# Ways from the time to a row of a table, and the rule that notices.
STEPPED = {
    "floor(time · frames)": ("many = Mul (time, frames) low = Floor (many)", ""),
    "frames − 1": ("many = Mul (time, last) low = Floor (many)", "GB069"),
    "wrapped": ("part = Mod <fmod = 1> (time, one) many = Mul (part, frames) low = Floor (many)",
                "GB069"),
    "rounded": ("many = Mul (time, frames) low = Round (many)", "GB069"),
    "from one": ("many = Mul (time, frames) near = Floor (many) low = Sub (near, one)", "GB006"),
    "clamped early": ("many = Mul (time, frames) near = Floor (many) low = Min (near, early)", "GB006"),
    "in milliseconds": ("small = Mul (time, milli) many = Mul (small, frames) low = Floor (many)", "GB040"),
}  # fmt: skip
# Turns of a loop from time 0 to 1, and whether it closes.
LOOPS = {"whole": (1.0, True), "twice": (2.0, True), "a frame short": (29 / 30, False),
         "a frame long": (31 / 30, False), "in degrees": (180 / np.pi, False)}  # fmt: skip


def rules_broken_by(model: ModelSpec, folder: Path) -> list[str]:
    path = folder / "m.onnx"
    model.write(path)
    findings = validate(path).findings
    return [finding.rule for finding in findings if finding.severity is not Severity.INFO]


# Ways to round time down to 72 frames of 2.4 seconds, and whether float32 shows the one before.
ROUNDED = {
    "share · frames": ("share = Div (time, span) low = Mul (share, frames)", True),
    "time / length": ("low = Div (time, length)", True),
    "and a thousandth": (
        "share = Div (time, span) many = Mul (share, frames) low = Add (many, milli)", False,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ROUNDED)
def test_frames_show_themselves_where_they_begin(name: str, tmp_path: Path) -> None:
    nodes, is_late = ROUNDED[name]
    time = Input(name="time", role="time", range=(0.0, 2.4), default=0.0, frames=72)
    body = (
        f"{nodes} full = Floor (low) kept = Min (full, last) row = Cast <to = 7> (kept) "
        "shift = Gather <axis = 0> (table, row)"
    )
    table = np.linspace(-0.5, 0.5, 72, dtype=np.float32)[:, None].repeat(3, axis=1)
    numbers = {"frames": 72, "last": 71, "span": 2.4, "length": 2.4 / 72, "milli": 1e-3}
    weights = {key: np.array([value], np.float32) for key, value in numbers.items()}
    model = input_driven_model("float[1] time", time, body).with_weights(table=table, **weights)
    assert rules_broken_by(model, tmp_path) == (["GB006"] if is_late else [])


@pytest.mark.parametrize("name", STEPPED)
def test_frames_of_a_table_begin_and_follow_as_declared(name: str, tmp_path: Path) -> None:
    nodes, rule = STEPPED[name]
    time = Input(name="time", role="time", range=(0.0, 1.0), default=0.0, frames=FRAMES)
    body = (
        f"{nodes} kept = Min (low, last) row = Cast <to = 7> (kept) "
        "shift = Gather <axis = 0> (table, row)"
    )
    steps = np.linspace(-0.5, 0.5, FRAMES)[:, None]
    table = np.hstack([steps, np.sin(3 * steps) / 5, np.cos(steps)]).astype(np.float32)
    numbers = {"frames": FRAMES, "last": FRAMES - 1, "early": FRAMES - 2, "one": 1, "milli": 1e-3}
    weights = {key: np.array([value], np.float32) for key, value in numbers.items()}
    model = input_driven_model("float[1] time", time, body).with_weights(table=table, **weights)
    assert rules_broken_by(model, tmp_path)[:1] == ([rule] if rule else [])


def test_a_motion_that_rests_in_the_middle_is_no_table_of_frames(tmp_path: Path) -> None:
    time = Input(name="time", role="time", range=(0.0, 1.0), default=0.0, frames=30)
    body = (
        "rise = Min (time, a) more = Max (time, b) both = Add (rise, more) shift = Mul (both, way)"
    )
    model = input_driven_model("float[1] time", time, body).with_weights(
        a=f32(0.4), b=f32(0.6), way=np.array([0.5, 0.1, 0.2], np.float32)
    )
    assert "GB069" not in rules_broken_by(model, tmp_path)


@pytest.mark.parametrize("name", LOOPS)
def test_a_loop_ends_where_it_starts(name: str, tmp_path: Path) -> None:
    turns, is_closed = LOOPS[name]
    time = Input(name="time", role="time", range=(0.0, 1.0), default=0.0, frames=30, loop=True)
    body = (
        "angle = Mul (time, turns) sine = Sin (angle) cosine = Cos (angle) "
        "place = Concat <axis = 0> (sine, cosine, sine) shift = Mul (place, fifth)"
    )
    model = input_driven_model("float[1] time", time, body).with_weights(
        turns=np.array([2 * np.pi * turns], np.float32), fifth=np.array([0.2], np.float32)
    )
    assert rules_broken_by(model, tmp_path)[:1] == ([] if is_closed else ["GB004"])


def frames_of(rows: np.ndarray) -> ModelSpec:
    """Return a model that shows one row of numbers a frame, by the number of the frame."""
    frame = Input(name="frame", role="frame_index", range=(0, 11), default=0, frames=FRAMES)
    body = "shift = Gather <axis = 0> (table, frame)"
    model = input_driven_model("int32[1] frame", frame, body)
    return model.with_weights(table=np.asarray(rows, np.float32))


def told_of_frames(model: ModelSpec, folder: Path) -> str:
    """Return what the rule of frames reports, with its location."""
    model.write(folder / "m.onnx")
    findings = [f for f in validate(folder / "m.onnx").findings if f.rule == "GB006"]
    return " ".join(f"{finding.where}: {finding.message}" for finding in findings)


def test_frames_by_number_are_told_by_their_role(tmp_path: Path) -> None:
    rows = np.linspace(-0.5, 0.5, FRAMES)[:, None].repeat(3, axis=1)
    told = told_of_frames(frames_of(np.roll(rows, 1, axis=0)), tmp_path)
    assert told.startswith("role frame_index: the first frame is 11 steps")


def test_scenes_that_hold_or_show_nothing_keep_their_order(tmp_path: Path) -> None:
    held = np.random.default_rng(0).uniform(-0.4, 0.4, (FRAMES, 3))
    held[[0, -1, -2, -3]] = 0
    held[1] = held[2]
    model = frames_of(held)
    assert "numbered" not in told_of_frames(model, tmp_path)
    hidden = model.with_weights(opacity=0 * model.weights["opacity"])
    assert "opaque" not in told_of_frames(hidden, tmp_path)


# How opacities follow the frame's number, as nodes from `time`, and whether Gaussians pop.
WINDOWS = {"compared": ("at = Floor (many)", True), "interpolated": ("at = Mul (many, one)", False),
           "shown one by one": ("at = Floor (many) shift = Mul (speed, at)", False)}  # fmt: skip


@pytest.mark.parametrize(("frames", "fps"), [(30, 24.0), (31, 30.0), (30, 60.0)])
@pytest.mark.parametrize("name", WINDOWS)
def test_births_fade(name: str, frames: int, fps: float, tmp_path: Path) -> None:
    """Births of half of the rows in all frames; some of them at the middle one."""
    nodes, pops = WINDOWS[name]
    born = np.where(np.arange(60) < 30, np.arange(60) % frames, -1)[:, None]
    body = f"many = Mul (time, frames) {nodes} age = Sub (at, born) left = Add (age, one) "
    body += "share = Clip (left, none, one) seen = Mul (opacity, share) "
    body += "" if "shift" in nodes else "shift = Mul (speed, time) "
    time = Input(name="time", role="time", range=(0.0, 1.0), default=0.0, frames=frames, fps=fps)
    model = (
        drifting_model(60)
        .replace_text(SHIFT_NODE, body)
        .replace_text("(moved, opacity, spread)", "(moved, seen, spread)")
        .with_manifest(inputs=(time,), bounds=Bounds((-30, -30, -30), (30, 30, 30)))
        .with_outputs(count=CountOutput("num_points", "upper-bound"))
        .with_weights(born=born.astype(np.float32), frames=f32(frames), one=f32(1), none=f32(0))
    )
    assert ("GB073" in rules_broken_by(model, tmp_path)) is pops


@pytest.mark.parametrize(("cut", "pops"), [(60, False), (20, True)])
def test_a_cut_is_no_birth(cut: int, pops: bool, tmp_path: Path) -> None:
    """Some of 60 moving rows are exchanged for others at once, in the middle of the clip."""
    body = "late = Less (half, time) flags = Cast <to = 1> (late) turned = Mul (flags, change) "
    body += "factor = Add (start, turned) seen = Mul (opacity, factor)"
    change = np.where(np.arange(60) < cut, np.where(np.arange(60) % 2, 1, -1), 0)[:, None]
    time = Input(name="time", role="time", range=(0.0, 1.0), default=0.0, frames=30, fps=24.0)
    model = (
        drifting_model(60)
        .replace_text(SHIFT_NODE, f"{body} {SHIFT_NODE}")
        .replace_text("(moved, opacity, spread)", "(moved, seen, spread)")
        .with_manifest(inputs=(time,))
        .with_outputs(count=CountOutput("num_points", "upper-bound"))
        .with_weights(
            half=f32(0.499),
            change=change.astype(np.float32),
            start=(change <= 0).astype(np.float32),
        )
    )
    assert ("GB073" in rules_broken_by(model, tmp_path)) is pops
