"""Scenes with coordinates of a map are drawn as the same scenes at zero, by every command."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import write_ply
from gsgen.formats.shared.splats import NO_ORIGIN
from support.commands import gsgen_here
from support.far_scenes import FAR_FILES, far_splats, write_scene_file

UTM = (448_262.53, 5_411_932.27, 512.75)
EYE = np.array([2.5, -1.25, -4.0])
SIZE = ("--width", "48", "--height", "40")


def picture(
    folder: Path, scene: Path, target: tuple[float, float, float], *words: str
) -> np.ndarray:
    """Return the picture of a scene from a camera in the coordinates of its file."""
    numbers = ",".join(f"{value:.17g}" for value in (*(EYE + target), *target))
    command = ("render", str(scene), "-o", "a.npy", "--camera", f"look-at:{numbers}", *SIZE, *words)
    completed = gsgen_here(*command, cwd=folder)
    assert completed.code == 0, completed.err
    return np.load(folder / "a.npy")


@pytest.fixture
def expected(tmp_path: Path) -> np.ndarray:
    write_ply(tmp_path / "zero.ply", replace(far_splats(UTM), origin=NO_ORIGIN))
    result = picture(tmp_path, tmp_path / "zero.ply", NO_ORIGIN)
    assert len(np.unique(result.round(2).reshape(-1, result.shape[2]), axis=0)) > 100
    return result


@pytest.mark.parametrize("kind", [*FAR_FILES, "scene file"])
def test_far_scene_is_drawn_as_at_zero(tmp_path, expected, kind):
    write = (FAR_FILES | {"scene file": write_scene_file})[kind]
    actual = picture(tmp_path, write(tmp_path, far_splats(UTM)), UTM)
    np.testing.assert_allclose(actual, expected, atol=5e-3)


@pytest.mark.parametrize("origin", ["448260,5411930,0", "448000.5,5412000.25,-3"])
def test_given_origin_does_not_move_the_picture(tmp_path, expected, origin):
    scene = FAR_FILES["PLY of doubles"](tmp_path, far_splats(UTM))
    actual = picture(tmp_path, scene, UTM, "--origin", origin)
    np.testing.assert_allclose(actual, expected, atol=5e-3)


def test_files_of_different_origins_form_one_scene(tmp_path, expected):
    splats = far_splats(UTM)
    files = []
    for index, rows in enumerate((slice(0, 25), slice(25, None))):
        part = {
            name: getattr(splats, name)[rows]
            for name in ("position", "rotation", "log_scale", "logit_opacity", "sh")
        }
        folder = tmp_path / str(index)
        folder.mkdir()
        files.append(
            FAR_FILES[("PLY of doubles", "GLB, matrix")[index]](folder, replace(splats, **part))
        )
    actual = picture(tmp_path, files[0], UTM, str(files[1]))
    np.testing.assert_allclose(actual, expected, atol=5e-3)


@pytest.mark.parametrize("origin", ["auto", "448262,5411932,512"])
def test_tileset_of_a_far_scene_is_drawn_and_converted_at_its_coordinates(
    tmp_path, expected, origin
):
    scene = FAR_FILES["PLY of doubles"](tmp_path, far_splats(UTM))
    words = ("--engine", "serial", "--codec", "khr", "--origin", origin)
    completed = gsgen_here("tiles", "build", str(scene), "-o", "tiles", *words, cwd=tmp_path)
    assert completed.code == 0, completed.err
    actual = picture(tmp_path, tmp_path / "tiles" / "tileset.json", UTM)
    np.testing.assert_allclose(actual, expected, atol=5e-3)
    assert gsgen_here("convert", "tiles", "b.ply", cwd=tmp_path).code == 0
    np.testing.assert_allclose(picture(tmp_path, tmp_path / "b.ply", UTM), expected, atol=5e-3)


def test_invalid_origin_on_the_command_line_exits_2(tmp_path):
    scene = FAR_FILES["PLY of doubles"](tmp_path, far_splats(UTM))
    for words in (("render", "-o", "a.png"), ("convert", "a.ply"), ("tiles", "build", "-o", "t")):
        command = [*words[:2], str(scene), *words[2:]] if words[0] == "tiles" else [
            words[0], str(scene), *words[1:],
        ]  # fmt: skip
        completed = gsgen_here(*command, "--origin", "there", cwd=tmp_path)
        assert completed.code == 2
        assert "expected auto or X,Y,Z" in completed.err
