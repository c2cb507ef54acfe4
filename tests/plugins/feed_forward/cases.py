"""Checkpoints and pictures of which the methods' own code was run; the goldens hold its results."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.contract.probing.picture_probes import synthetic_pictures
from gsgen.contract.spec.geometry import look_at
from gsgen.reference_plugins.feed_forward import lgm_plugin, splatter_image_plugin
from gsgen.reference_plugins.synthetic import write_lgm, write_splatter_image
from gsgen.sdk import GaussianGenerator

GOLDENS = Path(__file__).parent / "goldens"
ROWS_PER_GOLDEN = 64


@dataclass(frozen=True, slots=True)
class Case:
    """A checkpoint, and the inputs of its generator.

    Attributes:
        method: ``splatter_image`` or ``lgm``.
        options: Arguments of the checkpoint's writer.
        pictures: Number of pictures.
        side: Pixels of a side of a picture.
        has_lens: Whether focal lengths are an input.
    """

    method: str
    options: dict[str, Any] = field(default_factory=dict)
    pictures: int = 1
    side: int = 16
    has_lens: bool = False

    def write(self, folder: Path) -> Path:
        if self.method == "lgm":
            return write_lgm(folder, **self.options)
        options = {"side": self.side, "pictures": self.pictures, **self.options}
        return write_splatter_image(folder, **options)

    def generator(self, folder: Path) -> GaussianGenerator:
        if self.method == "lgm":
            return lgm_plugin.build(folder, self.side)
        return splatter_image_plugin.build(folder)

    def images(self) -> np.ndarray:
        shape = (self.pictures, 3, self.side, self.side)
        return synthetic_pictures(shape, np.random.default_rng(3)).astype(np.float32)

    def views(self) -> np.ndarray:
        """World to camera, the first one unturned: the methods' own code works in its frame."""
        eyes = [np.array([np.sin(0.7 * k), -0.3 * k, 1.5 - np.cos(0.7 * k)]) for k in range(self.pictures)]  # fmt: skip
        middle, up = np.array([0.0, 0.0, 1.5]), np.array([0.0, -1.0, 0.0])
        views = [np.eye(4), *(look_at(eye, middle, up) for eye in eyes[1:])]
        return np.stack(views).astype(np.float32)

    def focals(self) -> np.ndarray | None:
        if not self.has_lens:
            return None
        return np.array([[20.0 + k, 22.0] for k in range(self.pictures)], np.float32)

    def inputs(self) -> list[np.ndarray]:
        """The generator's inputs, in order."""
        if self.method == "lgm":
            return [self.images()]
        arrays = [self.images(), self.views().swapaxes(1, 2)]
        focals = self.focals()
        if focals is not None:
            matrices = np.tile(np.eye(3, dtype=np.float32), (self.pictures, 1, 1))
            matrices[:, 0, 0], matrices[:, 1, 1] = focals.T
            matrices[:, :2, 2] = self.side / 2
            arrays.append(matrices)
        return arrays


CASES = {
    "splatter_image_cars": Case("splatter_image"),
    "splatter_image_two_views": Case("splatter_image", {"seed": 1}, pictures=2),
    "splatter_image_hydrants": Case(
        "splatter_image", {"category": "hydrants", "blocks": 2, "seed": 2}, has_lens=True
    ),
    "splatter_image_isotropic": Case(
        "splatter_image",
        {"options": {"model.isotropic": True, "model.max_sh_degree": 0}, "seed": 3},
    ),
    "splatter_image_on_rays": Case(
        "splatter_image",
        {
            "options": {"model.network_with_offset": False, "model.network_without_offset": True},
            "seed": 4,
        },
    ),
    "lgm_small": Case("lgm", pictures=4),
    "lgm_deep": Case(
        "lgm",
        {"down": (32, 32, 64, 64), "up": (64, 64), "attention": 2, "seed": 1},
        pictures=4,
        side=32,
    ),
}
