"""Reads checkpoints of Deformable-3D-Gaussians: a 3DGS PLY and its deformation network.

``deform/iteration_N/deform.pth`` is the state dict of ``DeformNetwork``
(ingra14m/Deformable-3D-Gaussians, ``utils/time_utils.py``). Its variant follows from its tensors,
and must agree with ``cfg_args``.
"""

__all__ = ["Deformation", "DeformationCheckpoint", "read_deformation", "read_layers"]

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from gsgen.reference_plugins.loading.canonical import Canonical, read_canonical
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.states import (
    Layer,
    Shape,
    layer_of,
    linear_shapes,
    load_state,
    require_tensors,
)
from gsgen.reference_plugins.loading.training_run import TrainingRun, open_run
from gsgen.reference_plugins.tensors.positional_encoding import POINT_OCTAVES, encoded_size

BLENDER_TIME_OCTAVES = 6

_POINT_INPUTS = encoded_size(3, POINT_OCTAVES)
_ENCODED_TIME_SIZE = encoded_size(1, POINT_OCTAVES)
_BLENDER_TIME = encoded_size(1, BLENDER_TIME_OCTAVES)
_LAYER_NAME = re.compile(r"linear\.(\d+)\.weight")


@dataclass(frozen=True, slots=True, kw_only=True)
class Deformation:
    """The layers of the network that deforms Gaussians over time."""

    # layers as (weight, bias); the first takes the encoded point and time
    layers: tuple[Layer, ...]
    skip: int  # index of the layer that takes these inputs again, before its hidden inputs
    # two further layers for the encoded time, in scenes of Blender
    time: tuple[Layer, Layer] | None
    # the translation; with six degrees of freedom the axis and the moment of a screw
    warp: tuple[Layer] | tuple[Layer, Layer]
    rotation: Layer  # the change of the quaternion, which is added
    scaling: Layer  # the change of the scale, which is added

    @property
    def has_six_degrees(self) -> bool:
        """Whether the deformation network moves points by screw motions."""
        return len(self.warp) == 2


@dataclass(frozen=True, slots=True)
class DeformationCheckpoint:
    """The Gaussians and the network of a Deformable-3D-Gaussians checkpoint."""

    run: TrainingRun
    canonical: Canonical  # the canonical Gaussians
    net: Deformation  # the deformation network

    @property
    def operations(self) -> int:
        """The number of multiplications and additions that the network needs for a frame."""
        weights = [weight.numel() for weight, _ in self.net.layers]
        return 2 * len(self.canonical) * sum(weights)

    def describe(self) -> str:
        """Return the sizes and the variant of the deformation network as one line."""
        kind = "Blender" if self.net.time is not None else "real"
        motion = "screws (6 degrees of freedom)" if self.net.has_six_degrees else "shifts"
        return (
            f"{self.run}, {self.canonical.describe()}, "
            f"{len(self.net.layers)} layers of "
            f"{self.net.layers[0][0].shape[0]}, {kind} time, {motion}"
        )


def read_deformation(folder: Path, iteration: int | None = None) -> DeformationCheckpoint:
    """Read a checkpoint of Deformable-3D-Gaussians."""
    run = open_run("deformable-3dgs", folder, iteration)
    canonical = read_canonical(run.files / "point_cloud.ply")
    path = run.folder / "deform" / f"iteration_{run.iteration}" / "deform.pth"
    net = _read_deformation_network(path, load_state(path, "the deformation network"))
    for option, actual in (("is_blender", net.time is not None), ("is_6dof", net.has_six_degrees)):
        if run.cfg.flag(option, default=actual) != actual:
            message = f"{option} is {not actual}, but the network in {path} has {actual}"
            raise CheckpointInvalid(message, where=str(run.cfg.path))
    return DeformationCheckpoint(run, canonical, net)


def _read_deformation_network(path: Path, state: Mapping[str, Tensor]) -> Deformation:
    has_screws = "branch_w.weight" in state
    warp = {"branch_w": 3, "branch_v": 3} if has_screws else {"gaussian_warp": 3}
    return read_layers(path, state, warp)[0]


def read_layers(
    path: Path,
    state: Mapping[str, Tensor],
    warp: Mapping[str, int],
    further_shapes: Callable[[int, int], Mapping[str, Shape]] = lambda _, __: {},
) -> tuple[Deformation, dict[str, Tensor]]:
    """Return the layers of a deformation network, and all tensors of its state dict.

    Args:
        path: The file, for messages.
        state: The state dict.
        warp: Heads of the translation, with their outputs.
        further_shapes: Returns the shapes of further tensors, for the width of the encoded point and
            time, and that of the layers.
    """
    first = state.get("linear.0.weight")
    layers = {int(match[1]) for name in state if (match := _LAYER_NAME.fullmatch(name))}
    if not isinstance(first, Tensor) or first.ndim != 2 or layers != set(range(len(layers))):
        message = f"layers linear.N are {sorted(layers)}, expected 0 to 7"
        raise CheckpointInvalid(message, where=str(path))
    width, count = first.shape[0], len(layers)
    skip = count // 2 + 1
    blender = "timenet.0.weight" in state
    embedding_size = first.shape[1] if blender else _POINT_INPUTS + _ENCODED_TIME_SIZE
    expected: dict[str, Shape] = {}
    for layer in range(count):
        inputs = embedding_size if layer == 0 else width + (embedding_size if layer == skip else 0)
        expected |= linear_shapes(f"linear.{layer}", inputs, width)
    if blender:
        expected |= linear_shapes("timenet.0", _BLENDER_TIME, None)
        expected |= linear_shapes("timenet.2", None, embedding_size - _POINT_INPUTS)
    for name, outputs in {**warp, "gaussian_rotation": 4, "gaussian_scaling": 3}.items():
        expected |= linear_shapes(name, width, outputs)
    expected |= further_shapes(embedding_size, width)
    read = require_tensors(path, state, expected)
    translation_layers = [layer_of(read, name) for name in warp]
    net = Deformation(
        layers=tuple(layer_of(read, f"linear.{i}") for i in range(count)),
        skip=skip,
        time=(layer_of(read, "timenet.0"), layer_of(read, "timenet.2")) if blender else None,
        warp=(translation_layers[0], translation_layers[1])
        if len(translation_layers) == 2
        else (translation_layers[0],),
        rotation=layer_of(read, "gaussian_rotation"),
        scaling=layer_of(read, "gaussian_scaling"),
    )
    return net, read
