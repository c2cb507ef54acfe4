"""The inputs that move a body, for one body or several."""

__all__ = ["Actor", "ActorInputs"]

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gsgen.contract.spec.manifest import Input
from gsgen.reference_plugins.bodies.rotations import turned
from gsgen.sdk import inputs

Rotation = Literal["matrix", "axis-angle"]

# Nobody walks farther from where a scene begins than this, in metres.
_FAR = 10.0


@dataclass(frozen=True, slots=True)
class Actor:
    """How K bodies are moved, as tensors.

    Attributes:
        pose: Axis-angles of the joints.
        turn: Rotation of each body as a whole; none if its root joint's is all.
        shift: Where each body is moved.
        shape: Shape coefficients, the same for all; none if they were baked.
        expression: Of each body.
        frame: Which of the frames that training saw, of each body.
    """

    pose: Float[Tensor, "k j 3"]
    turn: Float[Tensor, "k 3 3"] | None
    shift: Float[Tensor, "k 3"]
    shape: Float[Tensor, " s"] | None = None
    expression: Float[Tensor, "k e"] | None = None
    frame: tuple[Int[Tensor, "1"], ...] | None = None


@dataclass(frozen=True, slots=True)
class ActorInputs:
    """Which inputs there are.

    Attributes:
        joints: How many a pose turns.
        rotation: How the rotation of the body as a whole is given; no input if absent.
        shape: How many shape coefficients are an input; none if 0.
        expression: How many expression coefficients are.
        frames: How many frames training saw, if the body knows frames.
        bodies: How many bodies there are. Those after the first have inputs of their own, named
            ``pose_1`` and so on; their shape is the first's.
    """

    joints: int
    rotation: Rotation | None = None
    shape: int = 0
    expression: int = 0
    frames: int = 0
    bodies: int = 1

    def declared(self) -> tuple[Input, ...]:
        """Return the inputs as the manifest declares them."""
        made = [one for body in range(self.bodies) for one in self._own(body)]
        return (*made, *([inputs.shape(self.shape)] if self.shape else []))

    def _own(self, body: int) -> list[Input]:
        tail = f"_{body}" if body else ""
        far = (-_FAR, _FAR)
        made = [inputs.pose(self.joints, f"pose{tail}", convention="smpl-axis-angle")]
        if self.rotation is not None:
            name = f"root_rotation{tail}"
            made.append(inputs.root_rotation(name, convention=self.rotation))
        made.append(inputs.root_translation(f"root_translation{tail}", range=far))
        if self.expression:
            made.append(inputs.expression(self.expression, f"expression{tail}"))
        if self.frames:
            made.append(inputs.frame_index(self.frames, f"frame_index{tail}"))
        return made

    def taken(self, given: Sequence[Tensor]) -> Actor:
        """Sort the tensors of one frame, in the order of :meth:`declared`."""
        rest = list(given)
        shape = rest.pop() if self.shape else None
        each = len(rest) // self.bodies
        columns = [rest[index::each] for index in range(each)]
        pose = _stacked(columns.pop(0), self.joints, 3)
        turn = None
        if self.rotation is not None:
            turn = self._turn(columns.pop(0))
        shift = _stacked(columns.pop(0), 3)
        expression = _stacked(columns.pop(0), self.expression) if self.expression else None
        frame = tuple(columns.pop(0)) if self.frames else None
        return Actor(pose, turn, shift, shape, expression, frame)

    def _turn(self, given: Sequence[Tensor]) -> Float[Tensor, "k 3 3"]:
        if self.rotation == "matrix":
            turn = _stacked(given, 3, 3)
            # Runtimes feed zeros before they know better; a body that is a point is no picture.
            length = (turn * turn).sum(dim=(1, 2), keepdim=True)
            return turn + torch.relu(1 - length) * torch.eye(3)
        return turned(_stacked(given, 3)[:, None])[:, 0]


def _stacked(given: Sequence[Tensor], *shape: int) -> Tensor:
    made = [one.reshape(1, *shape) for one in given]
    return made[0] if len(made) == 1 else torch.cat(made, dim=0)
