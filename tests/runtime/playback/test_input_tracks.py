"""Values of inputs as people type them, and what each frame of a film is fed."""

import json
from pathlib import Path

import numpy as np
import pytest

from gsgen.contract.errors import ConfigInvalid, UnknownName
from gsgen.contract.spec.manifest import Input
from gsgen.runtime.playback.input_tracks import Track, input_track
from gsgen.runtime.playback.timeline import Timeline
from gsgen.runtime.sources.key_frames import Animation, Span
from gsgen.runtime.sources.source import named


class AnimatedInputs:
    """Enough of a model: inputs and their shapes."""

    def __init__(self, **shapes: tuple[int, ...]) -> None:
        self.shapes = shapes
        declared = {
            "time": Input(name="time", role="time", range=(0.0, 2.0)),
            "loop": Input(name="loop", role="time", range=(0.0, 2.0), loop=True),
            "still": Input(name="still", role="time"),
            "frame": Input(name="frame", role="frame_index", range=(2.0, 4.0)),
            "amount": Input(name="amount", role="control", range=(0.0, 9.0)),
            "face": Input(name="face", role="expression"),
            "pose": Input(name="pose", role="pose"),
        }
        self.inputs = tuple(declared[name] for name in shapes)
        self.animation: Animation | None = None

    def named(self, word: str) -> list[Input]:
        return named(self.inputs, word)

    def shape(self, name: str) -> tuple[int, ...]:
        return self.shapes[name]


def fed(score: Timeline, name: str, frames: int) -> list[object]:
    result = [score.values(number, frames)[0].get(name) for number in range(frames)]
    return [entry.tolist() if isinstance(entry, np.ndarray) else entry for entry in result]


@pytest.mark.parametrize(
    ("text", "shape", "values"),
    [
        ("x=0.5", (1,), [[0.5]] * 3),
        ("x=3", (1,), [[3]] * 3),
        ("x=1,2.5", (1,), [[1.0], [2.5], [1.0]]),
        ("x=1,2,3", (3,), [[1, 2, 3]] * 3),
        ("x=0..1", (1,), [[0.0], [0.5], [1.0]]),
        ("x=-1..1", (2,), [[-1.0, -1.0], [0.0, 0.0], [1.0, 1.0]]),
        ("x=1e-3", (1,), [[1e-3]] * 3),
    ],
)
def test_typed_values_become_a_track(text: str, shape: tuple[int, ...], values: list) -> None:
    track = input_track(text)
    assert [track.value_at(shape, number, 3).tolist() for number in range(3)] == values
    assert track.input_name == "x"


def test_array_files_become_tracks(tmp_path: Path) -> None:
    inputs = np.random.default_rng(0).normal(size=(2, 4, 3))
    np.save(tmp_path / "a.npy", inputs)
    np.savez(tmp_path / "a.npz", only=inputs)
    (tmp_path / "a.json").write_text(json.dumps(inputs.tolist()))
    for suffix in ("npy", "npz", "json"):
        track = input_track(f"pose={tmp_path / 'a'}.{suffix}")
        assert track.frames((4, 3)) == 2
        np.testing.assert_array_equal(track.value_at((4, 3), 3, 9), inputs[1])
        assert track.frames((2, 4, 3)) == 1
    np.savez(tmp_path / "two.npz", a=inputs, b=inputs)
    with pytest.raises(ConfigInvalid, match="has 2 arrays, expected one"):
        input_track(f"pose={tmp_path / 'two.npz'}")


@pytest.mark.parametrize(
    ("text", "expected_message"),
    [
        ("x", "'x' has no name or no value"),
        ("=1", "has no name or no value"),
        ("x=", "has no name or no value"),
        ("x=a", "could not convert"),
        ("x=1..", "could not convert"),
        ("x=1..2..3", "could not convert"),
        ("x=nowhere.npy", r"nowhere\.npy: cannot be read: No such file"),
    ],
)
def test_invalid_track_text_is_refused(text: str, expected_message: str) -> None:
    with pytest.raises(ConfigInvalid, match=expected_message):
        input_track(text)


def test_values_that_do_not_fill_the_input_are_refused() -> None:
    with pytest.raises(
        ConfigInvalid, match=r"has shape \[4\], expected \[3\] or \[frames, 3\] for input x"
    ):
        input_track("x=1,2,3,4").frames((3,))


def test_unfed_time_inputs_advance_automatically() -> None:
    both = Timeline([AnimatedInputs(time=(1,), loop=(1,), frame=(1,))], [])
    assert both.is_animated
    assert both.frames == 1
    assert fed(both, "time", 5) == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert fed(both, "loop", 4) == [0.0, 0.5, 1.0, 1.5]
    assert fed(both, "frame", 4) == [None] * 4  # times go first
    assert fed(both, "time", 1) == [None]  # one frame is at the default
    assert fed(Timeline([AnimatedInputs(frame=(1,))], []), "frame", 5) == [2, 3, 4, 2, 3]
    assert not Timeline([AnimatedInputs(still=(1,), amount=(1,))], []).is_animated


def test_fixed_time_stops_automatic_inputs() -> None:
    score = Timeline([AnimatedInputs(time=(1,)), AnimatedInputs(amount=(1,))], [], time=0.75)
    assert not score.is_animated
    assert fed(score, "time", 3) == [0.75] * 3
    assert score.values(1, 3)[1] == {}
    with pytest.raises(ConfigInvalid, match=r"--time: the time is 0\.5, but no scene has a time"):
        Timeline([AnimatedInputs(amount=(1,))], [], time=0.5)


def test_tracks_take_precedence_over_automatic_inputs_and_time() -> None:
    track = Track("time", np.asarray([0.1, 0.2]), "x")
    assert fed(Timeline([AnimatedInputs(time=(1,))], [track], time=1.0), "time", 2) == [
        [0.1],
        [0.2],
    ]
    assert fed(Timeline([AnimatedInputs(time=(1,))], [track]), "time", 3) == [[0.1], [0.2], [0.1]]


def test_a_role_reaches_every_input_that_has_it_and_a_name_its_own() -> None:
    takers = [AnimatedInputs(time=(1,), loop=(1,)), AnimatedInputs(time=(1,), amount=(1,))]
    score = Timeline(takers, [Track("time", np.asarray(0.5), "x")])
    first, second = score.values(0, 1)
    assert list(first) == ["time"]  # a tensor of that name comes before the role
    assert list(second) == ["time"]
    score = Timeline(takers, [Track("control", np.asarray(3), "x")])
    assert [list(entry) for entry in score.values(0, 1)] == [[], ["amount"]]
    with pytest.raises(UnknownName, match="unknown input 'amont'") as raised:
        Timeline(takers, [Track("amont", np.asarray(3), "--input amont")])
    assert "Did you mean 'amount'?" in str(raised.value)


def test_the_longest_track_says_how_many_frames_there_are() -> None:
    tracks = [Track("amount", np.zeros(3), "a"), Track("pose", np.zeros((7, 2, 3)), "b")]
    assert Timeline([AnimatedInputs(amount=(1,), pose=(2, 3))], tracks).frames == 7


def test_sweeps_of_indices_are_integers() -> None:
    score = Timeline([AnimatedInputs(frame=(1,))], [input_track("frame=0..3")])
    assert fed(score, "frame", 4) == [[0], [1], [2], [3]]
    assert score.is_animated
    half = Timeline([AnimatedInputs(frame=(1,))], [input_track("frame=0.5")])
    assert fed(half, "frame", 1) == [[0.5]]  # which the model then refuses


def test_on_a_timeline_each_frame_number_lasts_as_long_as_the_others() -> None:
    model = AnimatedInputs(frame=(1,))
    model.animation = Animation(Span(seconds=3.0, loop=True))
    assert fed(Timeline([model], []), "frame", 9) == [2, 2, 2, 3, 3, 3, 4, 4, 4]
    model.animation = Animation(Span(seconds=3.0))
    assert fed(Timeline([model], []), "frame", 4) == [2, 3, 4, 4]
