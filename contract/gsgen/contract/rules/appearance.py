"""GV, appearance: colours are in range, and coefficients in the order that readers take."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from gsgen.contract.emission import Emission, Rows
from gsgen.contract.finding import Breach, Severity, Where
from gsgen.contract.layout import CULL_OPACITY, OPACITY
from gsgen.contract.rule import rule
from gsgen.contract.spherical_harmonics import degree_of

_COLOR_SLACK = 1e-2

_COLOR = ("GV025", "GO001", "GO002", "GO005", "GO006", "GO007", "GO008")

# Enough rows for a mean; more would only cost time.
_SAMPLE = 1 << 14

# Mean degree of the coefficients' energy. Trained scenes lie below 0.3, since detail falls with
# the degree; a wrong order spreads the constant terms over all degrees and gives 1 or more.
_SUSPECT = 0.5
_CLEARER = 0.4


@rule(
    "GV012",
    "rgb-range",
    Severity.WARNING,
    over="rows",
    fixture="rgb_in_bytes",
    needs=_COLOR,
)
def rgb_range(rows: Rows) -> Iterator[Breach]:
    """Raw RGB lies in [0, 1] in every drawn row.

    Why:
        Values up to 255 are bytes that were not divided, and show as white. Values around zero
        are SH coefficients passed as colours, and show as black.

    Mend:
        Divide bytes by 255; turn the SH constant term into colour as 0.5 + 0.28209479 · f_dc.
    """
    declared, color = rows.emission.declared, rows.color
    if declared is None or declared.space != "rgb" or color is None:
        return
    shown = color[:, :3].astype(np.float32)
    kept = ((shown >= -_COLOR_SLACK) & (shown <= 1 + _COLOR_SLACK)).all(axis=1)
    yield Breach.rows(
        Where(rows.emission.color_place, "rgb"),
        rows.drawn & ~kept,
        shown,
        "0 <= rgb <= 1",
        judged=rows.drawn_count,
        badness=np.nan_to_num(np.abs(shown - 0.5).max(axis=1)),
    )


@rule(
    "GV014",
    "sh-order",
    Severity.WARNING,
    over="emission",
    fixture="sh_channel_major",
    needs=("GV025", "GO005", "GO006", "GO007", "GO008", "GM005"),
)
def sh_order(emission: Emission) -> Iterator[Breach]:
    """SH coefficients stand coefficient by coefficient, red, green and blue innermost.

    Why:
        A 3DGS PLY stores all red coefficients first. Copied as they are, green and blue constants
        are read as view-dependent detail: colours change wildly with every step of the camera.

    Mend:
        Transpose [N, 3, K] to [N, K, 3] before flattening. If the order is right and the scene is
        unusual, ignore this rule.
    """
    declared, rows, color = emission.declared, emission.gaussians, emission.appearance
    if declared is None or declared.space != "sh" or rows is None or color is None:
        return
    if color.shape[1] < 12 or emission.zeros:  # a single coefficient has no order
        return
    step = max(1, emission.count // _SAMPLE)
    live = slice(0, emission.count, step)
    shown = rows[live, OPACITY].astype(np.float32) >= CULL_OPACITY
    sample = color[live][shown].astype(np.float64)
    energy = (
        np.square(sample[np.isfinite(sample).all(axis=1)]).mean(axis=0)
        if len(sample)
        else None
    )
    if energy is None or not energy.sum() > 0:
        return
    spread = {
        name: _mean_degree(energy[slots]) for name, slots in _orders(len(energy)).items()
    }
    stored = spread.pop("coefficient-major")
    name, other = min(spread.items(), key=lambda item: item[1])
    if stored > _SUSPECT and other < _CLEARER * stored:
        saw = (
            f"energy lies at mean degree {stored:.2f} as stored, {other:.2f} if read {name}"
        )
        want = f"a mean degree below {_SUSPECT}, as coefficient-major SH of a scene has"
        yield Breach.at(f"output {declared.name}", saw, want, certainty="possible")


def _orders(size: int) -> dict[str, np.ndarray]:
    """Return, for each order, the slot that holds coefficient k of channel c, as [K, 3]."""
    k = size // 3
    flat = np.arange(size)
    twice = (flat % k) * 3 + flat // k  # interleaved once more, though it already was
    return {
        "coefficient-major": flat.reshape(k, 3),
        "channel-major": flat.reshape(3, k).T,
        "interleaved twice": twice.reshape(k, 3),
    }


def _mean_degree(energy: Float[np.ndarray, "k 3"]) -> float:
    count = len(energy)
    degrees = np.repeat(
        np.arange(degree_of(count) + 1), 2 * np.arange(degree_of(count) + 1) + 1
    )
    return float((energy.sum(axis=1) * degrees).sum() / energy.sum())
