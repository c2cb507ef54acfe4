"""Declares the inputs that pose one body or several: pose, root rotation, translation, shape."""

__all__ = ["AnimatedPerson", "PersonInputs"]

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gsgen.contract.spec.manifest import Input
from gsgen.reference_plugins.bodies.rotations import rotation_matrices
from gsgen.sdk import inputs

Rotation = Literal["matrix", "axis-angle"]

# Bound of the root translation, in metres: no person is expected farther from the origin.
_MAX_TRANSLATION = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AnimatedPerson:
    """The pose inputs of K bodies in one frame, as tensors."""

    pose: Float[Tensor, "k j 3"]  # Axis-angles of the joints
    # root rotation of each body; None if the root joint's rotation is the only one
    turn: Float[Tensor, "k 3 3"] | None
    shift: Float[Tensor, "k 3"]  # root translation of each body
    # shape coefficients, the same for all bodies; None if they were baked
    shape: Float[Tensor, " s"] | None = None
    expression: Float[Tensor, "k e"] | None = None  # expression coefficients of each body
    # index of a training frame for each body, or for each part of the only body
    frame: tuple[Int[Tensor, "1"], ...] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PersonInputs:
    """The set of pose inputs that an avatar declares."""

    joints: int  # number of joints in a pose
    rotation: Rotation | None = None  # convention of the root rotation input; no such input if None
    shape: int = 0  # number of shape coefficients in the input; 0 for no input
    expression: int = 0  # number of expression coefficients in the input; 0 for no input
    frames: int = 0  # number of training frames; 0 if the avatar does not depend on them
    # Names of the parts of a single body that have a training frame each; none for a common one.
    parts: tuple[str, ...] = ()
    # Number of bodies. Those after the first have their own inputs ``pose_1`` and so on, but share
    # the first body's shape.
    bodies: int = 1

    def declared(self) -> tuple[Input, ...]:
        """Return the pose inputs of an avatar as the manifest declares them."""
        input_list = [
            declared for body in range(self.bodies) for declared in self._body_inputs(body)
        ]
        return (*input_list, *([inputs.shape(self.shape)] if self.shape else []))

    def _body_inputs(self, body: int) -> list[Input]:
        suffix = f"_{body}" if body else ""
        translation_range = (-_MAX_TRANSLATION, _MAX_TRANSLATION)
        body_inputs = [inputs.pose(self.joints, f"pose{suffix}", convention="smpl-axis-angle")]
        if self.rotation is not None:
            name = f"root_rotation{suffix}"
            body_inputs.append(inputs.root_rotation(name, convention=self.rotation))
        body_inputs.append(
            inputs.root_translation(f"root_translation{suffix}", range=translation_range)
        )
        if self.expression:
            body_inputs.append(inputs.expression(self.expression, f"expression{suffix}"))
        if self.frames:
            part_suffixes = [f"_{part}" for part in self.parts] or [suffix]
            body_inputs += [
                inputs.frame_index(self.frames, f"frame_index{end}") for end in part_suffixes
            ]
        return body_inputs

    def actor_from(self, tensors: Sequence[Tensor]) -> AnimatedPerson:
        """Assemble pose, rotation, translation and shape of all bodies from one frame's tensors.

        The tensors have the order of :meth:`declared`.
        """
        remaining = list(tensors)
        shape = remaining.pop() if self.shape else None
        inputs_per_body = len(remaining) // self.bodies
        columns = [remaining[index::inputs_per_body] for index in range(inputs_per_body)]
        pose = _stack_rows(columns.pop(0), self.joints, 3)
        turn = None
        if self.rotation is not None:
            turn = self._rotation(columns.pop(0))
        shift = _stack_rows(columns.pop(0), 3)
        expression = _stack_rows(columns.pop(0), self.expression) if self.expression else None
        frame = tuple(tensor for column in columns for tensor in column) if self.frames else None
        return AnimatedPerson(
            pose=pose, turn=turn, shift=shift, shape=shape, expression=expression, frame=frame
        )

    def _rotation(self, tensors: Sequence[Tensor]) -> Float[Tensor, "k 3 3"]:
        if self.rotation == "matrix":
            turn = _stack_rows(tensors, 3, 3)
            # Runtimes may feed zeros at first, which would collapse the body to a point: add I.
            length = (turn * turn).sum(dim=(1, 2), keepdim=True)
            return turn + torch.relu(1 - length) * torch.eye(3)
        return rotation_matrices(_stack_rows(tensors, 3)[:, None])[:, 0]


def _stack_rows(tensors: Sequence[Tensor], *shape: int) -> Tensor:
    rows = [tensor.reshape(1, *shape) for tensor in tensors]
    return rows[0] if len(rows) == 1 else torch.cat(rows, dim=0)
