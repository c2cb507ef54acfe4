"""Flags of splat files follow the splats into sets and scenes."""

import pytest

from gsgen.runtime import SceneInvalid
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from support.splat_files import scene


def test_flags_of_a_file_are_the_defaults_of_its_set_and_scene():
    data = SplatData.from_splats(scene(3, 0, antialiased=True, color_space="linear"))
    drawn = Scene([data])
    assert (drawn.sets[0].antialias, drawn.color_space) == ("mip", "linear")
    original = Scene([SplatData.from_splats(scene(3, 0))])
    assert (original.sets[0].antialias, original.color_space) == ("classic", "srgb")
    assert Scene([]).color_space == "srgb"


def test_caller_options_override_file_flags():
    data = SplatData.from_splats(scene(3, 0, antialiased=True, color_space="linear"))
    drawn = Scene([SplatSet(data, antialias="classic")], "srgb")
    assert (drawn.sets[0].antialias, drawn.color_space) == ("classic", "srgb")


def test_two_colour_spaces_are_not_blended():
    sets = [
        SplatData.from_splats(scene(3, 0, color_space=space))  # type: ignore[arg-type]
        for space in ("linear", "srgb")
    ]
    with pytest.raises(SceneInvalid, match="cannot be blended"):
        Scene(sets)
    assert Scene(sets, "linear").color_space == "linear"
