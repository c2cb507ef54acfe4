"""How far predicted cameras are from those of a path, and how many of its tiles they see."""

__all__ = ["PredictionError", "prediction_error"]

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from gsgen.contract.spec.geometry import quaternion_product, rotation_vector
from gsgen.tiles.prediction.poses import Pose, interpolate
from gsgen.tiles.prediction.predictor import Predictor
from gsgen.tiles.prediction.prefetch import HORIZON_FRACTIONS, PREDICTION_HORIZON, ViewSettings
from gsgen.tiles.selection.cut import cut_tree
from gsgen.tiles.selection.tile_tree import TileTree

_STEP_SECONDS: Final = 0.5  # between the moments of the path that are looked at


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PredictionError:
    """The errors of a predictor along a path; NaN where nothing was predicted.

    Attributes:
        ade: Mean distance of predicted positions, over all predicted moments, in scene units.
        fde: The same at the end of the horizon.
        turn: Mean angle between predicted and actual rotation at the end of the horizon, in degrees.
        coverage: Share of the tiles wanted at the end of the horizon that predicted cameras see.
    """

    ade: float
    fde: float
    turn: float
    coverage: float


def prediction_error(
    tree: TileTree, path: Sequence[Pose], predictor: Predictor, view: ViewSettings
) -> PredictionError:
    """Compare the cameras that a predictor predicts along a path with those of the path."""
    reach = min(PREDICTION_HORIZON, predictor.reach)
    moments = [reach * share for share in HORIZON_FRACTIONS]
    distances, turns, shares = [], [], []
    next_time = path[0].time + _STEP_SECONDS
    for pose in path:
        predictor.observe(pose)
        if pose.time < next_time or pose.time + reach > path[-1].time:
            continue
        next_time = pose.time + _STEP_SECONDS
        predictions = predictor.predict(moments)
        if not predictions:
            continue
        actual = [interpolate(path, pose.time + seconds) for seconds in moments]
        pairs = zip(predictions, actual, strict=True)
        distances.append([float(np.linalg.norm(p.position - a.position)) for p, a in pairs])
        inverse = actual[-1].quaternion * [1, -1, -1, -1]
        turn = rotation_vector(quaternion_product(predictions[-1].quaternion, inverse))
        turns.append(float(np.degrees(np.linalg.norm(turn))))
        cuts = [
            cut_tree(tree, view.frustum(entry), view.max_error)
            for entry in (*predictions, actual[-1])
        ]
        wanted = cuts[-1].selected
        expected = np.any([cut.seen for cut in cuts[:-1]], axis=0)
        if wanted.any():
            shares.append(float((wanted & expected).sum() / wanted.sum()))
    return PredictionError(
        ade=float(np.mean(distances)) if distances else np.nan,
        fde=float(np.mean([row[-1] for row in distances])) if distances else np.nan,
        turn=float(np.mean(turns)) if turns else np.nan,
        coverage=float(np.mean(shares)) if shares else np.nan,
    )
