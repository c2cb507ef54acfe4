"""Networks and pictures of which the methods' own code was run; the goldens hold its results."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from PIL import Image

from gsgen.contract.probing.picture_probes import synthetic_pictures
from gsgen.reference_plugins.synthetic import write_adain, write_anime_gan, write_fast_neural_style

GOLDENS = Path(__file__).parent / "goldens"
NUMBERS_PER_GOLDEN = 600


@dataclass(frozen=True, slots=True)
class Case:
    """A network, the size of its picture, and how much of the style is shown."""

    method: Literal["fast_neural_style", "anime_gan", "adain"]
    options: dict[str, Any] = field(default_factory=dict)
    size: tuple[int, int] = (32, 48)  # height and width
    amount: float = 1.0
    align_corners: bool = True

    def write(self, folder: Path) -> Path:
        if self.method == "adain":
            Image.fromarray(self.style()).save(folder / "style.png")
            return write_adain(folder, **self.options)
        write = write_anime_gan if self.method == "anime_gan" else write_fast_neural_style
        return write(folder / f"{self.method}.pth", **self.options)

    def image(self) -> np.ndarray:
        pictures = synthetic_pictures((1, 3, *self.size), np.random.default_rng(6))
        return pictures.astype(np.float32)

    def style(self) -> np.ndarray:
        picture = synthetic_pictures((1, 3, 40, 56), np.random.default_rng(7))[0]
        return np.rint(255 * picture).astype(np.uint8).transpose(1, 2, 0)


CASES = {
    "fast_neural_style": Case("fast_neural_style"),
    "fast_neural_style_odd": Case(
        "fast_neural_style", {"is_deprecated": True, "seed": 1}, (33, 46)
    ),
    "anime_gan": Case("anime_gan"),
    "anime_gan_odd": Case("anime_gan", {"seed": 1}, (35, 45)),
    "anime_gan_halves": Case("anime_gan", {"seed": 2}, align_corners=False),
    "adain": Case("adain"),
    "adain_odd": Case("adain", {"seed": 1}, (37, 51), amount=0.4),
}
