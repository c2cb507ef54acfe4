"""Every command that takes a model refuses one whose weights lie outside of its folder."""

import os

import pytest

from gsgen.formats import write_ply
from gsgen.reference_plugins.samples import garden
from support.commands import gsgen_here, measured_gsgen
from support.hostile.model_escapes import (
    COMMANDS,
    REPORTING,
    command_words,
    has_weights_of,
    write_escape,
)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_copies_nothing_from_outside(tmp_path, command):
    escape_case = write_escape(tmp_path, "a path through the parent")
    write_ply(escape_case.inside / "scene.ply", garden(200))
    (escape_case.inside / "out").mkdir()
    ran = gsgen_here(*command_words(command), cwd=escape_case.inside)
    assert ran.code in ((0, 1, 2) if command in REPORTING - {"diff"} else (1, 2, 4)), ran.err
    assert "Traceback" not in ran.out + ran.err
    assert not has_weights_of(escape_case.inside / "out")
    if command not in REPORTING:
        assert not list((escape_case.inside / "out").iterdir())
        assert len(ran.err.strip().splitlines()) <= 3


@pytest.mark.parametrize("command", ["fix", "float16", "bench"])
@pytest.mark.parametrize("name", ["links in a circle", "a name with a zero byte"])
def test_names_that_no_path_can_have_are_refused_in_one_line(tmp_path, command, name):
    escape_case = write_escape(tmp_path, name)
    (escape_case.inside / "out").mkdir()
    ran = gsgen_here(*command_words(command), cwd=escape_case.inside)
    assert ran.code == 4
    assert "GS001" in ran.err
    assert len(ran.err.strip().splitlines()) <= 3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a pipe", "a link to a device", "a link to standard input"])
def test_a_conversion_of_weights_without_end_is_refused_at_once(tmp_path, name):
    escape_case = write_escape(tmp_path, name)
    ran = measured_gsgen("float16", escape_case.model, "-o", tmp_path / "half.onnx")
    assert ran.code == 4
    assert ran.seconds < 10
    assert ran.peak_bytes < 300e6
    assert not (tmp_path / "half.onnx").exists()


@pytest.mark.parametrize("name", ["a.json", "tileset.json", "a.3tz", "a.onnx", "a.ply", "a.glb"])
def test_a_pipe_in_place_of_a_scene_is_refused_without_waiting(tmp_path, name):
    os.mkfifo(tmp_path / name)
    ran = gsgen_here("render", tmp_path / name, "-o", tmp_path / "a.png")
    assert ran.code in (2, 4)
    assert name in ran.err
    assert len(ran.err.strip().splitlines()) <= 4
