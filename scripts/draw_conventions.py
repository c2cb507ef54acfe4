"""Draw the pictures of docs/guides/coordinate-systems-and-cameras.md into docs/assets.

They are made by the renderer itself, so they show what it does. Run it after a change to a
convention or to a picture: .venv/bin/python scripts/draw_conventions.py
"""

import sys
from collections.abc import Callable
from pathlib import Path

from convention_pictures import numbers, projections, spaces
from PIL import Image

from gsgen.runtime.renderer.renderer import Renderer

ASSETS = Path(__file__).parents[1] / "docs" / "assets"
COLORS = 96  # of a palette: pictures of few colours are a fifth as large with one

PICTURES: dict[str, Callable[[Renderer], Image.Image]] = {
    "world-axes.png": spaces.world_axes,
    "camera-axes.png": spaces.camera_axes,
    "matrix-order.png": numbers.matrix_order,
    "clip-depth.png": projections.clip_depth,
    "principal-point.jpg": projections.principal_point,
    "camera-kinds.jpg": projections.camera_kinds,
    "quaternions.png": numbers.quaternions,
    "sh-directions.png": spaces.sh_directions,
}


def main(folder: Path) -> None:
    """Draw all pictures into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    renderer = Renderer(rasteriser="tiles")
    for name, draw in PICTURES.items():
        picture = draw(renderer)
        if name.endswith(".png"):
            picture.quantize(COLORS, dither=Image.Dither.NONE).save(folder / name, optimize=True)
        else:
            picture.save(folder / name, quality=84, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ASSETS)
