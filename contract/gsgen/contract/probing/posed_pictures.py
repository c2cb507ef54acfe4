"""Reads runs of a model of pictures: rows that are drawn in two runs, and the pictures' cameras."""

__all__ = ["PicturePair", "picture_pairs", "read_picture_pair"]

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gsgen.contract._array_types import Bool, Float, Int
from gsgen.contract.causes.picture_cameras import PosedRows
from gsgen.contract.probing.behaviour_probes import PICTURE_CAMERAS
from gsgen.contract.probing.outputs import ModelOutputs, read_outputs
from gsgen.contract.probing.probes import Probe, as_tensor
from gsgen.contract.probing.run_comparison import Behaviour, ProbeRun
from gsgen.contract.spec.layout import CULL_OPACITY, OPACITY, POSITION
from gsgen.contract.spec.manifest import Input

# So many rows with the same outermost coordinate are held there by a clamp.
_MIN_CLAMPED_ROWS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class PicturePair:
    """Two runs of a model of pictures, and the rows that both draw.

    Attributes:
        run: The later run.
        indices: The numbers of the rows in the stored outputs, which may be a part of all.
        outputs: The outputs of the first run.
        base: The rows in the first run, and its cameras.
        other: The rows in the later run, and its cameras.
    """

    run: ProbeRun
    indices: Int[np.ndarray, " n"]
    outputs: ModelOutputs
    base: PosedRows
    other: PosedRows


def picture_pairs(behaviour: Behaviour) -> Iterator[PicturePair]:
    """Yield the base run with each run that differs from it in cameras or lenses of pictures."""
    for run in behaviour.trial_runs(PICTURE_CAMERAS):
        pair = read_picture_pair(behaviour, run)
        if pair is not None:
            yield pair


def read_picture_pair(behaviour: Behaviour, run: ProbeRun) -> PicturePair | None:
    """Return the base run and another one, if both give rows of the same pictures."""
    subject = behaviour.subject
    views = [entry for entry, _ in subject.inputs_of("image_view")]
    images = [entry for entry, _ in subject.inputs_of("image")]
    first, later = (
        read_outputs(subject, entry.probe.label, entry.outputs) for entry in (behaviour.base, run)
    )
    a, b = first.gaussians, later.gaussians
    if not views or not images or a is None or b is None or a.shape != b.shape:
        return None
    if first.count != later.count:
        return None  # rows behind a dropped one are those of other Gaussians
    # As many pixels as rows: Gaussians without opacity were taken from some pixel, too.
    is_drawn = np.minimum(a[:, OPACITY], b[:, OPACITY]) >= CULL_OPACITY
    is_drawn &= np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    is_drawn &= ~(_are_clamped(a, is_drawn) | _are_clamped(b, is_drawn))
    indices = np.flatnonzero(is_drawn[: first.count])
    if not len(indices):
        return None
    posed = [
        _posed_rows(behaviour, entry.probe, rows[indices], views[0], images[0])
        for entry, rows in ((behaviour.base, a), (run, b))
    ]
    return PicturePair(run=run, indices=indices, outputs=first, base=posed[0], other=posed[1])


def _are_clamped(
    rows: Float[np.ndarray, "n 10"], is_drawn: Bool[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Return a mask of rows that a clamp of coordinates holds: they follow nothing.

    Several of them share the largest or the smallest coordinate of an axis, to the last bit.
    """
    position = rows[:, POSITION]
    if not is_drawn.any():
        return ~is_drawn
    ends = np.stack([position[is_drawn].min(axis=0), position[is_drawn].max(axis=0)])
    is_at_end = (position == ends[:, None]) & is_drawn[:, None]
    is_shared = np.count_nonzero(is_at_end, axis=1, keepdims=True) >= _MIN_CLAMPED_ROWS
    return np.asarray((is_at_end & is_shared).any(axis=(0, 2)))


def _posed_rows(
    behaviour: Behaviour, probe: Probe, rows: np.ndarray, view: Input, image: Input
) -> PosedRows:
    space = behaviour.subject.generator.space if behaviour.subject.generator else None
    order = space.matrix_order if space else "column"
    lenses = [entry.name for entry, _ in behaviour.subject.inputs_of("image_intrinsics")]
    height, width = probe.inputs[image.name].shape[-2:]
    return PosedRows(
        position=rows[:, POSITION].astype(np.float64),
        views=np.stack([as_tensor(m, order).astype(np.float64) for m in probe.inputs[view.name]]),
        lenses=probe.inputs[lenses[0]].astype(np.float64) if lenses else None,
        size=(width, height),
    )
