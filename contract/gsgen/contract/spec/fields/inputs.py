"""Manifest fields of model inputs, and of the skeleton whose joints a pose input rotates."""

__all__ = ["Input", "Joint"]

from bisect import bisect_right
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from gsgen.contract.spec.fields.json_schema import Hint
from gsgen.contract.spec.fields.roles import PICTURE_ROLES
from gsgen.contract.spec.fields.values import Name, Positive, PositiveFloat, RoleName


@dataclass(frozen=True, slots=True)
class Joint:
    """One joint of a skeleton; joints are listed in the order of a pose's rows."""

    name: Annotated[str, Hint(min_length=1)]
    parent: Annotated[str | None, Hint(text="Name of its parent; absent for a root.")] = None
    rest: Annotated[
        tuple[float, float, float] | None,
        Hint(text="Its position in the rest pose, in local units."),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Input:
    """One model input that a runtime feeds in every frame."""

    name: Name
    role: RoleName
    shape: Annotated[tuple[Positive, ...] | None, Hint(text="Static size of every axis.")] = None
    range: Annotated[
        tuple[float, float] | None,
        Hint(text="Smallest and largest meaningful value, both included."),
    ] = None
    default: Annotated[
        float | Literal["zeros", "identity"] | tuple[float, ...] | None,
        Hint(text="What a runtime feeds if it has nothing better; row-major where a list."),
    ] = None
    convention: Annotated[str | None, Hint(text="Which of the role's conventions it follows.")] = (
        None
    )
    loop: Annotated[
        bool | None, Hint(text="Time: the end of the range continues at its start.")
    ] = None
    frames: Annotated[Positive | None, Hint(text="Time: how many distinct frames there are.")] = (
        None
    )
    fps: Annotated[
        float | None, Hint(text="Time: frames per second at natural speed.", minimum=0)
    ] = None
    label: Annotated[str | None, Hint(text="What a user interface calls it.")] = None
    joints: Annotated[tuple[Joint, ...], Hint(text="Pose: one joint for each row, in order.")] = ()
    rate: Annotated[PositiveFloat | None, Hint(text="Audio: samples per second.")] = None
    window: Annotated[
        Positive | None, Hint(text="Audio, mel: samples under the window of one column.")
    ] = None
    hop: Annotated[
        Positive | None, Hint(text="Audio, mel: samples from one column to the next.")
    ] = None
    pass_: Annotated[
        Literal["scene", "frame"] | None,
        Hint(text="When its value changes: with the scene or with the frame; see `Passes`."),
    ] = None
    background: Annotated[
        tuple[float, float, float] | None,
        Hint(text="Image: RGB from 0 to 1 under transparent pixels; black if absent."),
    ] = None

    @property
    def is_of_scene(self) -> bool:
        """Whether the scene pass takes the input: its value stays from frame to frame."""
        return self.role in PICTURE_ROLES if self.pass_ is None else self.pass_ == "scene"

    def time_of_frame(self, frame: int) -> float:
        """Return the time at which a frame begins; frames divide the input's time range equally."""
        low, high, count = self._frames()
        return low + (high - low) * frame / count

    def frame_at(self, time: float) -> int:
        """Return the index of the frame at a time; beyond the range, loops wrap, others clamp.

        It is the last one that has begun, in float32, the dtype in which a model gets its time.
        """
        low, high, count = self._frames()
        time, start, end = (float(np.float32(value)) for value in (time, low, high))
        if self.loop and not start <= time < end:
            time = start + (time - start) % (end - start)
        begun = bisect_right(
            range(count), time, key=lambda frame: float(np.float32(self.time_of_frame(frame)))
        )
        return max(begun - 1, 0)

    def _frames(self) -> tuple[float, float, int]:
        if self.role != "time" or self.range is None or self.frames is None:
            raise ValueError(f"input {self.name!r} is not a time input with a range and frames")
        return *self.range, self.frames
