"""Camera pose predictors in ONNX files (kind trajectory-predictor), run on the CPU."""

__all__ = ["OnnxPredictor", "TrajectoryModel"]

from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, final

import numpy as np
from jaxtyping import Float32, Float64

from gsgen.contract._safe_text import for_shell
from gsgen.contract.errors import GsgenError, HostProcessFailed, InputUnreadable
from gsgen.contract.model.model_file import open_model
from gsgen.contract.spec.fields.roles import STATE_SIZES
from gsgen.contract.spec.geometry import rotation_quaternion, rotation_vector
from gsgen.contract.spec.manifest import TrajectoryManifest
from gsgen.contract.spec.manifest_io import loads
from gsgen.tiles.prediction.poses import Pose, interpolate

if TYPE_CHECKING:
    from gsgen.sdk.binding import FrameSession
    from gsgen.sdk.binding.confined.models import ConfinedModels

_HISTORY_INPUT: Final = "camera_history"
_MAX_HISTORY_LENGTH: Final = 1000  # states of a history


@final
class TrajectoryModel:
    """A trajectory predictor in an ONNX file, which predicts camera poses.

    Attributes:
        name: The file.
        steps: Predicted states.
        step_seconds: Time between two states.
        history: States that the model takes.
    """

    def __init__(self, path: Path, manifest: TrajectoryManifest, session: "FrameSession") -> None:
        future = manifest.outputs.future
        entry = next(entry for entry in manifest.inputs if entry.role == _HISTORY_INPUT)
        self.name, self.steps = str(path), future.steps
        self.step_seconds, self.history = manifest.step_seconds, (entry.shape or (1,))[0]
        self._state_width = STATE_SIZES[future.representation]
        self._input, self._output = entry.name, future.name
        self._session = session

    @classmethod
    def open(cls, path: Path, confined: "ConfinedModels | None" = None) -> "TrajectoryModel":
        """Open an ONNX model of the kind trajectory-predictor.

        ``confined`` runs it in a child process with limits; None runs it in this process.

        Raises:
            InputUnreadable: The file is not such a model, or its outputs do not fit its manifest.
        """
        from gsgen.sdk.binding import FrameSession

        text = open_model(path).manifest_text
        manifest = loads(text) if text is not None else None
        if not isinstance(manifest, TrajectoryManifest):
            kind = manifest.kind if manifest else "a model without a manifest"
            raise InputUnreadable(
                f"is {kind}, expected kind trajectory-predictor",
                where=str(path),
                hint=f"Check it with: gsgen validate {for_shell(str(path))}",
            )
        histories = [entry for entry in manifest.inputs if entry.role == _HISTORY_INPUT]
        state = STATE_SIZES[manifest.outputs.future.representation]
        shape = (histories[0].shape or ()) if len(histories) == 1 else ()
        has_fitting_shape = len(shape) == 2 and shape[1] == state and isinstance(shape[0], int)
        if not (
            has_fitting_shape
            and 1 <= int(shape[0]) <= _MAX_HISTORY_LENGTH
            and manifest.step_seconds > 0
        ):
            raise InputUnreadable(
                f"the model's input of past camera poses has shape {list(shape)} and a time step of "
                f"{manifest.step_seconds} s, expected [T, {state}] with T from 1 to {_MAX_HISTORY_LENGTH} and a "
                "time step above 0 s",
                where=str(path),
                hint=f"Check it with: gsgen validate {for_shell(str(path))}",
            )
        try:
            session = FrameSession(path, provider="cpu", threads=1, confined=confined or False)
        except HostProcessFailed:
            raise
        except GsgenError as error:
            message = f"cannot be loaded: {error.message}"
            raise InputUnreadable(message, where=str(path), hint=error.hint) from error
        return cls(path, manifest, session)

    def predictor(self) -> "OnnxPredictor":
        """Return a new pose predictor for one camera path."""
        return OnnxPredictor(self)

    def run(self, history: Float32[np.ndarray, "t s"]) -> Float64[np.ndarray, "k s"]:
        """Return the predicted states; row k is k + 1 time steps after the last known state.

        Raises:
            InputUnreadable: The model fails, or its outputs are not finite states.
        """
        try:
            self._session.write({self._input: history})
            future = self._session.run()[self._output]
        except HostProcessFailed:
            raise
        except GsgenError as error:
            raise InputUnreadable(f"the model fails: {error.message}", where=self.name) from error
        shape = (self.steps, self._state_width)
        hint = f"Check it with: gsgen validate {for_shell(self.name)}"
        if future.shape != shape:
            raise InputUnreadable(
                f"outputs states {list(future.shape)}, expected {list(shape)}",
                where=self.name,
                hint=hint,
            )
        if not np.isfinite(future).all():
            raise InputUnreadable(
                "the model outputs predicted states that are not finite", where=self.name, hint=hint
            )
        return np.asarray(future, np.float64)

    def state(self, pose: Pose) -> Float64[np.ndarray, " s"]:
        """Convert a camera pose to a state vector of the trajectory model."""
        if self._state_width == 7:
            return np.concatenate([pose.position, pose.quaternion])
        return np.concatenate([pose.position, rotation_vector(pose.quaternion)])

    def pose(self, time: float, state: Float64[np.ndarray, " s"]) -> Pose:
        """Convert a state vector of the trajectory model to a camera pose."""
        if self._state_width == 7:
            return Pose(time, state[:3], state[3:] / max(float(np.linalg.norm(state[3:])), 1e-12))
        return Pose(time, state[:3], rotation_quaternion(state[3:]))


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

    def predict(self, seconds_ahead: Sequence[float]) -> list[Pose]:
        """Return predicted poses at times after the last frame, interpolated between time steps."""
        if not self._poses:
            return []
        model, last = self._model, self._poses[-1]
        poses = list(self._poses)
        times = last.time - model.step_seconds * np.arange(model.history - 1, -1, -1)
        states = []
        last_quaternion = last.quaternion
        for time in times[::-1]:
            pose = interpolate(poses, float(time))
            # Of q and −q, the one that is near the state after it.
            quaternion = (
                pose.quaternion if pose.quaternion @ last_quaternion >= 0 else -pose.quaternion
            )
            last_quaternion = quaternion
            states.append(model.state(Pose(pose.time, pose.position - last.position, quaternion)))
        future = model.run(np.array(states[::-1], np.float32))
        future[:, :3] += last.position
        predicted = [
            model.pose(last.time + step * model.step_seconds, state)
            for step, state in enumerate(future, 1)
        ]
        return [interpolate([last, *predicted], last.time + seconds) for seconds in seconds_ahead]
