"""Plays a recorded motion: a time input replaces the pose inputs of an avatar."""

__all__ = ["MotionPlayback"]

from dataclasses import replace
from typing import Any, final

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from gsgen.contract.spec.manifest import Input
from gsgen.reference_plugins.bodies.actors import PersonInputs
from gsgen.reference_plugins.bodies.motions import Motion
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.sdk import GaussianGenerator, Gaussians, inputs

# Added before rounding down, in frames: i / T in float32 may be slightly below frame i.
_FRAME_TOLERANCE = 1e-3


@final
class MotionPlayback(GaussianGenerator):
    """Plays a recorded motion with one avatar, or with several side by side."""

    family = "avatar"

    def __init__(
        self,
        avatar: GaussianGenerator,
        actors: PersonInputs,
        motion: Motion,
        time: Input | None = None,
        *,
        spacing: float = 1.0,
    ) -> None:
        """Store a motion's values for each input of an avatar as a table of frames.

        The shape of ``avatar`` is baked, and its first inputs are those of ``actors``; others, such
        as the camera, stay inputs. ``time`` has the motion's frames and speed by default;
        ``spacing`` separates bodies along x.
        """
        super().__init__()
        if motion.pose.shape[1] != actors.joints:
            message = f"has {motion.pose.shape[1]} joints, expected {actors.joints}"
            raise CheckpointInvalid(message, where=str(motion.path))
        if motion.turn is not None and actors.rotation is None:
            message = "has a root rotation (R or Rh), but this avatar has no such input"
            hint = "Give a motion whose first joint holds the root rotation, as AMASS and LHM write it."
            raise CheckpointInvalid(message, where=str(motion.path), hint=hint)
        self.avatar, self.actors, self.frames = avatar, actors, len(motion)
        time = time or inputs.time(frames=len(motion), fps=motion.fps)
        self.inputs = (time, *avatar.inputs[len(actors.declared()) :])
        self.spacing = spacing
        self.space = replace(avatar.space, up=motion.up)
        self.color_range = avatar.color_range
        for role, table in _tables(actors, motion).items():
            self.register_buffer(f"table_{role}", torch.from_numpy(table))

    def forward(self, time: Float[Tensor, "1"], *others: Tensor) -> Gaussians:
        """Return the Gaussians of frame floor(time · frames), or of the last frame at the end."""
        position = (time * float(self.frames) + _FRAME_TOLERANCE).clamp(0.0, float(self.frames - 1))
        frame = torch.floor(position).to(torch.int32)
        values = [self._input_value(declared, frame) for declared in self.actors.declared()]
        gaussians = self.avatar(*values, *others)
        assert isinstance(gaussians, Gaussians)
        return gaussians

    def _input_value(self, declared: Input, frame: Int[Tensor, "1"]) -> Tensor:
        table: Any = getattr(self, f"table_{declared.role}")
        value: Tensor = torch.index_select(table, 0, frame).reshape(declared.shape or (-1,))
        body = int(declared.name.rpartition("_")[2]) if declared.name[-1].isdecimal() else 0
        if declared.role != "root_translation" or not body:
            return value
        return value + torch.tensor([body * self.spacing, 0.0, 0.0])


def _tables(actors: PersonInputs, motion: Motion) -> dict[str, np.ndarray]:
    frames = len(motion)
    float_tables: dict[str, np.ndarray] = {
        "pose": motion.pose.reshape(frames, -1),
        "root_translation": motion.shift,
    }
    if actors.rotation is not None:
        root_rotations = np.eye(3)[None].repeat(frames, 0) if motion.turn is None else motion.turn
        float_tables["root_rotation"] = root_rotations.reshape(frames, 9)
    if actors.expression:
        table = np.zeros((frames, actors.expression))
        if motion.expression is not None:
            coefficients = motion.expression[:, : actors.expression]
            table[:, : coefficients.shape[1]] = coefficients
        float_tables["expression"] = table
    tables = {name: table.astype(np.float32) for name, table in float_tables.items()}
    if actors.frames:  # training frames advance with the motion's frames
        tables["frame_index"] = np.minimum(np.arange(frames), actors.frames - 1)[:, None]
        tables["frame_index"] = tables["frame_index"].astype(np.int32)
    return tables
