"""scene.json: what it says is what is drawn, and what it cannot mean is named."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
import typer
from PIL import Image

from gsgen.cli.commands.drawing.opening import open_scenes, read_scene_files
from gsgen.conformance.fixtures import find
from gsgen.contract.errors import ConfigInvalid, GsgenError, UnknownName
from gsgen.formats.shared.notices import FormatWarning
from gsgen.runtime.errors import SceneInvalid, SceneUnreadable
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.playback.player import FrameRequest, Player
from gsgen.runtime.playback.post_process import open_posts
from gsgen.runtime.playback.scene_camera import scene_viewpoint
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Box, Scene, SplatSet
from gsgen.runtime.sources.opening import open_source
from gsgen.runtime.sources.placed_source import PlacedSource, local_camera
from gsgen.runtime.sources.scene_file import is_scene_file, open_scene, read_scene
from support.commands import gsgen_here
from support.rendering.splat_scenes import camera, cloud, turned
from support.scene_documents import WRONG, A

STEP = "one_step_enhancer.onnx"
SMALL_SIZE_ARGS = ("--width", "48", "--height", "32")


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(Device.open(), rasteriser="tiles")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two splat files, a generator and a mesh."""
    result = tmp_path_factory.mktemp("parts")
    for name, seed in (("a.npz", 1), ("b.npz", 2)):
        data = cloud(60, seed, degree=2)
        np.savez(result / name, gaussians=data.rows, appearance=data.appearance)
    trimesh.creation.icosphere(subdivisions=1).export(result / "ball.ply")
    find("drift").write(result)
    return result


def saved(folder: Path, **description: object) -> Path:
    path = folder / "scene.json"
    path.write_text(json.dumps(description))
    return path


def test_every_field_of_a_set_is_read(folder: Path) -> None:
    model = {
        "path": "a.npz",
        "translate": [0.1, 0.2, 0.3],
        "rotate": {"axis": [1, 2, 3], "degrees": 40},
        "scale": [1, 2, 3],
        "opacity_scale": 0.5,
        "sh_degree": 1,
        "antialias": "mip",
        "clip": {"low": [-1, -1, 0], "high": [1, 1, 9]},
    }
    (source,) = open_scene(saved(folder, models=[model]))
    splats = source.splats(None, None)
    expected = turned(np.radians(40), (1, 2, 3), (1, 2, 3))
    expected[:3, 3] = 0.1, 0.2, 0.3
    np.testing.assert_allclose(splats.transform, expected, atol=1e-12)
    assert (splats.opacity_scale, splats.degree, splats.antialias) == (0.5, 1, "mip")
    assert splats.clip == Box((-1, -1, 0), (1, 1, 9))
    other = source.splats(2, "classic")  # what options say counts
    assert (other.degree, other.antialias) == (2, "classic")


def test_every_form_of_placement_is_read(folder: Path) -> None:
    half = np.radians(40) / 2
    axis = np.array([1, 2, 3]) / np.sqrt(14)
    models = [
        {"path": "a.npz", "rotate": [3 * np.cos(half), *(3 * np.sin(half) * axis)]},
        {"path": "a.npz", "transform": turned(np.radians(40), (1, 2, 3)).tolist()},
        "a.npz",
    ]
    first, second, third = (
        entry.splats(None, None).transform for entry in open_scene(saved(folder, models=models))
    )
    np.testing.assert_allclose(first, second, atol=1e-12)
    assert np.array_equal(third, np.eye(4))


def test_the_picture_is_that_of_the_scene(folder: Path, renderer: Renderer) -> None:
    moved = np.eye(4)
    moved[:3, 3] = 0.2, 0, 0.5
    path = saved(
        folder,
        gsgen_scene="1.0",
        models=["a.npz", {"path": "b.npz", "transform": moved.tolist()}],
        meshes=[{"path": "ball.ply", "translate": [0, 0, 4], "shading": "unlit"}],
    )
    sources = open_scene(path)
    player = Player(sources, renderer=renderer)
    frame = player.render(FrameRequest(camera()))
    sets = [SplatSet(sources[0].data), SplatSet(sources[1].data, moved)]
    direct = renderer.render(Scene(sets, meshes=sources[2].meshes), camera())
    assert np.array_equal(frame.rgba, direct.rgba)
    assert (frame.alpha == 1).any()  # the ball
    assert sources[2].meshes[0].shading == "unlit"
    np.testing.assert_allclose(sources[2].extent()[0], [0, 0, 4], atol=0.1)


def test_generator_keeps_inputs_of_the_scene_file(folder: Path) -> None:
    model = {"path": "drift.onnx", "inputs": {"time": 0.5}}
    (placed,) = open_scene(saved(folder, models=[model]))
    still = open_source(folder / "drift.onnx")
    still.update(None, {"time": 0.5})
    assert np.array_equal(placed.data.rows, still.data.rows)
    assert placed.time is None  # so that no film moves it
    for source in (placed, still):
        source.close()


def test_moved_model_equals_inversely_moved_camera(renderer: Renderer) -> None:
    """What a moved model shows a camera is what the model shows a camera that is moved back."""
    transform = turned(0.7, (1, 2, 3), 1.5)
    transform[:3, 3] = 0.3, -0.2, 1.0
    data, here = cloud(80, 3, degree=2), camera(fx=30.0, fy=31.0)
    for projection in (here, here.flattened(5.0)):
        frame = renderer.render(Scene([SplatSet(data, transform)]), projection)
        back = renderer.render(Scene([data]), local_camera(projection, transform))
        assert np.abs(frame.rgba - back.rgba).max() < 2e-3
    mirrored = local_camera(here, np.diag([-2.0, 2, 2, 1]))
    assert isinstance(mirrored, Camera)
    assert mirrored.near == pytest.approx(here.near / 2)


def test_what_pages_alone_draw_is_named(folder: Path) -> None:
    path = saved(
        folder,
        models=["a.npz", {"path": "b.npz", "visible": False}],
        meshes=[
            {"path": "ball.ply", "animation": 0, "opacity_scale": 0.5},
            "walk.fbx",
            {"path": "hidden.fbx", "visible": False},
        ],
        annotations=[{"position": [0, 0, 0], "text": "here"}],
    )
    with pytest.warns(FormatWarning) as warned:
        sources = open_scene(path)
    assert [Path(source.name).name for source in sources] == ["a.npz", "ball.ply"]
    assert [str(warning.message).rpartition("not used: ")[2] for warning in warned] == [
        "its animation, which pages alone draw, its opacity, which pages alone draw",
        "the FBX file, which pages alone draw",
        "annotations, which pages alone show",
    ]
    path = saved(folder, models=[{"path": "a.npz", "visible": False}])
    with pytest.raises(SceneInvalid, match="nothing of the scene is drawn here"):
        open_scene(path)


def test_options_override_the_view_of_the_file(folder: Path) -> None:
    message = read_scene(
        saved(folder, models=["a.npz"], camera="orbit:10,20,3", width=64, fov=30, up="+z")
    )
    result = scene_viewpoint([message])
    assert (result.orbit, result.width, result.fov, result.up) == ((10, 20, 3), 64, 30, (0, 0, 1))
    other = scene_viewpoint([message], "orbit:1,2", width=32, fov=70, up="-y")
    assert (other.orbit, other.width, other.fov) == ((1, 2, None), 32, 70)
    own = read_scene(saved(folder, models=["a.npz"], camera=json.loads(camera().to_json())))
    assert scene_viewpoint([own]).cameras == (own.camera,)
    assert scene_viewpoint([own], "orbit").cameras == ()
    flat = read_scene(saved(folder, models=["a.npz"], kind="orthographic"))
    assert scene_viewpoint([flat]).is_orthographic
    assert not scene_viewpoint([flat], panorama=True).is_orthographic
    assert scene_viewpoint([]).fov == 50
    missing_scene = read_scene(saved(folder, models=["a.npz"], camera="absent.json"))
    with pytest.raises(ConfigInvalid, match=r"scene\.json: camera: .*absent\.json"):
        scene_viewpoint([missing_scene])


def test_render_command_draws_a_scene_file(folder: Path, tmp_path: Path) -> None:
    path = saved(
        folder,
        models=["a.npz"],
        meshes=["ball.ply"],
        camera="look-at:0,0,-4,0,0,0",
        background="#102030",
    )
    out = tmp_path / "out.png"
    completed = gsgen_here("render", str(path), "-o", str(out), *SMALL_SIZE_ARGS, "--json")
    assert completed.code == 0, completed.err
    expected_message = json.loads(completed.out)
    assert (expected_message["gaussians"], expected_message["triangles"]) == (60, 80)
    with Image.open(out) as image:
        assert image.getpixel((0, 0)) == (16, 32, 48, 255)
        assert image.getpixel((24, 16))[:3] != (16, 32, 48)


def test_render_command_exit_codes_for_scene_files(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(UnknownName, match="unknown field 'opacty'"):  # 2 by the app
        read_scene_files([saved(folder, models=[{"path": "a.npz", "opacty": 1}])])
    broken = folder / "scene.json"
    broken.write_text("{")
    with pytest.raises(typer.Exit) as unreadable:
        read_scene_files([broken])
    missing_source = saved(folder, models=["gone.ply"])
    with pytest.raises(typer.Exit) as missing_scene, open_scenes([missing_source]):
        pass
    assert unreadable.value.exit_code == missing_scene.value.exit_code == 4
    assert "models[0].path: " in capsys.readouterr().err


@pytest.mark.parametrize("name", WRONG)
def test_invalid_scene_fields_are_named(tmp_path: Path, name: str) -> None:
    message, match = WRONG[name]
    with pytest.raises((SceneInvalid, ConfigInvalid), match=match) as caught:
        read_scene(saved(tmp_path, **message))
    assert caught.value.where.startswith(str(tmp_path / "scene.json"))


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("{", "is not valid JSON: Expecting"),
        ('{"models": [], "models": []}', "'models' occurs twice"),
        ("[" * 100_000, "is not valid JSON"),
        ("\udcff", "cannot be read"),
    ],
)
def test_invalid_json_is_reported(tmp_path: Path, text: str, match: str) -> None:
    path = tmp_path / "scene.json"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    assert is_scene_file(path)
    with pytest.raises(SceneUnreadable, match=match):
        read_scene(path)


def test_source_open_error_names_its_entry(folder: Path) -> None:
    cases: list[tuple[object, type[GsgenError], str]] = [
        ("gone.ply", SceneUnreadable, r"models\[0\]\.path: \S+gone\.ply: the file cannot be read"),
        ("scene.json", SceneInvalid, r"models\[0\]\.path: is a scene file"),
        (A | {"inputs": {"tme": 1}}, UnknownName, r"models\[0\]\.inputs: unknown input 'tme'"),
        (
            {"path": "drift.onnx", "inputs": {"time": 7}},
            GsgenError,
            r"models\[0\]: \S+drift\.onnx, frame 0, input time: the value is 7",
        ),
    ]
    for model, kind, match in cases:
        with pytest.raises(kind, match=match):
            open_scene(saved(folder, models=[model]))
    with pytest.raises(SceneUnreadable, match=r"meshes\[0\]\.path: "):
        open_scene(saved(folder, meshes=["a.npz"]))


def test_other_json_is_no_scene(tmp_path: Path) -> None:
    for name, text in (("meta.json", '{"means": 1}'), ("a.json", "[1]"), ("b.json", "{")):
        (tmp_path / name).write_text(text)
        assert not is_scene_file(tmp_path / name)
    assert not is_scene_file(tmp_path / "absent.json")


@pytest.mark.parametrize(
    "text", ['{"meshes": ["a.glb"]}', '{"models": [', '{"gsgen_scene": "1.0",}']
)
def test_scene_file_is_recognised_by_content(tmp_path: Path, text: str) -> None:
    """What is wrong with a broken one is told in its own words, not in those of splat files."""
    path = tmp_path / "room.json"
    path.write_text(text)
    assert is_scene_file(path)


def test_a_placed_source_closes_what_it_places(folder: Path) -> None:
    inner = open_source(folder / "drift.onnx")
    turn = turned(np.pi / 2, (0, 0, 1), 2)
    turn[:3, 3] = 5, 0, 0
    placed_source = PlacedSource(inner, turn)
    (center, reach), (own_center, own_reach) = placed_source.extent(), inner.extent()
    np.testing.assert_allclose(center, turn[:3, :3] @ own_center + [5, 0, 0])
    assert reach == pytest.approx(2 * own_reach)
    np.testing.assert_allclose(placed_source.up, turn[:3, :3] @ inner.up / 2, atol=1e-12)
    placed_source.update(camera(), {"time": 0.25})
    assert placed_source.data is inner.data
    placed_source.abandon()
    assert placed_source.shape("time") == inner.shape("time")
    placed_source.close()


def test_render_command_runs_the_post_process_models_of_a_scene_file(folder: Path) -> None:
    """In order, those of the option after them; with key frames; and only on colours."""
    find("one_step_enhancer").write(folder)
    find("post_process_any_size").write(folder)  # halves all colours
    view = {"models": ["a.npz"], "camera": "look-at:0,0,-4,0,0,0", "background": "#808080"}

    def drawn(*arguments: str, **fields: object) -> np.ndarray:
        path, out = saved(folder, **view, **fields), folder / "out.npy"
        completed = gsgen_here("render", str(path), "-o", str(out), "--size", "30x21", *arguments)
        assert completed.code == 0, completed.err
        return np.asarray(np.load(out))

    def step(strength: object) -> dict[str, object]:
        return {"path": STEP, "inputs": {"strength": strength}}

    half, options = "post_process_any_size.onnx", ["--post", str(folder / STEP)]
    np.testing.assert_allclose(drawn(posts=[half])[..., :3], drawn()[..., :3] / 2, atol=1e-5)
    by_option = drawn(*options, "--input", "strength=0.002", posts=[half])
    assert np.array_equal(by_option, drawn(posts=[half, step(0.002)]))
    assert not np.array_equal(by_option, drawn(posts=[half, step(0.02)]))
    keys = {"keys": [{"at": 0, "value": 0.002}, {"at": 1, "value": 0.02}]}
    assert np.array_equal(by_option, drawn(posts=[half, step(keys)])[0])
    depth = ("--mode", "depth")
    assert np.array_equal(drawn(*depth, posts=[half]), drawn(*depth))


def test_errors_of_post_process_models_name_their_entry(folder: Path) -> None:
    find("one_step_enhancer").write(folder)
    two = {"keys": [{"at": 0, "value": [1, 2]}, {"at": 1, "value": [1, 2]}]}
    cases: list[tuple[object, str]] = [
        ("gone.onnx", r"posts\[0\]\.path: .*gone\.onnx"),
        ("drift.onnx", r"posts\[0\]\.path: .*is a gaussian-generator, expected a post-process"),
        ({"path": STEP, "inputs": {"strngth": 1}}, r"posts\[0\]\.inputs: unknown input 'strngth'"),
        (
            {"path": STEP, "inputs": {"strength": two}},
            r"inputs\.strength: has 2 numbers, expected 1",
        ),
    ]
    for post, match in cases:
        with pytest.raises(GsgenError, match=match):
            open_posts(read_scene(saved(folder, models=["a.npz"], posts=[post])))
