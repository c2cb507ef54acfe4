"""An avatar that plays a motion: time takes the place of all that would move it."""

__all__ = ["Played"]

from typing import Any, final

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from gsgen.contract.spec.manifest import Input
from gsgen.reference_plugins.bodies.actors import ActorInputs
from gsgen.reference_plugins.bodies.motions import Motion
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.sdk import GaussianGenerator, Gaussians, inputs

# Where i / T is rounded down, frame i is meant all the same; a share of a frame.
_ROUNDING = 1e-3


@final
class Played(GaussianGenerator):
    """A person, or several side by side, who move as recorded."""

    family = "avatar"

    def __init__(
        self,
        avatar: GaussianGenerator,
        actors: ActorInputs,
        motion: Motion,
        time: Input | None = None,
        *,
        spacing: float = 1.0,
    ) -> None:
        """Keep a table for each input of ``avatar``.

        Args:
            avatar: Whose inputs are ``actors``', its shape baked.
            actors: What they are.
            motion: Where they come from.
            time: How the input is declared; frames and speed are the motion's where absent.
            spacing: How far bodies stand from each other, along x.

        Raises:
            CheckpointInvalid: The motion is of another body, or turns it in another way.
        """
        super().__init__()
        if motion.pose.shape[1] != actors.joints:
            what = f"has {motion.pose.shape[1]} joints, wanted {actors.joints}"
            raise CheckpointInvalid(what, where=str(motion.path))
        if motion.turn is not None and actors.rotation is None:
            what = "turns the body as a whole (R or Rh), which this avatar's pose does not know"
            hint = "Wanted a motion whose first joint turns the body, such as AMASS or LHM has."
            raise CheckpointInvalid(what, where=str(motion.path), hint=hint)
        self.avatar, self.actors, self.frames = avatar, actors, len(motion)
        self.inputs = (time or inputs.time(frames=len(motion), fps=motion.fps),)
        self.spacing = spacing
        for role, table in _tables(actors, motion).items():
            self.register_buffer(f"table_{role}", torch.from_numpy(table))

    def forward(self, time: Float[Tensor, "1"]) -> Gaussians:
        """Return the Gaussians of frame floor(time · frames), the last at the end.

        Args:
            time: From 0 to 1.
        """
        at = (time * float(self.frames) + _ROUNDING).clamp(0.0, float(self.frames - 1))
        frame = torch.floor(at).to(torch.int32)
        given = [self._told(one, frame) for one in self.actors.declared()]
        made = self.avatar(*given)
        assert isinstance(made, Gaussians)
        return made

    def _told(self, one: Input, frame: Int[Tensor, "1"]) -> Tensor:
        """Return what an input is told in a frame."""
        table: Any = getattr(self, f"table_{one.role}")
        value: Tensor = torch.index_select(table, 0, frame).reshape(one.shape or (-1,))
        body = int(one.name.rpartition("_")[2]) if one.name[-1].isdecimal() else 0
        if one.role != "root_translation" or not body:
            return value
        return value + torch.tensor([body * self.spacing, 0.0, 0.0])


def _tables(actors: ActorInputs, motion: Motion) -> dict[str, np.ndarray]:
    frames = len(motion)
    made: dict[str, np.ndarray] = {
        "pose": motion.pose.reshape(frames, -1),
        "root_translation": motion.shift,
    }
    if actors.rotation is not None:
        turn = np.eye(3)[None].repeat(frames, 0) if motion.turn is None else motion.turn
        made["root_rotation"] = turn.reshape(frames, 9)
    if actors.expression:
        table = np.zeros((frames, actors.expression))
        if motion.expression is not None:
            taken = motion.expression[:, : actors.expression]
            table[:, : taken.shape[1]] = taken
        made["expression"] = table
    tables = {name: table.astype(np.float32) for name, table in made.items()}
    if actors.frames:  # training's frames go by with the motion's
        tables["frame_index"] = np.minimum(np.arange(frames), actors.frames - 1)[:, None]
        tables["frame_index"] = tables["frame_index"].astype(np.int32)
    return tables
