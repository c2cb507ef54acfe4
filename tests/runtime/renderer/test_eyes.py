"""Two eyes: each sees what its camera alone sees, from one model run, one upload and one sort."""

from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.images import darken
from gsgen.contract.spec.manifest import Space
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.gpu import splat_residency
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.playback.frame_sequence import metres_of_unit
from gsgen.runtime.playback.player import FrameRequest, Player
from gsgen.runtime.playback.post_process import PostProcessor
from gsgen.runtime.renderer import frame_plan
from gsgen.runtime.renderer.frame_arguments import have_one_order
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.eyes import beside, eye_frames, pair_of_eyes
from gsgen.runtime.scene.frame import Frame, Output, psnr
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.sources.placed_source import PlacedSource
from gsgen.runtime.sources.segmented_source import Segment, SegmentedSource
from gsgen.runtime.sources.source import GeneratorSource
from gsgen.sdk.binding import FrameSession
from support.rendering.mesh_scenes import MESH_SCENES
from support.rendering.splat_scenes import SCENES, camera, cloud
from support.rendering.weighted_scenes import celled, summed

ONE_SORT = [
    *("many", "same_depths", "not_finite", "fewer_live_than_rows", "antialiased", "placed"),
    *("principal_point_outside", "far_from_the_origin", "around_the_camera", "none_live_of_some"),
]
LEAST = 60.0  # decibels


def pair(device: Device, way: str) -> tuple[Renderer, Renderer]:
    """Return two renderers of one way to list splats, whose plans do not replace each other."""
    if way == "a GPU's tiles":
        device = Device(device.raw)
        device.subgroups = device.software = False
    result = Renderer(device, rasteriser="tiles"), Renderer(device, rasteriser="tiles")
    for renderer in result:
        renderer._kernels.lists &= way == "lists"
    return result


@pytest.fixture(scope="module")
def renderers(device: Device) -> tuple[Renderer, Renderer]:
    return pair(device, "lists")


def apart(view: Camera, distance: float) -> tuple[Camera, Camera]:
    """Return a camera, and another at its right, of any kind."""
    moved = view.view.copy()
    moved[0, 3] -= distance
    return view, replace(view, view=moved)


def alone(renderer: Renderer, scene: Scene, eyes: tuple[Camera, Camera], *outputs: Output) -> Frame:
    return beside(*(renderer.render(scene, eye, outputs=outputs) for eye in eyes))


def assert_same(actual: Frame, expected: Frame) -> None:
    for eye, single in zip(eye_frames(actual), eye_frames(expected), strict=True):
        assert psnr(eye.rgba, single.rgba) >= LEAST
        if single.ids is not None:
            np.testing.assert_array_equal(eye.ids, single.ids)
            np.testing.assert_allclose(eye.median_depth, single.median_depth, rtol=1e-6)


def assert_one_order(renderers: tuple[Renderer, Renderer], scene: Scene, view: Camera) -> None:
    """Eyes so far apart that many splats are seen by one of them alone."""
    both, single = renderers
    left, right = eyes = apart(view, 0.8)
    frame = both.render(scene, left, outputs=("color", "depth"), right=right)
    assert both._plan.image.eyes == 2
    assert_same(frame, alone(single, scene, eyes, "color", "depth"))


@pytest.mark.parametrize("name", ONE_SORT)
def test_each_eye_sees_what_its_camera_alone_sees(
    renderers: tuple[Renderer, Renderer], name: str
) -> None:
    assert_one_order(renderers, *SCENES[name]())


@pytest.mark.slow
@pytest.mark.parametrize("way", ["lists", "pairs", "a GPU's tiles"])
def test_eyes_by_each_way_to_list_splats(device: Device, way: str) -> None:
    names = ["degree_3", "half_floats", "lens_barrel", "nothing"] if way == "lists" else ONE_SORT
    renderers = pair(device, way)
    for name in names:
        assert_one_order(renderers, *SCENES[name]())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["several", "alone"])
def test_meshes_hide_splats_from_each_eye(renderer: Renderer, name: str) -> None:
    scene, view = MESH_SCENES[name]()
    left, right = eyes = apart(view, 0.3)
    frame = renderer.render(scene, left, right=right)
    assert renderer._plan.image.eyes == 2
    assert_same(frame, alone(renderer, scene, eyes, "color"))


def other_scenes() -> Iterator[tuple[Scene, Camera]]:
    """Scenes whose eyes are sorted one by one: by distance, without perspective, in cells."""
    yield from (SCENES[name]() for name in ("fisheye", "flat_cameras", "panorama"))
    yield Scene([summed(celled(60, 2, 3)), cloud(30)]), camera()


@pytest.mark.slow
def test_what_one_sort_cannot_serve_is_drawn_eye_by_eye(renderer: Renderer) -> None:
    for scene, view in other_scenes():
        left, right = eyes = apart(view, 0.3)
        frame = renderer.render(scene, left, right=right)
        assert renderer._plan.image.eyes == 1
        np.testing.assert_array_equal(frame.rgba, alone(renderer, scene, eyes, "color").rgba)
    scene, view = SCENES["many"]()
    left, right = apart(view, 0.3)
    right = replace(right, view=Camera.orbit((0, 0, 0), 4, azimuth=9).view)  # eyes may converge
    eyes = left, right
    frame = renderer.render(scene, left, outputs=("normal",), right=right)
    np.testing.assert_array_equal(frame.normal, alone(renderer, scene, eyes, "normal").normal)


@pytest.mark.parametrize("kind", ["fisheye", "flat_cameras", "panorama"])
def test_only_eyes_that_see_a_splat_at_one_depth_have_one_order(kind: str) -> None:
    color = frozenset[Output](["color"])
    scene, view = Scene([cloud(3)]), camera()
    left, right = apart(view, 0.3)
    assert have_one_order(scene, left, right, color)
    assert not have_one_order(scene, left, right, color | {"normal"})
    assert not have_one_order(Scene([summed(celled(3, 2, 3))]), left, right, color)
    assert not have_one_order(scene, *apart(SCENES[kind]()[1], 0.3), color)
    behind, turned = right.view.copy(), right.view.copy()
    behind[2, 3] += 1e-3
    turned[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    for other in (replace(right, view=behind), replace(right, view=turned), camera(fx=99.0)):
        assert not have_one_order(scene, left, other, color)


def test_eyes_in_bands_and_with_few_pairs(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Images that exceed a binding, and pairs that exceed their first buffers."""
    scene, view = Scene([cloud(400, size=0.3)]), camera(width=64, height=96)
    renderer = Renderer(device, rasteriser="tiles")
    left, right = apart(view, 0.2)
    renderer._pairs = 256
    expected = renderer.render(scene, left, right=right)
    assert renderer.growths
    monkeypatch.setattr(Renderer, "_band_rows", lambda *_: 32)
    np.testing.assert_array_equal(renderer.render(scene, left, right=right).rgba, expected.rgba)


@pytest.fixture
def drift(tmp_path: Path) -> Iterator[GeneratorSource]:
    source = GeneratorSource(find("drift").write(tmp_path))
    yield source
    source.close()


def stereo(view: Camera, number: int) -> FrameRequest:
    left, right = pair_of_eyes(view, 0.2)
    return FrameRequest(left, ({"time": 0.4 * number},), number, right)


def test_two_eyes_take_one_run_one_upload_and_one_sort(
    renderer: Renderer, drift: GeneratorSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    player = Player([drift], renderer=renderer)
    view = Camera.orbit((0, 0, 0), 4, width=48, height=32)
    player.render(stereo(view, 0))  # buffers are as large as they become
    counts = Counter[str]()

    def counted(owner: object, name: str, label: str) -> None:
        inner = getattr(owner, name)

        def count(*arguments: object, **options: object) -> object:
            counts[arguments[2] if label == "stage" else label] += 1
            return inner(*arguments, **options)

        monkeypatch.setattr(owner, name, count)

    assert not drift.follows_camera
    counted(FrameSession, "update", "run")
    counted(splat_residency, "upload", "upload")
    counted(frame_plan, "run", "stage")
    frame = player.render(stereo(view, 1))
    assert counts["run"] == counts["upload"] == 1  # the rows move, and the colours stay
    assert counts["project"] == counts["sort"] == 1
    assert counts["blend"] == counts["right blend"] == 1
    assert frame.rgba.shape == (32, 96, 4)


def test_played_eyes_equal_eyes_one_by_one(renderer: Renderer, drift: GeneratorSource) -> None:
    view, player = (
        Camera.orbit((0, 0, 0), 4, width=48, height=32),
        Player([drift], renderer=renderer),
    )
    requests = [stereo(view, number) for number in range(3)]
    frames = list(player.play([*requests[:2], replace(requests[2], right=None)]))
    assert [frame.rgba.shape[1] for frame in frames] == [96, 96, 48]
    for frame, request in zip(frames, requests, strict=False):
        single = [
            replace(request, camera=eye, right=None) for eye in (request.camera, request.right)
        ]
        expected = [player.render(eye) for eye in single]
        assert_same(
            frame if frame is not frames[2] else beside(frame, expected[1]), beside(*expected)
        )


def test_a_model_that_takes_the_camera_runs_for_each_eye(
    renderer: Renderer, tmp_path: Path
) -> None:
    """One run for both would show both eyes what only the camera between them sees."""
    with closing(GeneratorSource(find("camera_position").write(tmp_path))) as source:
        player = Player([source], renderer=renderer)
        request = stereo(Camera.orbit((0, 0, 0), 4, width=48, height=32), 0)
        request = replace(request, values=())
        eyes = [replace(request, camera=eye, right=None) for eye in (request.camera, request.right)]
        expected = beside(*map(player.render, eyes))
        np.testing.assert_array_equal(player.render(request).rgba, expected.rgba)
        (played,) = player.play([request])
        np.testing.assert_array_equal(played.rgba, expected.rgba)
        assert source.follows_camera
        middle = Camera.orbit((0, 0, 0), 4, width=48, height=32)
        source.update(middle, {})
        shared = renderer.render(player.scene, request.camera, right=request.right)
        assert psnr(shared.rgba, expected.rgba) < LEAST


class Still(GeneratorSource):
    """A model whose one run serves all cameras."""

    follows_camera = False


def test_the_first_frame_of_a_segment_has_eyes_as_its_own_model_says(
    renderer: Renderer, tmp_path: Path
) -> None:
    path = find("camera_position").write(tmp_path)
    segments = [Segment(path.with_stem(name), 1.0) for name in ("still", "follows")]
    for segment in segments:
        segment.path.write_bytes(path.read_bytes())

    def opened(file: Path) -> GeneratorSource:
        return Still(file) if file.stem == "still" else GeneratorSource(file)

    with closing(GeneratorSource(path)) as single:
        capacity = len(single.data)
    with closing(SegmentedSource("clip", segments, capacity, opened)) as source:
        player = Player([source], renderer=renderer)
        request = stereo(Camera.orbit((0, 0, 0), 4, width=48, height=32), 0)
        moments = [replace(request, values=({"time": time},)) for time in (0.5, 1.5, 0.5)]
        first, second, third = player.play(moments)
        eyes = [
            replace(moments[1], camera=eye, right=None) for eye in (request.camera, request.right)
        ]
        np.testing.assert_array_equal(
            second.rgba, beside(*[next(iter(player.play([eye]))) for eye in eyes]).rgba
        )
        assert psnr(first.rgba, second.rgba) < LEAST
        assert_same(third, first)


def test_post_process_models_see_each_eye_alone(
    renderer: Renderer, drift: GeneratorSource, tmp_path: Path
) -> None:
    darken().write(tmp_path / "darken.onnx")
    with closing(PostProcessor(tmp_path / "darken.onnx")) as model:
        player = Player([drift], post=[model], renderer=renderer)
        request = stereo(Camera.orbit((0, 0, 0), 4, width=50, height=32), 0)
        eyes = [replace(request, camera=eye, right=None) for eye in (request.camera, request.right)]
        assert_same(player.render(request), beside(*map(player.render, eyes)))


@pytest.mark.parametrize(
    ("space", "expected"),
    [
        (None, None),
        (Space(), None),
        (Space(unit="metre"), 1.0),
        (Space(metres_per_unit=0.01), 0.01),
    ],
)
def test_metres_of_a_unit_are_those_that_a_model_declares(
    drift: GeneratorSource, space: Space | None, expected: float | None
) -> None:
    drift.space = space
    assert metres_of_unit([drift]) == expected
    half = PlacedSource(
        drift, np.diag([0.5, 0.5, 0.5, 1])
    )  # a unit of the world is two of the model
    assert metres_of_unit([half]) == (expected and 2 * expected)


def test_eyes_stand_around_the_camera_and_look_its_way() -> None:
    view = Camera.look_at((1, 2, 3), (4, 1, 9))
    left, right = pair_of_eyes(view, 0.5)
    np.testing.assert_allclose((left.eye + right.eye) / 2, view.eye)
    np.testing.assert_allclose(view.view[:3, :3] @ (right.eye - left.eye), [0.5, 0, 0], atol=1e-12)
    np.testing.assert_array_equal(left.view[:3, :3], view.view[:3, :3])
    with pytest.raises(SceneInvalid, match="eye distance"):
        pair_of_eyes(view, 0)
    for other in (view.flattened(2), view.panorama_around(20, 10)):
        with pytest.raises(SceneInvalid, match="expected a pinhole or a fisheye for two eyes"):
            pair_of_eyes(other, 0.1)
