"""Declarations of inputs: role, shape, range and default."""

import pytest

from gsgen.contract.spec.manifest import Input
from gsgen.sdk.authoring import inputs


@pytest.mark.parametrize(
    ("entry", "role", "shape", "range", "default"),
    [
        (inputs.view(), "view", (4, 4), None, "identity"),
        (inputs.projection(), "projection", (4, 4), None, "identity"),
        (inputs.camera_position(), "camera_position", (3,), None, "zeros"),
        (inputs.viewport(), "viewport", (2,), None, (1280, 720)),
        (inputs.time(range=(2, 5)), "time", (1,), (2, 5), 2),
        (inputs.frame_index(7), "frame_index", (1,), (0, 6), 0),
        (inputs.appearance_id(7), "appearance_id", (1,), (0, 6), 0),
        (inputs.condition(64), "condition", (64,), (-3, 3), "zeros"),
        (inputs.shape(10), "shape", (10,), (-3, 3), "zeros"),
        (inputs.root_translation(), "root_translation", (3,), (-1, 1), "zeros"),
        (inputs.root_rotation(), "root_rotation", (3,), (-3.1416, 3.1416), "zeros"),
        (inputs.control("glow", range=(0, 2), default=1), "control", (1,), (0, 2), 1),
        (inputs.image(4, (48, 64)), "image", (1, 4, 48, 64), (0, 1), None),
        (inputs.timestep(499), "timestep", (1,), (0, 999), 499),
        (inputs.conditioning(77, 768), "conditioning", (1, 77, 768), (-3, 3), "zeros"),
    ],
    ids=lambda value: value.role if isinstance(value, Input) else "",
)
def test_an_input_is_declared_as_its_role_asks(
    entry: Input, role: str, shape: object, range: object, default: object
) -> None:
    actual = (entry.role, entry.shape, entry.range, entry.default)
    assert actual == (role, shape, range, default)


def test_a_rotation_matrix_has_no_range() -> None:
    entry = inputs.root_rotation(convention="matrix")
    assert (entry.shape, entry.range, entry.default) == ((3, 3), None, "identity")


def test_frames_of_a_time_and_of_an_index_are_kept() -> None:
    entry = inputs.time(loop=True, frames=24, fps=12)
    assert (entry.loop, entry.frames, entry.fps) == (True, 24, 12)
    assert inputs.frame_index(7).frames == 7
