"""Right models from arrays, as raw protobuf messages: every kind, layout and dtype."""

from functools import partial

import numpy as np

from contract.adversarial.case import Draft, right_model
from contract.adversarial.drafts import static
from contract.adversarial.scenes import KINDS, rows, scene, sh_columns

TOOL = "raw protos"

APPEARANCES = [("sh", 0), ("sh", 1), ("sh", 2), ("sh", 3), ("rgb", 0)]


def _static(kind: str, statistics: str, space: str, degree: int, dtype: str) -> Draft:
    return static(scene(kind, statistics, seed=3), space=space, degree=degree, dtype=dtype)


def _padded(kind: str) -> Draft:
    source = scene(kind, seed=5)
    packed, color = rows(source), sh_columns(source, 3)
    packed, color = np.pad(packed, ((0, 16), (0, 0))), np.pad(color, ((0, 16), (0, 0)))
    return static(source, packed=packed, color=color, count=source.count)


def _filled(kind: str, degree: int) -> Draft:
    """float16 harmonics of degree 0 and 2, filled up with zeros to 1 and 3."""
    source = scene(kind, seed=6)
    color = sh_columns(source, degree + 1)
    color[:, 3 * (degree + 1) ** 2 :] = 0
    return static(source, color=color, degree=degree + 1, dtype="float16")


for number, kind in enumerate(KINDS):
    for statistics in ("trained", "synthetic"):
        shift = 2 * number + (statistics == "synthetic")
        space, degree = APPEARANCES[shift % 5]
        right_model(
            f"static_{kind}_{statistics}_{space}{degree}_float32",
            TOOL,
            kind,
            statistics,
            build=partial(_static, kind, statistics, space, degree, "float32"),
        )
    space, degree = (("sh", 1), ("sh", 3), ("rgb", 0))[number % 3]
    right_model(
        f"static_{kind}_trained_{space}{degree}_float16",
        TOOL,
        kind,
        "trained",
        build=partial(_static, kind, "trained", space, degree, "float16"),
    )
right_model("padded_room", TOOL, "room", "trained", build=partial(_padded, "room"))
right_model("half_filled_surface", TOOL, "surface", "trained", build=partial(_filled, "surface", 0))
right_model("half_filled_cloud", TOOL, "cloud", "trained", build=partial(_filled, "cloud", 2))
