"""Concatenates sets of splats of different SH degrees."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32

from gsgen.formats.shared.origins import join_origins
from gsgen.formats.shared.splats import Splats


def join_splats(parts: Sequence[Splats]) -> Splats:
    """Concatenate sets of splats; SH coefficients that a set lacks are zero.

    Different origins become one in the middle.
    """
    if len(parts) == 1:
        return parts[0]
    parts = join_origins(parts)
    count = max(part.sh.shape[1] for part in parts)

    def join(name: str) -> Float32[np.ndarray, "..."]:
        return np.concatenate([getattr(part, name) for part in parts])

    def padded(sh: Float32[np.ndarray, "n k 3"]) -> Float32[np.ndarray, "n l 3"]:
        return np.pad(sh, [(0, 0), (0, count - sh.shape[1]), (0, 0)])

    return Splats(
        position=join("position"),
        rotation=join("rotation"),
        log_scale=join("log_scale"),
        logit_opacity=join("logit_opacity"),
        sh=np.concatenate([padded(part.sh) for part in parts]),
        antialiased=any(part.antialiased for part in parts),
        color_space=parts[0].color_space,
        up=parts[0].up,
        origin=parts[0].origin,
        rounding=max(part.rounding for part in parts),
    )
