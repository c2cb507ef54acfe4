"""`--image` and `--image-cameras`: which files are read, in which order, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsgen.conformance.fixtures.valid.scene_inputs import picture_model, posed_picture_model
from gsgen.contract.errors import ConfigInvalid, InputUnreadable
from gsgen.runtime.playback.camera_options import Viewpoint
from gsgen.runtime.playback.frame_sequence import FrameSequence
from gsgen.runtime.playback.input_tracks import require_pictures
from gsgen.runtime.playback.live_playback import LivePlayback
from gsgen.runtime.playback.picture_inputs import picture_files, picture_tracks
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.sources.source import GeneratorSource, StillFrameSource
from support.commands import gsgen_here


def write_picture(path: Path, seed: int = 0, size: tuple[int, int] = (8, 12)) -> Path:
    pixels = np.random.default_rng(seed).integers(0, 256, (*size, 3), np.uint8)
    Image.fromarray(pixels).save(path)
    return path


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    folder = tmp_path / "views"
    folder.mkdir()
    for number in (1, 2, 10):
        write_picture(folder / f"view_{number}.png", number)
    (folder / "notes.txt").write_text("no picture")
    return folder


@pytest.fixture
def source(tmp_path: Path):
    path = tmp_path / "model.onnx"
    picture_model().write(path)
    generator = GeneratorSource(path)
    yield generator
    generator.close()


def names(files: list[Path]) -> list[str]:
    return [file.name for file in files]


def test_a_folder_gives_its_pictures_in_natural_order(pictures: Path):
    expected = ["view_1.png", "view_2.png", "view_10.png"]
    assert names(picture_files([str(pictures)])) == expected
    assert names(picture_files([str(pictures / "view_%d.png")])) == expected


def test_files_are_joined_by_commas_or_by_repeated_options(pictures: Path):
    first, second = pictures / "view_2.png", pictures / "view_1.png"
    assert names(picture_files([f"{first},{second}"])) == ["view_2.png", "view_1.png"]
    assert names(picture_files([str(first), str(second)])) == ["view_2.png", "view_1.png"]


def test_a_comma_in_a_name_of_a_file_is_part_of_the_name(tmp_path: Path):
    path = write_picture(tmp_path / "a,b.png")
    assert picture_files([str(path)]) == [path]


@pytest.mark.parametrize("text", ["missing.png", "a.png,missing.png", "view_%d.jpg", "", ","])
def test_what_names_no_picture_is_refused(text: str, tmp_path: Path):
    write_picture(tmp_path / "a.png")
    parts = [str(tmp_path / part) for part in text.split(",")] if text.strip(",") else [text]
    with pytest.raises(ConfigInvalid, match=r"does not exist|holds no picture|names no picture"):
        picture_files([",".join(parts)])


def test_pictures_become_the_input_in_its_range_over_its_background(tmp_path: Path):
    Image.fromarray(np.zeros((4, 6, 4), np.uint8)).save(tmp_path / "clear.png")
    path = tmp_path / "model.onnx"
    picture_model(range=(-1.0, 1.0), background=(1.0, 0.5, 0.0)).write(path)
    source = GeneratorSource(path)
    (track,) = picture_tracks([str(tmp_path / "clear.png")] * 2, None, [source])
    source.close()
    assert track.values.shape == (2, 3, 4, 6)
    np.testing.assert_array_equal(track.values[0, :, 0, 0], [1, 0, -1])


def test_a_picture_is_turned_upright(tmp_path: Path, source: GeneratorSource):
    pixels = np.random.default_rng(0).integers(0, 256, (4, 6, 3), np.uint8)
    exif = Image.Exif()
    exif[0x0112] = 6  # the camera was turned: rotate by 90° clockwise to see it
    Image.fromarray(np.rot90(pixels)).save(tmp_path / "turned.png", exif=exif)
    (track,) = picture_tracks([str(tmp_path / "turned.png")] * 2, None, [source])
    np.testing.assert_allclose(track.values[0], pixels.transpose(2, 0, 1) / 255, atol=1e-6)


@pytest.mark.parametrize("count", [1, 3])
def test_another_number_of_pictures_is_refused(pictures: Path, source: GeneratorSource, count: int):
    files = ",".join(map(str, picture_files([str(pictures)])[:count]))
    with pytest.raises(ConfigInvalid, match=f"has {count} pictures?, expected 2 for the input"):
        picture_tracks([files], None, [source])


def test_files_that_hold_no_picture_are_refused(tmp_path: Path, source: GeneratorSource):
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"\x89PNG\r\n\x1a\nbroken")
    with pytest.raises(InputUnreadable, match="is not a picture"):
        picture_tracks([str(broken)] * 2, None, [source])
    deep = tmp_path / "deep.png"
    Image.fromarray(np.zeros((4, 6), np.uint16)).save(deep)
    with pytest.raises(InputUnreadable, match="expected 8 bits a channel"):
        picture_tracks([str(deep)] * 2, None, [source])


def test_pictures_without_a_model_that_takes_them_are_refused(pictures: Path, tmp_path: Path):
    rows = np.zeros((1, 10), np.float32)
    np.savez(tmp_path / "still.npz", gaussians=rows, appearance=np.zeros((1, 3), np.float32))
    still = StillFrameSource(tmp_path / "still.npz")
    with pytest.raises(ConfigInvalid, match="no scene is computed from pictures"):
        picture_tracks([str(pictures)], None, [still])


def test_a_model_of_pictures_without_pictures_is_refused(source: GeneratorSource):
    with pytest.raises(
        ConfigInvalid, match="computed from 2 pictures, which are not given"
    ) as error:
        require_pictures([source], [])
    assert "--image 1.png,2.png" in error.value.hint


def test_no_playback_draws_a_model_of_pictures_without_them(source: GeneratorSource):
    """Also of files that are dropped on a window, and of `gsgen bench-render`."""
    for play in (lambda: LivePlayback([source]), lambda: FrameSequence([source], Viewpoint())):
        with pytest.raises(ConfigInvalid, match="computed from 2 pictures, which are not given"):
            play()


def write_cameras(path: Path, names: list[str], size: tuple[int, int]) -> list[Camera]:
    """Write a file of gsgen's own cameras, the first one unturned."""
    cameras = []
    for number, _ in enumerate(names):
        view = np.eye(4)
        view[:3, 3] = (number, 2, 3)
        height, width = size
        camera = Camera(view, fx=20.0, fy=21.0, cx=width / 2, cy=height / 2 + 1, width=width, height=height)  # fmt: skip
        cameras.append(camera)
    frames = [
        {
            "file_path": name,
            "transform_matrix": (
                np.linalg.inv(camera.view) @ np.diag([1.0, -1.0, -1.0, 1.0])
            ).tolist(),
        }
        for name, camera in zip(names, cameras, strict=True)
    ]
    document = {"fl_x": 20.0, "fl_y": 21.0, "cx": size[1] / 2, "cy": size[0] / 2 + 1, "w": size[1], "h": size[0], "frames": frames}  # fmt: skip
    path.write_text(json.dumps(document))
    return cameras


@pytest.fixture
def posed(tmp_path: Path):
    path = tmp_path / "posed.onnx"
    posed_picture_model().write(path)
    generator = GeneratorSource(path)
    yield generator
    generator.close()


def test_cameras_belong_to_the_pictures_of_their_names(tmp_path: Path, posed: GeneratorSource):
    files = [write_picture(tmp_path / name, size=(16, 48)) for name in ("b.png", "a.png")]
    write_cameras(tmp_path / "transforms.json", ["a.png", "c.png", "b.png"], (16, 48))
    tracks = picture_tracks([",".join(map(str, files))], str(tmp_path / "transforms.json"), [posed])
    values = {track.input_name: track.values for track in tracks}
    np.testing.assert_allclose(values["poses"][:, 0, 3], [2, 0], atol=1e-9)
    # 16 × 48 becomes 4 × 6 at a quarter of the size, without 12 columns on either side.
    expected = [[5, 0, 3], [0, 5.25, 2.25], [0, 0, 1]]
    np.testing.assert_allclose(values["lenses"], [expected, expected], atol=1e-9)


def test_cameras_of_other_names_belong_to_the_pictures_in_order(
    tmp_path: Path, posed: GeneratorSource
):
    files = [write_picture(tmp_path / name) for name in ("b.png", "a.png")]
    write_cameras(tmp_path / "transforms.json", ["1.png", "2.png", "3.png"], (8, 12))
    option = [",".join(map(str, files))]
    path = str(tmp_path / "transforms.json")
    tracks = picture_tracks(option, f"{path}#1:3", [posed])
    values = {track.input_name: track.values for track in tracks}
    np.testing.assert_allclose(values["poses"][:, 0, 3], [1, 2], atol=1e-9)
    with pytest.raises(ConfigInvalid, match="has 3 cameras for 2 pictures"):
        picture_tracks(option, path, [posed])


def test_a_camera_of_another_shape_is_refused(tmp_path: Path, posed: GeneratorSource):
    files = [write_picture(tmp_path / name) for name in ("b.png", "a.png")]
    write_cameras(tmp_path / "transforms.json", ["a.png", "b.png"], (40, 40))
    with pytest.raises(ConfigInvalid, match=r"takes pictures of 40×40 pixels, but b\.png has 12×8"):
        picture_tracks([",".join(map(str, files))], str(tmp_path / "transforms.json"), [posed])


def test_cameras_that_the_model_does_not_take_are_refused(tmp_path: Path, source: GeneratorSource):
    files = [write_picture(tmp_path / name) for name in ("b.png", "a.png")]
    write_cameras(tmp_path / "transforms.json", ["a.png", "b.png"], (8, 12))
    option = [",".join(map(str, files))]
    with pytest.raises(ConfigInvalid, match="assumes cameras of its own"):
        picture_tracks(option, str(tmp_path / "transforms.json"), [source])
    with pytest.raises(ConfigInvalid, match="cameras without pictures"):
        picture_tracks([], str(tmp_path / "transforms.json"), [source])


def test_render_and_bake_of_picture_files_agree(pictures: Path, tmp_path: Path):
    model = tmp_path / "model.onnx"
    picture_model().write(model)
    files = ",".join(map(str, picture_files([str(pictures)])[:2]))
    view = ("--camera", "look-at:0,0,-4,0,0,0", "--size", "48x32")
    assert gsgen_here("render", model, "--image", files, *view, "-o", tmp_path / "a.npy").code == 0  # fmt: skip
    assert gsgen_here("bake", model, "--image", files, "-o", tmp_path / "scene.ply").code == 0
    assert gsgen_here("render", tmp_path / "scene.ply", *view, "-o", tmp_path / "b.npy").code == 0  # fmt: skip
    assert gsgen_here("render", model, "--image", f"{files.split(',')[1]},{files.split(',')[0]}", *view, "-o", tmp_path / "c.npy").code == 0  # fmt: skip
    a, b, c = (np.load(tmp_path / name) for name in ("a.npy", "b.npy", "c.npy"))
    np.testing.assert_allclose(a, b, atol=1e-4)
    assert np.abs(a - c).max() > 1e-2


def test_a_model_of_pictures_runs_once_for_the_same_pictures(
    pictures: Path, source: GeneratorSource
):
    files = picture_files([str(pictures)])
    first, second = (
        {track.input_name: track.values for track in picture_tracks([option], None, [source])}
        for option in (f"{files[0]},{files[1]}", f"{files[1]},{files[0]}")
    )
    source.update(None, first)
    version = source.data.rows_version
    copied = {name: values.copy() for name, values in first.items()}
    source.update(None, copied)
    assert source.seconds == 0  # the model was not run
    source.update(None, second)
    assert source.data.rows_version != version


@pytest.mark.parametrize("command", ["render", "bake"])
def test_a_command_without_pictures_says_how_to_give_them(command: str, tmp_path: Path):
    model = tmp_path / "model.onnx"
    picture_model().write(model)
    result = gsgen_here(command, model, "-o", tmp_path / ("a.png" if command == "render" else "a.ply"))  # fmt: skip
    assert result.code == 2
    assert "--image 1.png,2.png" in result.err
