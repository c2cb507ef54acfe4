"""A generator whose frames never end: what only an interrupt stops."""

from pathlib import Path

import numpy as np

from gsgen.conformance.fixtures.builders.arrays import f32
from gsgen.conformance.fixtures.builders.moving import drifting_model


def endless(folder: Path, after: float) -> Path:
    """Return a generator whose frames never end where the time is beyond ``after``."""
    loop = (
        "moment = ReduceMax <keepdims = 0> (time) still = LessOrEqual (moment, after) "
        "rounds = Where (still, once, most) "
        "on = Loop (rounds, go, time) <body = b (int64 i, bool k, float[1] a) => "
        "(bool k2, float[1] a2) { k2 = Identity (k) a2 = Sin (a) }> shift = Mul (speed, on)"
    )
    spec = drifting_model().replace_text("shift = Mul (speed, time)", loop)
    path = folder / "endless.onnx"
    spec.with_weights(
        after=f32(after),
        once=np.asarray(1, np.int64),
        most=np.asarray(9_000_000_000_000_000_000, np.int64),
        go=np.asarray(True),
    ).write(path)
    return path
