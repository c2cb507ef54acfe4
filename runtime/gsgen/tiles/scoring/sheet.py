"""Draws pictures of all levels of detail on one sheet: columns are levels, rows distances."""

__all__ = ["draw_sheet"]

from typing import Any, Final

import numpy as np
from jaxtyping import UInt8

from gsgen.contract.spec.units import MEBIBYTE
from gsgen.tiles.scoring.score import DISTANCES, TilesetScore

_BAR: Final = 18
_GAP: Final = 4


def draw_sheet(score: TilesetScore) -> UInt8[np.ndarray, "h w 3"]:
    """Return a sheet of pictures with SSIM: the scene, then levels of detail, finest first."""
    from PIL import Image, ImageDraw

    levels = {f"level {entry.level}": entry for entry in score.levels}
    columns = ["scene", *reversed(levels)]
    height, width = score.pictures["scene"]["near"].shape[:2]
    size = (len(columns) * (width + _GAP) - _GAP, len(DISTANCES) * (height + _BAR + _GAP) - _GAP)
    sheet: Any = Image.new("RGB", size, (40, 40, 40))
    pen = ImageDraw.Draw(sheet)
    for column, name in enumerate(columns):
        for row, distance in enumerate(DISTANCES):
            x, y = column * (width + _GAP), row * (height + _BAR + _GAP)
            picture = np.rint(score.pictures[name][distance] * 255).astype(np.uint8)
            sheet.paste(Image.fromarray(picture), (x, y + _BAR))
            text = f"{distance}: {score.splats:,} splats"
            if name in levels:
                entry = levels[name]
                text = (
                    f"{name}: {entry.splats:,}, {entry.bytes / MEBIBYTE:.2f} MiB, "
                    f"SSIM {entry.ssim[distance]:.4f}"
                )
            pen.text((x + 4, y + 3), text, fill=(240, 240, 240))
    return np.asarray(sheet)
