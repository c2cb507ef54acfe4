"""Opens camera pose predictors by name or from a file."""

__all__ = ["PREDICTORS_BY_NAME", "predictor_maker"]

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, final

from gsgen.contract.errors import UnknownName
from gsgen.tiles.prediction.poses import Pose
from gsgen.tiles.prediction.predictor import ConstantVelocity, Predictor

if TYPE_CHECKING:
    from gsgen.sdk.binding.confined.models import ConfinedModels


@final
class _NoPredictor:
    """A pose predictor that predicts nothing, so that no tile is prefetched."""

    name, reach = "none", 0.0

    def observe(self, pose: Pose) -> None:
        del pose

    def predict(self, seconds_ahead: Sequence[float]) -> list[Pose]:
        del seconds_ahead
        return []


PREDICTORS_BY_NAME: Final[dict[str, Callable[[], Predictor]]] = {
    "constant-velocity": ConstantVelocity,
    "none": _NoPredictor,
}


def predictor_maker(name: str, confined: "ConfinedModels | None" = None) -> Callable[[], Predictor]:
    """Return the factory of a named pose predictor, which makes one for each camera path.

    Args:
        name: One of :data:`PREDICTORS_BY_NAME`, or the path of an ONNX file of kind trajectory-predictor.
        confined: Runs the file in a child process with limits; None runs it in this process.

    Raises:
        UnknownName: There is neither a predictor nor a file of that name.
        InputUnreadable: The file is not such a model.
    """
    if name in PREDICTORS_BY_NAME:
        return PREDICTORS_BY_NAME[name]
    path = Path(name)
    if not path.is_file() and path.suffix.lower() != ".onnx":
        raise UnknownName.among("predictor", name, PREDICTORS_BY_NAME)
    from gsgen.tiles.prediction.onnx_predictor import TrajectoryModel

    return TrajectoryModel.open(path, confined).predictor
