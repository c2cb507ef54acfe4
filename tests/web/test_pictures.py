"""Pictures that chromium draws by the recorded plans, beside those that Python draws."""

from typing import Any

import numpy as np
import pytest

from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Output
from gsgen.runtime.scene.scene import Scene, SplatSet
from support.rendering.near_ties import NEAR_TIES
from support.rendering.splat_scenes import LENSES, SCENES, cloud
from support.web.pages import WebSite, unpacked
from support.web.scenes import camera_of, set_of

pytestmark = pytest.mark.slow


_TOLERANCE = 1e-5


def drawn(site: WebSite, scene: Scene, camera: Camera, **options: Any) -> dict[str, Any]:
    """Draw a scene in the page, and return its images by output."""
    options = {"outputs": ["color"], "background": [0, 0, 0], **options}
    result = site.call(
        "draw",
        {
            "sets": [set_of(splat_set) for splat_set in scene.sets],
            "cameras": [camera_of(camera)],
            **options,
        },
    )
    assert result["errors"] == []
    [frame] = result["frames"]
    shape = (camera.height, camera.width, 4)
    images = {
        name: unpacked(text, np.float32).reshape(shape) for name, text in frame["images"].items()
    }
    return images | {"visible": frame["counts"]["visible"], "deep": frame["deep"]}


def expected(
    renderer: Renderer, scene: Scene, camera: Camera, output: Output = "color", **options: Any
) -> tuple[np.ndarray, int]:
    """Return an image as the kernels leave it in Python's renderer, and the visible Gaussians."""
    drawing = renderer.draw(scene, camera, output=output, **options)
    count = camera.width * camera.height * 4
    words = renderer.device.read(drawing.image, np.float32, count)
    return words.reshape(camera.height, camera.width, 4), drawing.visible


@pytest.mark.parametrize("name", sorted(SCENES.keys() - set(LENSES)))
def test_page_draws_scenes_like_python(name: str, site: WebSite, renderer: Renderer) -> None:
    scene, camera = SCENES[name]()
    image, visible = expected(renderer, scene, camera, background=(0.1, 0.2, 0.3, 1))
    result = drawn(site, scene, camera, background=[0.1, 0.2, 0.3])
    assert result["visible"] == visible
    np.testing.assert_allclose(result["color"], image, atol=_TOLERANCE, rtol=_TOLERANCE)


@pytest.mark.parametrize(
    ("name", "lens"), [("fisheye", "a fisheye"), ("lens_barrel", "distortion")]
)
def test_a_lens_is_refused_by_name(name: str, lens: str, site: WebSite) -> None:
    scene, camera = SCENES[name]()
    with pytest.raises(Exception, match=f"{lens} is not drawn in pages"):
        drawn(site, scene, camera)


@pytest.mark.parametrize("output", ["depth", "normal"])
def test_page_outputs_agree_with_python(output: Output, site: WebSite, renderer: Renderer) -> None:
    scene, camera = SCENES["seen_from_elsewhere"]()
    image, _ = expected(renderer, scene, camera, output)
    result = drawn(site, scene, camera, outputs=[output])[output]
    if output == "depth":  # the third word of a pixel is an id: an integer, not a number
        np.testing.assert_array_equal(result[..., 2].view(np.uint32), image[..., 2].view(np.uint32))
        result, image = np.delete(result, 2, axis=2), np.delete(image, 2, axis=2)
    # Normals come from eigenvalues by cosines, which SwiftShader rounds to some 1e-4.
    tolerance = 2e-4 if output == "normal" else _TOLERANCE
    np.testing.assert_allclose(result, image, atol=tolerance, rtol=tolerance)


def test_colours_and_depths_are_drawn_together(site: WebSite, renderer: Renderer) -> None:
    scene, camera = SCENES["many"]()
    color, _ = expected(renderer, scene, camera)
    depth, _ = expected(renderer, scene, camera, "depth")
    result = drawn(site, scene, camera, outputs=["color", "depth"])
    np.testing.assert_allclose(result["color"], color, atol=_TOLERANCE)
    np.testing.assert_allclose(result["depth"][..., :2], depth[..., :2], atol=_TOLERANCE, rtol=1e-5)


def test_a_frame_that_needs_more_pairs_is_drawn_again(site: WebSite, renderer: Renderer) -> None:
    scene, camera = SCENES["huge"]()
    image, _ = expected(renderer, scene, camera)
    result = drawn(site, scene, camera, pairs=16)
    np.testing.assert_allclose(result["color"], image, atol=_TOLERANCE)


def test_long_ties_take_the_deep_sort(site: WebSite, renderer: Renderer) -> None:
    """Depths that differ by less than their keys resolve are drawn in their order."""
    scene, camera = NEAR_TIES["tilted_less"]()
    image, _ = expected(renderer, scene, camera)
    result = drawn(site, scene, camera)
    assert result["deep"]
    np.testing.assert_allclose(result["color"], image, atol=_TOLERANCE)


@pytest.mark.parametrize("size", [(300, 200), (1030, 17)])
def test_images_of_all_sizes_sort_their_tiles(
    size: tuple[int, int], site: WebSite, renderer: Renderer
) -> None:
    """Sixteen tiles are sorted in one pass, 256 in two, more in three."""
    scene = Scene([cloud(200, 3, degree=1)])
    camera = SCENES["many"]()[1].scaled(*size)
    image, _ = expected(renderer, scene, camera)
    result = drawn(site, scene, camera)
    np.testing.assert_allclose(result["color"], image, atol=_TOLERANCE)


def test_an_image_that_changes_its_size_takes_no_new_buffers(site: WebSite) -> None:
    """A drag through 500 sizes; pictures are those of a renderer that has drawn no other size."""
    scene = Scene([SplatSet(cloud(300, 5, degree=1))])
    rng = np.random.default_rng(3)
    sides = [(150, 110), (40, 30), (149, 109), (33, 64), (150, 1), (1, 110), (96, 97)]
    cameras = [Camera.look_at([0, 0, -5], [0, 0, 0], width=w, height=h) for w, h in sides]
    shrinking = rng.integers(1, [151, 111], (500, 2)).tolist()
    growing = [[16 * i, 12 * i] for i in range(10, 130)]
    result = site.call(
        "drawInSizes",
        {
            "sets": [set_of(splat_set) for splat_set in scene.sets],
            "cameras": [camera_of(camera) for camera in cameras],
            "sizes": shrinking + growing,
        },
    )
    assert result["errors"] == []
    first, *others = result["frames"]
    assert first["created"] > 20
    assert [frame["created"] for frame in others] == [0] * len(others)
    assert sum(result["created"][: len(shrinking)]) == 0
    # Image and ranges of tiles, each with a quarter of room; and digits of a longer sort.
    assert sum(result["created"][len(shrinking) :]) <= 2 * 24 + 10
    for frame, camera in zip(result["frames"], cameras, strict=True):
        image = unpacked(frame["image"], np.float32).reshape(camera.height, camera.width, 4)
        np.testing.assert_array_equal(image, drawn(site, scene, camera)["color"])
