"""Networks and pictures of which the methods' own code was run; the goldens hold its results."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.contract.probing.picture_probes import synthetic_pictures
from gsgen.reference_plugins.enhancers.synthetic_enhancers import Method, write_enhancer

GOLDENS = Path(__file__).parent / "goldens"
NUMBERS_PER_GOLDEN = 600


@dataclass(frozen=True, slots=True)
class Case:
    """A network, and the size of its picture."""

    method: Method
    options: dict[str, Any] = field(default_factory=dict)
    size: tuple[int, int] = (24, 32)  # height and width

    def write(self, folder: Path) -> Path:
        return write_enhancer(folder / f"{self.method}.pth", self.method, **self.options)

    def image(self) -> np.ndarray:
        pictures = synthetic_pictures((1, 3, *self.size), np.random.default_rng(5))
        return pictures.astype(np.float32)


CASES = {
    "rrdb_x4": Case("rrdb"),
    "rrdb_x2": Case("rrdb", {"scale": 2, "seed": 1, "blocks": 3}),
    "rrdb_x1": Case("rrdb", {"scale": 1, "seed": 2, "wrapper": "params"}),
    "compact_x4": Case("compact", {"layers": 4}),
    "compact_x2": Case(
        "compact", {"scale": 2, "width": 16, "seed": 1, "wrapper": "params"}, (21, 33)
    ),
    "swinir_classical": Case("swinir", {"wrapper": "params"}, (21, 33)),
    "swinir_light": Case("swinir", {"scale": 3, "upsampler": "shuffle-once", "seed": 1}),
    "swinir_real": Case("swinir", {"scale": 4, "upsampler": "nearest", "seed": 2}),
    "swinir_real_large": Case(
        "swinir",
        {"upsampler": "nearest", "three_convolutions": True, "depths": (3, 2), "seed": 3},
        (16, 35),
    ),
    "swinir_denoise": Case("swinir", {"scale": 1, "upsampler": "none", "seed": 4}, (27, 30)),
    "swinir_jpeg": Case("swinir", {"scale": 1, "upsampler": "none", "window": 7, "seed": 5}),
    "nafnet": Case("nafnet", {"wrapper": "params"}, (21, 35)),
    "nafnet_deep": Case(
        "nafnet", {"encoder": (1, 1, 2), "decoder": (2, 1, 1), "middle": 2, "seed": 1}
    ),
}
