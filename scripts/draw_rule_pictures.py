"""Draw the pictures of rules that see a wrong picture, into docs/assets/rules.

The left half of each picture is a right scene, the right half the fixture that breaks the rule;
both are drawn by the renderer itself. Rules whose fault one still picture hardly shows have none. Run it after a change to such a fixture:
.venv/bin/python scripts/draw_rule_pictures.py
"""

import sys
from pathlib import Path

import numpy as np
from convention_pictures.mistakes import draw_mistakes
from convention_pictures.sketch import beside, drawn
from draw_conventions import COLORS
from PIL import Image

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.scenes import Kind, pack, photographed, scene
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData

ASSETS = Path(__file__).parents[1] / "docs" / "assets" / "rules"
SIZE = 240

# Rule → the fixture that breaks it, the kind of the right scene, its rows and its SH degree.
PICTURES: dict[str, tuple[str, Kind, int, int | None]] = {
    "GV040": ("unsquared_scales", "surface", 160, 0),
    "GV041": ("quaternions_in_another_order", "surface", 160, 0),
    "GV042": ("rotation_left_out", "surface", 160, 0),
    "GV043": ("opacity_of_two_sigmoids", "cloud", 160, 0),
    "GV044": ("premultiplied_colors", "surface", 160, None),
    "GV045": ("rgb_as_constant_term", "surface", 160, 0),
    "GV046": ("colors_not_loaded", "surface", 160, 3),
    "GV047": ("colors_sorted_alone", "surface", 400, 1),
    "GV048": ("sh_as_in_ply", "surface", 160, 3),
}


def _drawn(renderer: Renderer, spec: ModelSpec) -> Image.Image:
    """Draw a model without inputs."""
    assert isinstance(spec.manifest, GeneratorManifest)
    rows = spec.weights["rows"].astype(np.float32)
    splats = SplatData(
        rows, spec.weights["colors"].astype(np.float32), spec.manifest.outputs.appearance.space
    )
    low, high = rows[:, :3].min(axis=0), rows[:, :3].max(axis=0)
    middle, radius = (low + high) / 2, 1.1 * float(np.linalg.norm(high - low))
    camera = Camera.orbit(
        middle.tolist(), radius, azimuth=30.0, elevation=20.0, width=SIZE, height=SIZE
    )
    return drawn(renderer, Scene([SplatSet(splats)]), camera)


def main(folder: Path) -> None:
    """Draw all pictures into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    renderer = Renderer(rasteriser="tiles")
    for rule, (fixture, kind, count, degree) in PICTURES.items():
        right = photographed(pack(scene(kind, count), degree))
        halves = [_drawn(renderer, spec) for spec in (right, find(fixture).draw())]
        palette = beside(halves).quantize(COLORS, dither=Image.Dither.NONE)
        palette.save(folder / f"{rule}.png", optimize=True)
    draw_mistakes(renderer, folder.with_name("mistakes"))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ASSETS)
