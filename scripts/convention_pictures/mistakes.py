"""Draws the pictures of the guide on the five commonest mistakes.

The left half of each picture is the right generator, the right half the one with the mistake, as
the blocks of the page define them. ``scripts/draw_rule_pictures.py`` draws them, too.
"""

import importlib
import sys
import tempfile
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from convention_pictures.sketch import beside, drawn
from gsgen.contract.layout import DecodedGaussians, encode
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.sdk import GaussianGenerator, math

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from support.reports.pages import blocks  # noqa: E402  # the path above leads to it

PAGE = ROOT / "docs" / "guides" / "five-commonest-mistakes.md"

# Width and height in pixels, and colours of a palette.
PIXELS, PALETTE = 240, 96
TURN = (0.5, 0.9, 0.3)


def _picture(renderer: Renderer, generator: GaussianGenerator) -> Image.Image:
    camera = Camera.orbit(
        [0.0, 0.0, 0.0], 2.6, azimuth=35.0, elevation=25.0, width=PIXELS, height=PIXELS
    )
    values = {
        "view": torch.tensor(np.asarray(camera.view).T.copy(), dtype=torch.float32),
        "root_rotation": torch.tensor(TURN),
    }
    arguments = [values[entry.role] for entry in generator.inputs]
    with torch.no_grad():
        gaussians = generator(*arguments)
    upper = gaussians.covariance
    if upper is None:
        upper = math.covariance_upper(gaussians.scale, gaussians.rotation)
    rows, colors = encode(
        DecodedGaussians(
            position=gaussians.position.numpy(),
            opacity=gaussians.opacity.numpy().reshape(-1),
            covariance=upper.numpy(),
            sh=None if gaussians.sh is None else gaussians.sh.numpy(),
            rgb=None if gaussians.rgb is None else gaussians.rgb.numpy(),
        ),
        np.float32,
    )
    space = "sh" if gaussians.rgb is None else "rgb"
    return drawn(renderer, Scene([SplatSet(SplatData(rows, colors, space))]), camera)


def draw_mistakes(renderer: Renderer, folder: Path) -> None:
    """Draw all pictures into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as blocks_folder:
        for block in blocks(PAGE):
            (Path(blocks_folder) / block.mark).write_text(block.text, "utf-8")
        sys.path.insert(0, blocks_folder)
        mistakes = importlib.import_module("mistakes").MISTAKES
    for wrong, right in mistakes.items():
        halves = [_picture(renderer, generator()) for generator in (right, wrong)]
        palette = beside(halves).quantize(PALETTE, dither=Image.Dither.NONE)
        palette.save(folder / f"{wrong.__name__}.png", optimize=True)
