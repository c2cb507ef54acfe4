"""What post-process models are given, and what becomes of what they give."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.arrays import f32
from gsgen.conformance.fixtures.builders.images import darken, enlarge
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.spec.manifest import ImageOutput, PostProcessOutputs
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.playback.player import GeneratorPlayer
from gsgen.runtime.playback.post_process import PostProcessor
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Frame
from gsgen.sdk.binding import InputInvalid

HEIGHT, WIDTH = 21, 30  # no multiple of the example's 8 × 12


def frame(seed: int = 0, *, space: str = "srgb", size: tuple[int, int] = (HEIGHT, WIDTH)) -> Frame:
    """Colours beyond 1 and below 0, and pixels that nothing covers."""
    rng = np.random.default_rng(seed)
    alpha = np.clip(rng.uniform(-0.3, 1.3, size), 0, 1).astype(np.float32)
    straight_color = rng.uniform(-0.2, 1.2, (*size, 3)).astype(np.float32)
    rgba = np.concatenate([straight_color * alpha[..., None], alpha[..., None]], axis=-1)
    return Frame(
        rgba=rgba,
        alpha=alpha,
        depth=None,
        median_depth=None,
        ids=None,
        normal=None,
        visible=5,
        pairs=9,
        color_space=space,
    )


def straight(shown: Frame) -> np.ndarray:
    """The colours as they should be given, in float64."""
    alpha = shown.rgba[..., 3:].astype(np.float64)
    color = np.clip(shown.rgba[..., :3] / np.where(alpha > 0, alpha, 1), 0, 1)
    if shown.color_space == "srgb":
        return color
    low = color <= 0.0031308
    return np.where(low, 12.92 * color, 1.055 * np.maximum(color, 1e-9) ** (1 / 2.4) - 0.055)


def write(folder: Path, spec: ModelSpec, name: str = "model") -> Path:
    path = folder / f"{name}.onnx"
    spec.write(path)
    return path


def declared(
    spec: ModelSpec, *, input_range: tuple, output_range: tuple, space: str = "srgb"
) -> ModelSpec:
    outputs = PostProcessOutputs(ImageOutput("out", range=output_range, color_space=space))
    return replace(spec, manifest=replace(spec.manifest, image_range=input_range, outputs=outputs))


@pytest.mark.parametrize("size", ["8,12", "height,width", "8,width", "40,50"])
@pytest.mark.parametrize("space", ["srgb", "linear"])
def test_straight_colours_are_fed_and_alpha_is_reapplied(
    tmp_path: Path, size: str, space: str
) -> None:
    shown = frame(space=space)
    with PostProcessor(write(tmp_path, darken(size))) as model:
        result = model(shown)
    alpha = shown.rgba[..., 3:]
    np.testing.assert_allclose(result.rgba[..., :3], 0.5 * straight(shown) * alpha, atol=2e-6)
    np.testing.assert_array_equal(result.rgba[..., 3:], alpha)
    assert result.color_space == "srgb"
    assert result.rgba.dtype == np.float32
    assert (result.visible, result.pairs) == (5, 9)
    assert result.alpha is shown.alpha


def test_ranges_and_the_colour_space_are_those_of_the_manifest(tmp_path: Path) -> None:
    spec = darken("height,width").replace_text(
        "out = Mul (image, amount)", "half = Mul (image, amount) out = Add (half, more)"
    )
    spec = spec.with_weights(amount=f32(40.0), more=f32(60.0))
    spec = declared(spec, input_range=(-1, 1), output_range=(10, 110), space="linear")
    shown = frame(1)
    with PostProcessor(write(tmp_path, spec)) as model:
        result = model(shown)
    expected = (40 * (2 * straight(shown) - 1) + 60 - 10) / 100
    alpha = shown.rgba[..., 3:]
    np.testing.assert_allclose(result.rgba[..., :3], expected * alpha, atol=2e-6)
    assert result.color_space == "linear"


def test_a_model_of_four_channels_decides_on_alpha(tmp_path: Path) -> None:
    with PostProcessor(find("post_process_half").write(tmp_path)) as model:
        result = model(shown := frame(2))
    alpha = 0.5 * shown.rgba[..., 3:]
    np.testing.assert_allclose(result.rgba[..., 3:], alpha, atol=1e-3)
    np.testing.assert_allclose(result.rgba[..., :3], 0.5 * straight(shown) * alpha, atol=1e-3)


def test_other_inputs_have_their_defaults_and_can_be_given(tmp_path: Path) -> None:
    shown = frame(3)
    with PostProcessor(find("one_step_enhancer").write(tmp_path)) as model:
        original, weak_result = model(shown).rgba, model(shown, {"strength": 0.0}).rgba
        retained = model(shown).rgba
        assert {entry.role for entry in model.inputs} == {"timestep", "conditioning", "control"}
        assert model.shape("words") == (1, 4)
        with pytest.raises(InputInvalid, match="strength"):
            model(shown, {"strength": 2.0})
    alpha = shown.rgba[..., 3:]
    np.testing.assert_allclose(weak_result[..., :3], 0.5 * straight(shown) * alpha, atol=2e-6)
    np.testing.assert_array_equal(weak_result, retained)
    assert not np.array_equal(original, weak_result)


def test_an_open_model_takes_images_of_other_sizes(tmp_path: Path) -> None:
    with PostProcessor(find("post_process_any_size").write(tmp_path)) as model:
        for size in ((8, 8), (3, 5), (3, 5), (20, 1)):
            shown = frame(4, size=size)
            half = 0.5 * straight(shown) * shown.rgba[..., 3:]
            np.testing.assert_allclose(model(shown).rgba[..., :3], half, atol=2e-6)


@pytest.mark.parametrize(
    ("body", "expected_message"),
    [
        (
            "none = Sub (image, image) out = Div (none, none)",
            "returned 1890 non-finite values of 1890",
        ),
        ("out = ReduceMean <axes = [1], keepdims = 1> (image)", r"returned \[1, 1, 21, 30\] for"),
    ],
)
def test_non_image_outputs_are_refused(tmp_path: Path, body: str, expected_message: str) -> None:
    spec = darken("height,width").replace_text("out = Mul (image, amount)", body)
    spec = replace(spec, opset=13, ir=8, weights={}).replace_text(
        "float[1,3,height,width] out", "float[1,C,height,width] out"
    )
    path = write(tmp_path, spec)
    with PostProcessor(path) as model, pytest.raises(SceneInvalid, match=expected_message):
        model(frame())


def test_other_kinds_of_model_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        SceneInvalid, match=r"expected a post-process model\n.*Pass generators as scenes"
    ):
        PostProcessor(find("drift").write(tmp_path))
    bare = replace(darken(), manifest=None)
    with pytest.raises(SceneInvalid, match="has no manifest"):
        PostProcessor(write(tmp_path, bare))


def test_player_runs_post_process_models_in_order(tmp_path: Path) -> None:
    scene = find("drift").write(tmp_path)
    brightening_model = darken("h,w").replace_text("Mul (image, amount)", "Max (image, amount)")
    paths = [write(tmp_path, darken(), "dark"), write(tmp_path, brightening_model, "floor")]
    camera = Camera.orbit((0, 0, 0), 4, width=WIDTH, height=HEIGHT)
    renderer, white = Renderer(rasteriser="tiles"), (1.0, 1.0, 1.0, 1.0)

    def shown(*post: Path) -> np.ndarray:
        with GeneratorPlayer(
            scene, post=post, provider="cpu", renderer=renderer, background=white
        ) as player:
            return player.render(camera, time=0.5).rgba[..., :3]

    original = np.clip(shown(), 0, 1)
    assert original.min() < 0.9
    np.testing.assert_allclose(shown(*paths), np.full_like(original, 0.5), atol=1e-6)
    np.testing.assert_allclose(shown(*paths[::-1]), 0.5 * np.maximum(original, 0.5), atol=1e-6)
    with pytest.raises(ConfigInvalid, match="works on colours, but the output is depth"):
        GeneratorPlayer(scene, post=paths, provider="cpu", renderer=renderer, outputs=("depth",))


def repeated(image: np.ndarray, scale: int) -> np.ndarray:
    return image.repeat(scale, axis=0).repeat(scale, axis=1)


@pytest.mark.parametrize(
    "size", [("8,12", "16,24"), ("height,width", "twice_height,twice_width"), ("40,50", "80,100")]
)
def test_an_enlarging_model_repeats_pixels_and_interpolates_alpha(
    tmp_path: Path, size: tuple[str, str]
) -> None:
    shown = frame()
    with PostProcessor(write(tmp_path, enlarge(*size))) as model:
        assert model.scale == 2
        result = model(shown)
    alpha = result.rgba[..., 3:]
    expected = repeated(0.5 * straight(shown), 2) * alpha
    np.testing.assert_allclose(result.rgba[..., :3], expected, atol=2e-6)
    assert result.alpha.shape == (2 * HEIGHT, 2 * WIDTH)
    # Between pixel centres alpha is linear: three quarters of the pixel, a quarter of the next.
    padded = np.pad(shown.alpha.astype(np.float64), 1, mode="edge")
    rows = np.stack([0.25 * padded[:-2] + 0.75 * padded[1:-1], 0.75 * padded[1:-1] + 0.25 * padded[2:]], 1)  # fmt: skip
    rows = rows.reshape(2 * HEIGHT, -1)
    both = np.stack([0.25 * rows[:, :-2] + 0.75 * rows[:, 1:-1], 0.75 * rows[:, 1:-1] + 0.25 * rows[:, 2:]], 2)  # fmt: skip
    np.testing.assert_allclose(result.alpha, both.reshape(2 * HEIGHT, 2 * WIDTH), atol=1e-6)


def test_a_model_that_does_not_enlarge_as_declared_is_refused(tmp_path: Path) -> None:
    spec = enlarge("height,width", "twice_height,twice_width")
    outputs = PostProcessOutputs(ImageOutput("out", scale=3))
    path = write(tmp_path, replace(spec, manifest=replace(spec.manifest, outputs=outputs)))
    message = r"returned \[1, 3, 42, 60\] for an image of 21 × 30, expected \[1, 3 or 4, 63, 90\]"
    with PostProcessor(path) as model, pytest.raises(SceneInvalid, match=message):
        model(frame())


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("kind", ["pinhole", "fisheye"])
def test_a_player_draws_fewer_pixels_for_models_that_enlarge(
    tmp_path: Path, count: int, kind: str
) -> None:
    scene, scale = find("drift").write(tmp_path), 2**count
    path = write(
        tmp_path, enlarge("height,width", "twice_height,twice_width").with_weights(amount=f32(1))
    )
    camera = replace(Camera.orbit((0, 0, 0), 4, width=WIDTH, height=HEIGHT), kind=kind)
    # The same pixels, drawn by a camera that is written out.
    small_camera = replace(
        camera,
        fx=camera.fx / scale,
        fy=camera.fy / scale,
        cx=camera.cx / scale,
        cy=camera.cy / scale,
        width=-(-WIDTH // scale),
        height=-(-HEIGHT // scale),
    )
    renderer, white = Renderer(rasteriser="tiles"), (1.0, 1.0, 1.0, 1.0)

    def frames(shown_camera: Camera, *post: Path) -> list[np.ndarray]:
        with GeneratorPlayer(
            scene, post=post, provider="cpu", renderer=renderer, background=white
        ) as player:
            played = list(player.play(shown_camera, times=(0.5, 0.5)))
            return [frame.rgba for frame in (player.render(shown_camera, time=0.5), *played)]

    original = np.clip(frames(small_camera)[0], 0, 1)
    assert original.min() < 0.9
    expected = repeated(original, scale)[:HEIGHT, :WIDTH]
    for result in frames(camera, *[path] * count):
        np.testing.assert_allclose(result, expected, atol=1e-6)


def test_a_panorama_is_drawn_in_whole_pixels(tmp_path: Path) -> None:
    scene = find("drift").write(tmp_path)
    path = find("post_process_enlarging_any_size").write(tmp_path)
    with GeneratorPlayer(scene, post=[path], provider="cpu") as player:
        assert player.render(Camera.panorama((0, 0, -4), width=64)).rgba.shape == (32, 64, 4)
        with pytest.raises(SceneInvalid, match=r"panorama: is 65 × 32, expected multiples of 2"):
            player.render(Camera.panorama((0, 0, -4), width=65))
    with pytest.raises(ConfigInvalid, match="enlarges colours alone, but the outputs are color, d"):
        GeneratorPlayer(scene, post=[path], provider="cpu", outputs=("color", "depth"))
