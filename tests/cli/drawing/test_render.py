"""`gsgen render`, as a user runs it."""

import json
import sys
from pathlib import Path
from typing import Never

import numpy as np
import pytest
import typer
from PIL import Image
from typer.testing import CliRunner

from gsgen.cli.commands.drawing.render import render
from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.moving import input_driven_model
from gsgen.contract.errors import ConfigInvalid, GsgenError
from gsgen.contract.spec.manifest import Input
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.media.pictures import array_of, picture_of
from gsgen.runtime.oracle import render as oracle
from gsgen.runtime.playback.camera_options import viewpoint
from gsgen.runtime.playback.frame_sequence import FrameSequence
from gsgen.runtime.playback.input_tracks import Track
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.sources.opening import open_source
from gsgen.runtime.sources.placed_source import PlacedSource
from gsgen.runtime.sources.source import Source
from support.commands import gsgen, gsgen_here

FRONT_CAMERA = "look-at:0,0,-4,0,0,0"
SMALL_SIZE_ARGS = ("--width", "48", "--height", "32")


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(Device.open(), rasteriser="tiles")


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


@pytest.fixture(scope="module")
def places(file: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Files by the words that stand for them."""
    folder = tmp_path_factory.mktemp("places")
    names = {"MODEL": "drift", "POST": "post_process", "BODY": "avatar"}
    result = {word: str(find(name).write(folder)) for word, name in names.items()}
    opened = input_driven_model(
        "float[J,3] pose", Input(name="pose", role="pose"), "shift = ReduceMean (pose)"
    )
    opened.write(folder / "open.onnx")
    return result | {"FILE": str(file), "OPEN": str(folder / "open.onnx")}


def film(renderer: Renderer, path: Path, **options: object) -> tuple[FrameSequence, Source]:
    source = open_source(path)
    words = options.pop("camera", None)
    view = viewpoint(words, width=48, height=32)
    return FrameSequence([source], view, renderer=renderer, **options), source


def test_splat_file_is_rendered_to_png(file: Path, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out.png"
    finished = gsgen("render", str(file), "-o", str(out), *SMALL_SIZE_ARGS)
    assert finished.code == 0, finished.err
    assert "48×32" in finished.out
    assert "of 200 Gaussians drawn" in finished.out
    with Image.open(out) as image:
        assert (image.size, image.mode) == ((48, 32), "RGBA")
        pixels = np.asarray(image)
    assert (pixels[..., 3] == 255).all()  # black is behind
    assert pixels[..., :3].max() > 60


def test_a_generator_without_a_live_row_is_noted(tmp_path: Path) -> None:
    model = find("count_stays_zero").write(tmp_path)
    code, printed, notes = run_render(str(model), "-o", str(tmp_path / "out.png"), *SMALL_SIZE_ARGS)
    assert (code, "0 of 0 Gaussians" in printed) == (0, True)
    assert "no Gaussians with these inputs: --time" in notes


def test_json_summary_and_npy_output(file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.npy"
    _, printed, _ = run_render(str(file), "-o", str(out), *SMALL_SIZE_ARGS, "--json")
    message = json.loads(printed)
    assert (message["width"], message["height"], message["gaussians"]) == (48, 32, 200)
    result = np.load(out)
    assert (result.shape, result.dtype) == ((32, 48, 4), np.float32)
    assert result[..., 3].min() < 0.01  # nothing is behind


def run_render(*words: str) -> tuple[int, str, str]:
    """Run the command in this process; return its exit code, and what it says where."""
    app = typer.Typer()
    app.command()(render)
    finished = CliRunner().invoke(app, list(words))
    if isinstance(finished.exception, GsgenError):  # which the program turns into exit code 2
        return 2, finished.stdout, str(finished.exception)
    assert finished.exception is None or isinstance(finished.exception, SystemExit)
    return finished.exit_code, finished.stdout, finished.stderr


def test_mistake_exits_with_message_in_a_subprocess(tmp_path: Path) -> None:
    finished = gsgen("render", "nowhere.ply", "-o", "a.png", cwd=tmp_path)
    assert finished.code == 4
    assert (
        finished.err == "gsgen: nowhere.ply: the file cannot be read: No such file or directory\n"
    )
    finished = gsgen("render", find("drift").write(tmp_path), "-o", "a.png", "--time", "7")
    assert finished.code == 2
    assert "drift.onnx, frame 0, input time: the value is 7, expected 0 … 1" in finished.err
    assert "Traceback" not in finished.err
    assert not list(tmp_path.glob("a.*"))


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("nowhere.onnx",), 4, "nowhere.onnx"),
        (("FILE", "-o", "a.xyz"), 2, "has the unknown suffix '.xyz'\n  Known: .png"),
        (("FILE", "-o", "a.mov"), 2, "has the unknown suffix '.mov'"),
        (("MODEL", "--time", "0:1:4"), 2, "--time: '0:1:4' is a range, expected one time"),
        (("MODEL", "--time", "0:1:4"), 2, "--input time=0..1 --frames 4"),
        (("MODEL", "--time", "noon"), 2, "--time: 'noon' is not a number, expected a time"),
        (("FILE", "--frames", "2"), 2, "is one picture, expected a video or a folder for 2"),
        (("FILE", "-o", "a.exr", "--frames", "2"), 2, "is one picture, expected a video or a"),
        (("FILE", "--time", "0.5"), 2, "--time: the time is 0.5, but no scene has a time"),
        (("FILE", "--background", "puce"), 2, "'puce' is not a colour"),
        (("FILE", "--fov", "180"), 2, "--fov: is 180.0 degrees"),
        (("FILE", "--turn", "nan"), 2, "--turn: is nan, expected a finite number of degrees"),
        (("MODEL", "--post", "nowhere.onnx"), 4, "nowhere.onnx"),
        (("MODEL", "--post", "MODEL"), 2, "is a gaussian-generator, expected a post-process"),
        (("MODEL", "--post", "POST", "--mode", "alpha", "--input", "x=1"), 2, "input 'x'"),
        (
            ("MODEL", "--post", "POST", "--mode", "depth"),
            2,
            "works on colours, but the output is depth",
        ),
        (
            ("POST",),
            2,
            "expected a gaussian-generator\n  Run post-process models on the drawn frames with `--post`",
        ),
        (("MODEL", "--size", "J=2"), 2, "--size: unknown open dimension 'J'"),
        (
            ("MODEL", "--size", "J"),
            2,
            "--size: the value is 'J', expected SYMBOL=SIZE, such as J=24",
        ),
        (("OPEN",), 2, "Give its size: `--size J=24`"),
        (("MODEL", "--input", "tme=1"), 2, "unknown input 'tme'\n  Did you mean 'time'?"),
        (("MODEL", "--input", "time"), 2, "--input: 'time' has no name or no value\n  Give"),
        (("MODEL", "--input", "time=x"), 2, "'time=x': could not convert"),
        (("MODEL", "--input", "time=no.npy"), 2, "no.npy: cannot be read: No such file"),
        (
            ("MODEL", "--pose", "no.npy"),
            2,
            "--pose no.npy: names the input 'pose', which no scene has",
        ),
        (("BODY", "--pose", "no.npy"), 2, "no.npy: cannot be read: No such file"),
        (("MODEL", "--wsr", "published"), 2, "drift.onnx is not blended by weighted sums"),
        (("BODY", "--input", "pose=1,2"), 2, "has shape [2], expected [4, 3] or [frames, 4, 3]"),
    ],
)
def test_invalid_render_options_are_reported(
    places: dict[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    code: int,
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    inputs = [places.get(word, word) for word in words]
    output_path, _, err = run_render(*inputs, *(() if "-o" in words else ("-o", "a.png")))
    assert message in err
    assert output_path == code
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("color", ["2,0,0", "0,0,nan", "0,0,0,-1", "1,1"])
def test_a_background_is_within_its_range(tmp_path: Path, color: str) -> None:
    with pytest.raises(ConfigInvalid, match="is not a colour"):
        render([tmp_path / "any.ply"], tmp_path / "a.png", background=color)


def test_a_generator_is_run_for_every_frame(
    renderer: Renderer, moving: Path, tmp_path: Path
) -> None:
    result, source = film(renderer, moving, frames=3)
    watched_frames: list[int] = []
    result.write(tmp_path / "frames", watched_frames.append)
    names = sorted(path.name for path in (tmp_path / "frames").iterdir())
    assert names == ["frame_0000.png", "frame_0001.png", "frame_0002.png"]
    assert watched_frames == [1, 2, 3]
    first, last = (np.asarray(Image.open(tmp_path / "frames" / names[n])) for n in (0, 2))
    assert not np.array_equal(first, last)
    source.close()


def test_time_advances_by_itself_or_sweeps_its_range(renderer: Renderer, moving: Path) -> None:
    still_sequence, source = film(renderer, moving, time=1.0, camera=FRONT_CAMERA)
    whole, second = film(renderer, moving, frames=2, camera=FRONT_CAMERA)
    declared = source.time
    assert declared is not None
    loops = bool(declared.loop)
    last_image, half = still_sequence.draw(0).rgba, whole.draw(1).rgba
    assert np.array_equal(last_image, half) != loops
    source.close()
    second.close()


def test_an_orbit_turns_where_nothing_has_a_time(renderer: Renderer, file: Path) -> None:
    turning, _ = film(renderer, file, frames=4)
    views = [turning.draw(number).rgba for number in range(4)]
    assert not np.array_equal(views[0], views[2])
    still_sequence, _ = film(renderer, file, frames=2, turn=0.0)
    assert np.array_equal(still_sequence.draw(0).rgba, still_sequence.draw(1).rgba)


def test_a_film_has_every_frame(renderer: Renderer, file: Path, tmp_path: Path) -> None:
    result, _ = film(renderer, file, frames=3, fps=10)
    result.write(tmp_path / "film.gif")
    with Image.open(tmp_path / "film.gif") as image:
        assert image.n_frames == 3
        assert image.info["duration"] == 100
    result.write(tmp_path / "film.npy")
    assert np.load(tmp_path / "film.npy").shape == (3, 32, 48, 4)
    result.write(tmp_path / "film.mp4")
    assert (tmp_path / "film.mp4").read_bytes()[4:12] == b"ftypisom"


@pytest.mark.parametrize("mode", ["depth", "median-depth", "normal", "alpha"])
def test_every_output_mode_gives_floats_and_a_picture(
    renderer: Renderer, file: Path, mode: str
) -> None:
    source = open_source(file)
    result = FrameSequence([source], viewpoint(None, width=48, height=32), mode, renderer=renderer)
    frame = result.draw(0)
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


def test_several_sources_render_as_one_scene(renderer: Renderer, file: Path, moving: Path) -> None:
    both = [open_source(file), open_source(moving)]
    result = FrameSequence(both, viewpoint(None, width=48, height=32), renderer=renderer)
    drawn = result.draw(0)
    assert drawn.visible > 200
    both[1].color_space = "linear"
    with pytest.raises(ConfigInvalid, match="have linear and sRGB colours"):
        FrameSequence(both, viewpoint(None), renderer=renderer)
    both[1].close()


def test_inputs_are_fed_frame_by_frame(renderer: Renderer, places: dict[str, str]) -> None:
    poses = np.random.default_rng(0).uniform(-0.4, 0.4, (3, 4, 3))
    result, source = film(
        renderer, Path(places["BODY"]), tracks=[Track("pose", poses, "x")], camera=FRONT_CAMERA
    )
    assert result.frames == 3
    visible = [result.draw(number).rgba for number in range(3)]
    second_run, second = film(
        renderer, Path(places["BODY"]), tracks=[Track("pose", poses[2], "x")], camera=FRONT_CAMERA
    )
    assert second_run.frames == 1
    assert np.array_equal(second_run.draw(0).rgba, visible[2])
    assert not np.array_equal(visible[0], visible[2])
    longer, third = film(
        renderer,
        Path(places["BODY"]),
        tracks=[Track("pose", poses, "x")],
        frames=4,
        camera=FRONT_CAMERA,
    )
    assert np.array_equal(longer.draw(3).rgba, visible[0])  # poses begin anew
    for entry in (source, second, third):
        entry.close()


def test_film_equals_its_single_frames(renderer: Renderer, moving: Path, tmp_path: Path) -> None:
    result, source = film(renderer, moving, frames=4)
    result.write(tmp_path / "film.npy")
    alone = [result.draw(number).rgba for number in range(4)]
    assert np.array_equal(np.load(tmp_path / "film.npy"), alone)
    source.close()


def test_orbit_encloses_all_frames_of_a_film(renderer: Renderer, moving: Path) -> None:
    result, source = film(renderer, moving, frames=5)
    center, reach = source.extent()
    visited_cameras = []
    for number in range(5):
        result.draw(number)
        visited_cameras.append(source.data.rows[:, :3])
    assert np.abs(np.concatenate(visited_cameras) - center).max() <= 1.05 * reach
    source.close()
    alone = open_source(moving)
    assert alone.extent()[1] < reach
    alone.close()


def test_an_orbit_turns_where_the_time_stands_still(renderer: Renderer, moving: Path) -> None:
    result, source = film(renderer, moving, frames=4, time=0.5)
    views = [result.draw(number).rgba for number in range(4)]
    assert not np.array_equal(views[0], views[2])
    source.close()


def test_frame_numbers_count_where_there_is_no_time(renderer: Renderer, tmp_path: Path) -> None:
    result, source = film(
        renderer, find("frame_table").write(tmp_path), frames=9, camera=FRONT_CAMERA
    )
    visible = [result.draw(number).rgba for number in range(9)]
    assert not np.array_equal(visible[0], visible[1])
    assert np.array_equal(visible[0], visible[8])  # there are eight
    source.close()


def test_all_render_options_combine(places: dict[str, str], tmp_path: Path) -> None:
    np.save(tmp_path / "walk.npy", np.random.default_rng(0).uniform(-0.4, 0.4, (3, 4, 3)))
    words = ("--pose", "walk.npy", "--input", "root_translation=0.1,0,0", *SMALL_SIZE_ARGS)
    out = Path("new", "folder")
    finished = gsgen(
        "render", places["BODY"], places["FILE"], "-o", out, *words, "--post", places["POST"],
        "--post", places["POST"], "--background", "white", "--json", cwd=tmp_path,
    )  # fmt: skip
    assert finished.code == 0, finished.err
    summary = json.loads(finished.out)
    assert (summary["frames"], summary["frames_in_flight"], summary["redrawn"]) == (3, 2, 0)
    assert summary["waited"] >= 0
    assert summary["growths"] == 0
    pictures = [np.asarray(Image.open(entry)) for entry in sorted((tmp_path / out).iterdir())]
    assert len(pictures) == 3
    assert not np.array_equal(pictures[0], pictures[1])
    assert pictures[0][..., :3].max() == 64  # white, twice half as bright


def test_an_orbit_goes_around_a_moving_model_where_it_stands(
    renderer: Renderer, moving: Path
) -> None:
    location = np.eye(4)
    location[:3, 3] = 5, 0, -2
    reference, source = film(renderer, moving, frames=3)
    placed = PlacedSource(open_source(moving), location)
    FrameSequence([placed], viewpoint(None, width=48, height=32), frames=3, renderer=renderer)
    (center, reach), (expected, expected_reach) = placed.extent(), source.extent()
    np.testing.assert_allclose(center, expected + location[:3, 3])
    assert reach == expected_reach
    assert reference.frames == 3
    for entry in (placed, source):
        entry.close()


def test_an_orbit_leaves_out_what_cannot_be_seen(tmp_path: Path) -> None:
    rows = np.zeros((100, 10), np.float32)
    rows[:, 0] = np.linspace(-1, 1, 100)
    rows[:50, 3] = 0.5
    rows[50:, :3] = 1000
    rows[7, :3] = np.nan
    np.savez(tmp_path / "a.npz", gaussians=rows, appearance=np.ones((100, 3), np.float32))
    center, reach = open_source(tmp_path / "a.npz").extent()
    assert -0.6 < center[0] < -0.4
    assert reach < 1
    rows[:, 3] = 0  # nothing can be seen: all count
    np.savez(tmp_path / "a.npz", gaussians=rows, appearance=np.ones((100, 3), np.float32))
    assert open_source(tmp_path / "a.npz").extent()[1] > 500


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("film.gif", "opaque or absent"),
        ("film.mp4", ".mp4 has no transparency"),
        ("one.jpg", ".jpg has no transparency"),
        ("one.png", ""),
    ],
)
def test_transparency_handling_is_reported(
    file: Path, tmp_path: Path, name: str, message: str
) -> None:
    frames = "3" if name.startswith("film") else "1"
    completed = gsgen_here(
        "render", file, "-o", tmp_path / name, "--background", "transparent",
        "--frames", frames, "--width", "48", "--height", "32",
    )  # fmt: skip
    assert completed.code == 0, completed.err
    assert message in completed.err
    assert bool(completed.err) is bool(message)
    if name.endswith((".gif", ".png")):
        with Image.open(tmp_path / name) as image:
            alpha = np.asarray(image.convert("RGBA"))[..., 3]
        assert alpha.min() == 0 and alpha.max() > 200  # noqa: PT018


def test_both_forms_of_weighted_sums_are_drawn(tmp_path: Path) -> None:
    model = find("weighted_sum").write(tmp_path)
    source, background_color = open_source(model), (0.9, 0.6, 0.3, 1.0)
    scene = Scene([source.splats(None, None)])
    source.close()
    visited_cameras = viewpoint(FRONT_CAMERA, width=48, height=32).camera(source, 0, 0.0)
    result = {}
    for form in ("contract", "published"):
        result[form] = tmp_path / f"{form}.npy"
        words = (
            str(model),
            "-o",
            str(result[form]),
            "--wsr",
            form,
            "--camera",
            FRONT_CAMERA,
            *SMALL_SIZE_ARGS,
        )
        assert run_render(*words, "--background", "0.9,0.6,0.3")[0] == 0
        expected = oracle.render(
            scene, visited_cameras, background=background_color, published=form == "published"
        )
        np.testing.assert_allclose(
            np.load(result[form])[..., :3], expected.rgba[..., :3], atol=2e-5
        )
    assert not np.allclose(*(np.load(entry) for entry in result.values()), atol=1e-2)


def test_the_size_of_the_image_is_one_option(file: Path, tmp_path: Path) -> None:
    completed = gsgen_here("render", file, "-o", tmp_path / "a.png", "--size", "64x48", "--json")
    assert completed.code == 0, completed.err
    assert (json.loads(completed.out)["width"], json.loads(completed.out)["height"]) == (64, 48)
    doubled_output = gsgen_here(
        "render", file, "-o", tmp_path / "b.png", "--size", "64x48", "--width", "9"
    )
    assert doubled_output.code == 2
    assert "the size of the image is given twice" in doubled_output.err


@pytest.mark.parametrize(
    ("output", "missing"),
    [("a.exr", "OpenEXR"), ("a.png", "png"), ("a.mov", "png"), ("dir.gif", "png")],
)
def test_an_output_that_cannot_be_written_is_refused_before_anything_is_opened(
    output: str, missing: str, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "dir.gif").mkdir()
    monkeypatch.setitem(sys.modules, missing, None)
    monkeypatch.setattr("gsgen.cli.commands.drawing.opening.open_scenes", _not_called)
    bits = ("--bits", "16") if output == "a.png" else ()
    finished = gsgen_here("render", file, "-o", output, *bits, cwd=tmp_path)
    assert finished.code == 2, finished.err
    assert [path.name for path in tmp_path.iterdir()] == ["dir.gif"]


def _not_called(*_: object, **__: object) -> Never:
    raise AssertionError("the scenes were opened")


def test_a_film_of_one_frame_is_noted(file: Path, moving: Path, tmp_path: Path) -> None:
    film = ("-o", tmp_path / "film.gif", *SMALL_SIZE_ARGS)
    note = "note: one frame; --frames 100 "
    assert f"{note}makes a turntable\n" in gsgen_here("render", file, *film).err
    assert f"{note}goes through the range" in gsgen_here("render", moving, *film).err
    fixed_camera_run = gsgen_here("render", file, *film, "--camera", FRONT_CAMERA, "--json")
    assert f"{note}makes a turntable with `--camera orbit`" in fixed_camera_run.err
    assert json.loads(fixed_camera_run.out)["frames"] == 1
    assert note not in gsgen_here("render", file, *film, "--frames", "2").err


@pytest.mark.parametrize("command", ["render", "view"])
@pytest.mark.parametrize("size", ["640", "0x0", "x360"])
def test_invalid_size_error_names_the_supported_forms(
    command: str, size: str, file: Path, moving: Path
) -> None:
    output = ("-o", "a.png") if command == "render" else ()
    still = gsgen_here(command, file, *output, "--size", size)
    model = gsgen_here(command, moving, *output, "--size", size)
    assert (still.code, model.code) == (2, 2)
    picture = "expected WIDTHxHEIGHT, such as 640x360"
    assert f"--size: {size!r} is not a size of a picture, {picture}\n" in still.err
    both = "expected SYMBOL=SIZE, such as J=24, or WIDTHxHEIGHT, such as 640x360"
    assert f"--size: the value is {size!r}, {both}" in model.err
