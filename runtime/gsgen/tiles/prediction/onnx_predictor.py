"""Camera pose predictors in ONNX files (kind trajectory-predictor), run on the CPU."""

__all__ = ["OnnxPredictor", "TrajectoryModel"]

from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, final

import numpy as np
from jaxtyping import Float32, Float64

from gsgen.contract.errors import InputUnreadable
from gsgen.contract.model.model_file import open_model
from gsgen.contract.spec.fields.roles import STATE_SIZES
from gsgen.contract.spec.manifest import TrajectoryManifest
from gsgen.contract.spec.manifest_io import loads
from gsgen.tiles.prediction.poses import Pose, interpolate, rotation_quaternion, rotation_vector
from gsgen.tiles.prediction.predictor import Prediction

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

_HISTORY: Final = "camera_history"
_LONGEST: Final = 1000  # states of a history


@final
class TrajectoryModel:
    """A trajectory predictor in an ONNX file, which predicts camera poses.

    Attributes:
        name: The file.
        steps: Predicted states.
        step_seconds: Time between two states.
        history: States that the model takes.
    """

    def __init__(self, path: Path, manifest: TrajectoryManifest, session: "InferenceSession"):
        future, doubt = manifest.outputs.future, manifest.outputs.uncertainty
        entry = next(entry for entry in manifest.inputs if entry.role == _HISTORY)
        self.name, self.steps = str(path), future.steps
        self.step_seconds, self.history = manifest.step_seconds, (entry.shape or (1,))[0]
        self._width = STATE_SIZES[future.representation]
        self._upper = doubt.semantics == "covariance-upper"
        self._input, self._outputs = entry.name, [future.name, doubt.name]
        self._session = session

    @classmethod
    def open(cls, path: Path) -> "TrajectoryModel":
        """Open an ONNX model of the kind trajectory-predictor.

        Raises:
            InputUnreadable: The file is not such a model, or its outputs do not fit its manifest.
        """
        import onnxruntime

        text = open_model(path).manifest_text
        manifest = loads(text) if text is not None else None
        if not isinstance(manifest, TrajectoryManifest):
            kind = manifest.kind if manifest else "a model without a manifest"
            raise InputUnreadable(
                f"is {kind}, expected kind trajectory-predictor",
                where=str(path),
                hint=f"Check it with: gsgen validate {path}",
            )
        histories = [entry for entry in manifest.inputs if entry.role == _HISTORY]
        state = STATE_SIZES[manifest.outputs.future.representation]
        shape = (histories[0].shape or ()) if len(histories) == 1 else ()
        fits = len(shape) == 2 and shape[1] == state and isinstance(shape[0], int)
        if not (fits and 1 <= int(shape[0]) <= _LONGEST and manifest.step_seconds > 0):
            raise InputUnreadable(
                f"the model's input of past camera poses has shape {list(shape)} and a time step of "
                f"{manifest.step_seconds} s, expected [T, {state}] with T from 1 to {_LONGEST} and a "
                "time step above 0 s",
                where=str(path),
                hint=f"Check it with: gsgen validate {path}",
            )
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.log_severity_level = 3
        try:
            session = onnxruntime.InferenceSession(
                str(path), options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # ONNX Runtime raises types of its own, without a base
            raise InputUnreadable(
                f"cannot be loaded: {str(error).splitlines()[0]}", where=str(path)
            ) from error
        return cls(path, manifest, session)

    def predictor(self) -> "OnnxPredictor":
        """Return a new pose predictor for one camera path."""
        return OnnxPredictor(self)

    def run(self, history: Float32[np.ndarray, "t s"]) -> Prediction:
        """Run the trajectory model; row k is k + 1 time steps after the last known camera state.

        Raises:
            InputUnreadable: It fails, or its outputs are not finite states.
        """
        try:
            future, doubt = self._session.run(self._outputs, {self._input: history})
        except Exception as error:  # ONNX Runtime raises types of its own, without a base
            raise InputUnreadable(
                f"the model fails: {str(error).splitlines()[0]}", where=self.name
            ) from error
        width = self._width * (self._width + 1) // 2 if self._upper else self._width
        shapes = (self.steps, self._width), (self.steps, width)
        hint = f"Check it with: gsgen validate {self.name}"
        if (future.shape, doubt.shape) != shapes:
            raise InputUnreadable(
                f"outputs states {list(future.shape)} and uncertainty {list(doubt.shape)}, "
                f"expected {list(shapes[0])} and {list(shapes[1])}",
                where=self.name,
                hint=hint,
            )
        if not (np.isfinite(future).all() and np.isfinite(doubt).all()):
            raise InputUnreadable(
                "the model outputs predicted states or uncertainties that are not finite",
                where=self.name,
                hint=hint,
            )
        return self._prediction(future.astype(np.float64), doubt.astype(np.float64))

    def state(self, pose: Pose) -> Float64[np.ndarray, " s"]:
        """Convert a camera pose to a state vector of the trajectory model."""
        if self._width == 7:
            return np.concatenate([pose.position, pose.quaternion])
        return np.concatenate([pose.position, rotation_vector(pose.quaternion)])

    def _prediction(
        self, future: Float64[np.ndarray, "k s"], doubt: Float64[np.ndarray, "k u"]
    ) -> Prediction:
        if self._upper:
            rows = np.arange(self._width)
            diagonal = rows * self._width - rows * (rows - 1) // 2
            doubt = np.sqrt(np.maximum(doubt[:, diagonal], 0))
        if self._width == 7:
            lengths = np.linalg.norm(future[:, 3:], axis=1, keepdims=True)
            quaternion = future[:, 3:] / np.maximum(lengths, 1e-12)
            # A rotation by a small angle moves the vector part by half of it.
            turn = 2 * doubt[:, 4:]
        else:
            quaternion = np.array([rotation_quaternion(vector) for vector in future[:, 3:]])
            turn = doubt[:, 3:]
        deviation = np.maximum(np.hstack([doubt[:, :3], turn]), 1e-6)
        return Prediction(position=future[:, :3], quaternion=quaternion, deviation=deviation)


@final
class OnnxPredictor:
    """Predicts camera poses by an ONNX model, from past poses at the model's time step.

    Positions are given relative to the last one, so that float32 is enough anywhere.

    Attributes:
        name: Of the model.
        reach: Seconds that the model can tell ahead.
    """

    def __init__(self, model: TrajectoryModel) -> None:
        self._model = model
        self.name, self.reach = model.name, model.steps * model.step_seconds
        self._poses: deque[Pose] = deque()

    def observe(self, pose: Pose) -> None:
        """Record the camera pose of a frame."""
        self._poses.append(pose)
        span = self._model.history * self._model.step_seconds
        while len(self._poses) > 2 and self._poses[1].time < pose.time - span:
            self._poses.popleft()

    def predict(self, ahead: Sequence[float]) -> Prediction | None:
        """Return predicted poses at times after the last frame, interpolated between time steps."""
        if not self._poses:
            return None
        model, last = self._model, self._poses[-1]
        poses = list(self._poses)
        times = last.time - model.step_seconds * np.arange(model.history - 1, -1, -1)
        states = []
        before = last.quaternion
        for time in times[::-1]:
            pose = interpolate(poses, float(time))
            # Of q and −q, the one that is near the state after it.
            quaternion = pose.quaternion if pose.quaternion @ before >= 0 else -pose.quaternion
            before = quaternion
            states.append(model.state(Pose(pose.time, pose.position - last.position, quaternion)))
        prediction = model.run(np.array(states[::-1], np.float32))
        return _resample(prediction, last, model.step_seconds, ahead)


def _resample(
    prediction: Prediction, last: Pose, step_seconds: float, ahead: Sequence[float]
) -> Prediction:
    """Interpolate the model's predicted camera poses at times after the last known pose."""
    offsets = prediction.position + last.position
    poses = [last] + [
        Pose(last.time + (index + 1) * step_seconds, position, quaternion)
        for index, (position, quaternion) in enumerate(
            zip(offsets, prediction.quaternion, strict=True)
        )
    ]
    picked = [interpolate(poses, last.time + seconds) for seconds in ahead]
    steps = np.arange(1, len(prediction.deviation) + 1) * step_seconds
    columns = [np.interp(ahead, steps, column) for column in prediction.deviation.T]
    return Prediction(
        position=np.array([pose.position for pose in picked]),
        quaternion=np.array([pose.quaternion for pose in picked]),
        deviation=np.column_stack(columns),
    )
