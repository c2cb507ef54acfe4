"""Scene files in elements of pages, and the pictures that Python draws of them."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.runtime.playback.frame_sequence import FrameSequence
from gsgen.runtime.playback.post_process import open_posts
from gsgen.runtime.playback.scene_camera import scene_viewpoint
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.sources.scene_file import open_scene, read_scene
from gsgen.tiles.streaming.tiles_source import open_stream
from support.web.pages import WebSite, float32_result

WIDTH, HEIGHT = 96, 64


def shown(site: WebSite, document: dict[str, Any]) -> Any:
    """Show a scene file in a new element; return its errors, warnings and camera."""
    site.contents["/scene.json"] = json.dumps(document).encode()
    return site.page.evaluate(
        """async () => {
          document.body.replaceChildren();
          const scene = document.createElement("gsgen-scene");
          scene.src = `/scene.json?${Math.random()}`;
          document.body.append(scene);
          await scene.ready.then(() => scene._shown._opening, () => {});
          return { errors: scene.report.errors, warnings: scene.warnings, duration: scene.duration };
        }"""
    )


def picture(page: Any, seconds: float = 0.0) -> np.ndarray:
    """Return what comes of the element's picture at a time: red, green, blue."""
    script = """async ([seconds, width, height]) => {
      const scene = document.querySelector("gsgen-scene");
      scene.currentTime = seconds;
      const { _shown: shown } = scene;
      return shown._aside(async (renderer) => {
        shown.isStale = true;
        const camera = shown.orbit.camera(width, height);
        const tilesets = shown.model.entries.map(({ model }) => model).filter((model) => "loading" in model);
        do {
          // Tiles that a camera lacks are requested by a frame.
          await shown._drawWith(renderer, camera, scene._look(), { isWhole: true });
          while (tilesets.some(({ loading }) => loading)) await new Promise((resolve) => setTimeout(resolve, 20));
          await shown.model.update({}, camera);
        } while (tilesets.some(({ loading }) => loading));
        shown.isStale = true; // the models were updated without the time
        await shown._drawWith(renderer, camera, scene._look(), { isWhole: true });
        const { image } = await shown._process(renderer, camera, scene._look());
        renderer.host.image = () => image; // what is read
        return renderer.readImage("color");
      });
    }"""
    numbers = float32_result(page, script, [seconds, WIDTH, HEIGHT])
    return numbers.reshape(HEIGHT, WIDTH, 4)[..., :3]


def rendered(
    folder: Path, document: dict[str, Any], renderer: Renderer, frames: int = 1
) -> list[np.ndarray]:
    """Return the pictures that `gsgen render` draws of a scene file."""
    path = folder / "scene.json"
    path.write_text(json.dumps(document), "utf-8")
    scene = read_scene(path)
    sources, posts = open_scene(scene, stream=open_stream), open_posts(scene)
    view = scene_viewpoint([scene], None, WIDTH, HEIGHT, None, None)
    sequence = FrameSequence(
        sources,
        view,
        background=scene.background or (0, 0, 0, 1),
        frames=frames,
        post=posts,
        renderer=renderer,
    )
    images = [np.array(sequence.draw(number).rgba[..., :3]) for number in range(frames)]
    for opened in (*sources, *posts):
        opened.close()
    return images


def decibels(first: np.ndarray, second: np.ndarray) -> float:
    return float(-10 * np.log10(np.square(first - second).mean() + 1e-20))
