"""Checkpoints of Deformable-3D-Gaussians: a 3DGS PLY and the network that deforms it.

``deform/iteration_N/deform.pth`` is the state dict of ``DeformNetwork``
(ingra14m/Deformable-3D-Gaussians, ``utils/time_utils.py``). Its kind follows from its tensors;
``cfg_args`` has to agree.
"""

__all__ = ["Deformation", "DeformationCheckpoint", "read_deformation"]

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from gsgen.reference_plugins.loading.canonical import Canonical, read_canonical
from gsgen.reference_plugins.loading.cfg_args import CfgArgs, read_cfg_args
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import find_iteration, within_run
from gsgen.reference_plugins.loading.method_detection import refuse_other_method
from gsgen.reference_plugins.loading.states import Shape, load_state, require_tensors

OCTAVES = 10
BLENDER_TIME_OCTAVES = 6

_PLACE = 3 * (2 * OCTAVES + 1)
_TIME = 2 * OCTAVES + 1
_BLENDER_TIME = 2 * BLENDER_TIME_OCTAVES + 1
_LAYER = re.compile(r"linear\.(\d+)\.weight")

Layer = tuple[Tensor, Tensor]


@dataclass(frozen=True, slots=True)
class Deformation:
    """The network.

    Attributes:
        layers: Its layers, as (weight, bias); the first takes the embedded point and time.
        skip: Which layer takes them once more, before what the layers before it gave.
        time: Two layers that embed time further, for scenes of Blender.
        warp: The translation, or with six degrees of freedom the axis and the moment of a screw.
        rotation: What is added to the quaternion.
        scaling: What is added to the scale.
    """

    layers: tuple[Layer, ...]
    skip: int
    time: tuple[Layer, Layer] | None
    warp: tuple[Layer] | tuple[Layer, Layer]
    rotation: Layer
    scaling: Layer

    @property
    def has_six_degrees(self) -> bool:
        """Whether points move along screws."""
        return len(self.warp) == 2


@dataclass(frozen=True, slots=True)
class DeformationCheckpoint:
    """Everything that inference needs.

    Attributes:
        folder: Of the training run.
        iteration: Which one.
        cfg: Its options.
        canonical: The Gaussians.
        net: What deforms them.
    """

    folder: Path
    iteration: int
    cfg: CfgArgs
    canonical: Canonical
    net: Deformation

    @property
    def operations(self) -> int:
        """Multiplications and additions of one frame."""
        weights = [weight.numel() for weight, _ in self.net.layers]
        return 2 * len(self.canonical) * sum(weights)

    def describe(self) -> str:
        """Say in one line what it holds."""
        kind = "Blender" if self.net.time is not None else "real"
        motion = "screws (6 degrees of freedom)" if self.net.has_six_degrees else "shifts"
        return (
            f"{self.folder}: iteration {self.iteration}, {self.canonical.describe()}, "
            f"{len(self.net.layers)} layers of "
            f"{self.net.layers[0][0].shape[0]}, {kind} time, {motion}"
        )


def read_deformation(folder: Path, iteration: int | None = None) -> DeformationCheckpoint:
    """Read a checkpoint of Deformable-3D-Gaussians.

    Args:
        folder: What training wrote, or what is in it of an iteration.
        iteration: The last where absent.

    Raises:
        CheckpointInvalid: Something is missing, or does not fit the rest.
    """
    folder, iteration = within_run(folder, iteration)
    number, place = find_iteration(folder, iteration)
    refuse_other_method("deformable-3dgs", folder, place)
    cfg = read_cfg_args(folder)
    canonical = read_canonical(place / "point_cloud.ply")
    path = folder / "deform" / f"iteration_{number}" / "deform.pth"
    net = _read_net(path, load_state(path, "the deformation network"))
    for option, seen in (
        ("is_blender", net.time is not None),
        ("is_6dof", net.has_six_degrees),
    ):
        if cfg.flag(option, default=seen) != seen:
            what = f"{option} is {not seen}, but the network in {path} says {seen}"
            raise CheckpointInvalid(what, where=str(cfg.path))
    return DeformationCheckpoint(folder, number, cfg, canonical, net)


def _read_net(path: Path, state: Mapping[str, Tensor]) -> Deformation:
    first = state.get("linear.0.weight")
    found = {int(match[1]) for name in state if (match := _LAYER.fullmatch(name))}
    if not isinstance(first, Tensor) or first.ndim != 2 or found != set(range(len(found))):
        what = f"layers linear.N are {sorted(found)}, expected 0 to 7"
        raise CheckpointInvalid(what, where=str(path))
    wide, count = first.shape[0], len(found)
    skip = count // 2 + 1
    blender = "timenet.0.weight" in state
    embedded = first.shape[1] if blender else _PLACE + _TIME
    wanted: dict[str, Shape] = {}
    for layer in range(count):
        inputs = embedded if layer == 0 else wide + (embedded if layer == skip else 0)
        wanted |= _linear(f"linear.{layer}", inputs, wide)
    if blender:
        wanted |= _linear("timenet.0", _BLENDER_TIME, None)
        wanted |= _linear("timenet.2", None, embedded - _PLACE)
    warp = ("branch_w", "branch_v") if "branch_w.weight" in state else ("gaussian_warp",)
    for name in warp:
        wanted |= _linear(name, wide, 3)
    wanted |= _linear("gaussian_rotation", wide, 4) | _linear("gaussian_scaling", wide, 3)
    read = require_tensors(path, state, wanted)
    moves = [_layer(read, name) for name in warp]
    return Deformation(
        layers=tuple(_layer(read, f"linear.{i}") for i in range(count)),
        skip=skip,
        time=(_layer(read, "timenet.0"), _layer(read, "timenet.2")) if blender else None,
        warp=(moves[0], moves[1]) if len(moves) == 2 else (moves[0],),
        rotation=_layer(read, "gaussian_rotation"),
        scaling=_layer(read, "gaussian_scaling"),
    )


def _linear(name: str, inputs: int | None, outputs: int | None) -> dict[str, Shape]:
    return {f"{name}.weight": (outputs, inputs), f"{name}.bias": (outputs,)}


def _layer(read: Mapping[str, Tensor], name: str) -> Layer:
    return read[f"{name}.weight"], read[f"{name}.bias"]
