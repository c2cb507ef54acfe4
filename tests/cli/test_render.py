"""`gsgen render`, as a user runs it."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsgen.conformance.fixtures import find
from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.commands.render import render
from gsgen.runtime.device import Device
from gsgen.runtime.film import Film
from gsgen.runtime.pictures import array_of, picture_of
from gsgen.runtime.renderer import Renderer
from gsgen.runtime.sources import Source, open_source
from gsgen.runtime.viewpoint import viewpoint
from support.commands import gsgen

FRONT = "look-at:0,0,-4,0,0,0"
SMALL = ("--width", "48", "--height", "32")


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(Device.open())


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(0)
    rows = np.zeros((200, 10), np.float32)
    rows[:, :3] = rng.normal(size=(200, 3))
    rows[:, 3], rows[:, [4, 7, 9]] = 0.8, 0.02
    path = tmp_path_factory.mktemp("scene") / "scene.npz"
    np.savez(path, gaussians=rows, appearance=rng.uniform(size=(200, 3)).astype(np.float32))
    return path


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return find("drift").write(tmp_path_factory.mktemp("moving"))


def film(renderer: Renderer, path: Path, **options: object) -> tuple[Film, Source]:
    source = open_source(path)
    words = options.pop("camera", None)
    view = viewpoint(words, width=48, height=32)
    return Film([source], view, renderer=renderer, **options), source


def test_a_picture(file: Path, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out.png"
    done = gsgen("render", str(file), "-o", str(out), *SMALL)
    assert done.code == 0, done.err
    assert "48×32" in done.out
    assert "of 200 Gaussians drawn" in done.out
    with Image.open(out) as image:
        assert (image.size, image.mode) == ((48, 32), "RGBA")
        pixels = np.asarray(image)
    assert (pixels[..., 3] == 255).all()  # black is behind
    assert pixels[..., :3].max() > 60


def test_json_and_floats(file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.npy"
    done = gsgen("render", str(file), "-o", str(out), *SMALL, "--json")
    said = json.loads(done.out)
    assert (said["width"], said["height"], said["gaussians"]) == (48, 32, 200)
    made = np.load(out)
    assert (made.shape, made.dtype) == ((32, 48, 4), np.float32)
    assert made[..., 3].min() < 0.01  # nothing is behind


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("nowhere.ply", "-o", "a.png"), 4, "nowhere.ply: cannot be read"),
        (("nowhere.onnx", "-o", "a.png"), 4, "nowhere.onnx"),
        (("FILE", "-o", "a.xyz"), 2, "suffix that means nothing here: .xyz\n  Known: .png"),
        (("FILE", "-o", "a.png", "--frames", "2"), 2, "is one picture, but there are 2"),
        (("FILE", "-o", "a.png", "--time", "0.5"), 2, "--time: no scene has a time"),
        (("FILE", "-o", "a.png", "--background", "puce"), 2, "'puce' is no colour"),
        (("FILE", "-o", "a.png", "--fov", "180"), 2, "--fov: 180.0 degrees"),
    ],
)
def test_mistakes(
    file: Path, tmp_path: Path, words: tuple[str, ...], code: int, said: str
) -> None:
    given = [str(file) if word == "FILE" else word for word in words]
    done = gsgen("render", *given, cwd=tmp_path)
    assert done.code == code
    assert said in done.err
    assert "Traceback" not in done.err
    assert not list(tmp_path.glob("a.*"))


@pytest.mark.parametrize("color", ["2,0,0", "0,0,nan", "0,0,0,-1", "1,1"])
def test_a_background_is_within_its_range(tmp_path: Path, color: str) -> None:
    with pytest.raises(ConfigInvalid, match="is no colour"):
        render([tmp_path / "any.ply"], tmp_path / "a.png", background=color)


def test_a_generator_is_run_for_every_frame(
    renderer: Renderer, moving: Path, tmp_path: Path
) -> None:
    made, source = film(renderer, moving, frames=3)
    watched: list[int] = []
    made.write(tmp_path / "frames", None, watched.append)
    names = sorted(path.name for path in (tmp_path / "frames").iterdir())
    assert names == ["frame_0000.png", "frame_0001.png", "frame_0002.png"]
    assert watched == [1, 2, 3]
    first, last = (np.asarray(Image.open(tmp_path / "frames" / names[n])) for n in (0, 2))
    assert not np.array_equal(first, last)
    source.close()


def test_time_by_itself_and_through_its_range(renderer: Renderer, moving: Path) -> None:
    still, source = film(renderer, moving, time=1.0, camera=FRONT)
    whole, other = film(renderer, moving, frames=2, camera=FRONT)
    declared = source.time
    assert declared is not None
    loops = bool(declared.loop)
    at_end, half = still.draw(0).rgba, whole.draw(1).rgba
    assert np.array_equal(at_end, half) != loops
    source.close()
    other.close()


def test_an_orbit_turns_where_nothing_has_a_time(renderer: Renderer, file: Path) -> None:
    turning, _ = film(renderer, file, frames=4)
    views = [turning.draw(number).rgba for number in range(4)]
    assert not np.array_equal(views[0], views[2])
    still, _ = film(renderer, file, frames=2, turn=0.0)
    assert np.array_equal(still.draw(0).rgba, still.draw(1).rgba)


def test_a_film_has_every_frame(renderer: Renderer, file: Path, tmp_path: Path) -> None:
    made, _ = film(renderer, file, frames=3)
    made.write(tmp_path / "film.gif", fps=10)
    with Image.open(tmp_path / "film.gif") as image:
        assert image.n_frames == 3
        assert image.info["duration"] == 100
    made.write(tmp_path / "film.npy", None)
    assert np.load(tmp_path / "film.npy").shape == (3, 32, 48, 4)
    made.write(tmp_path / "film.mp4", fps=10)
    assert (tmp_path / "film.mp4").read_bytes()[4:12] == b"ftypisom"


@pytest.mark.parametrize("mode", ["depth", "median-depth", "normal", "alpha"])
def test_modes(renderer: Renderer, file: Path, mode: str) -> None:
    source = open_source(file)
    made = Film([source], viewpoint(None, width=48, height=32), mode, renderer=renderer)
    frame = made.draw(0)
    floats, picture = array_of(frame, mode), picture_of(frame, mode)
    assert floats.shape[:2] == picture.shape[:2] == (32, 48)
    assert picture.dtype == np.uint8
    empty = frame.alpha == 0
    assert empty.any()
    assert not picture[empty].any()
    assert picture.max() > 200
    if mode == "depth":  # near is bright
        finite = np.isfinite(floats)
        assert np.corrcoef(floats[finite], picture[finite])[0, 1] < -0.5


def test_several_scenes_are_one(renderer: Renderer, file: Path, moving: Path) -> None:
    both = [open_source(file), open_source(moving)]
    made = Film(both, viewpoint(None, width=48, height=32), renderer=renderer)
    drawn = made.draw(0)
    assert drawn.visible > 200
    both[1].color_space = "linear"
    with pytest.raises(ConfigInvalid, match="cannot be blended"):
        Film(both, viewpoint(None), renderer=renderer)
    both[1].close()
