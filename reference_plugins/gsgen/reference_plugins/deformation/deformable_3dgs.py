"""Deformable 3D Gaussians: canonical Gaussians that a network of eight layers moves.

Yang et al. 2024, "Deformable 3D Gaussians for High-Fidelity Monocular Dynamic Scene
Reconstruction": (δx, δr, δs) = F(γ(x), γ(t)) with the positional encoding γ. Only time is asked
for.
"""

__all__ = ["Deformable3DGS"]

from typing import final

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.contract.spec.manifest import Input
from gsgen.reference_plugins.deformation.deformation_checkpoint import (
    BLENDER_TIME_OCTAVES,
    OCTAVES,
    Deformation,
)
from gsgen.reference_plugins.loading.canonical import Canonical
from gsgen.reference_plugins.tensors.layers import Dense
from gsgen.reference_plugins.tensors.planes import covariance_planes, planes_of, stacked
from gsgen.sdk import GaussianGenerator, Gaussians, inputs

# As many rows of 256 numbers as one binding of WebGPU holds (128 MiB).
ROWS = 131_072
# The published code adds this after the division, so its axes are not quite of unit length.
_AXIS_SHIFT = 1e-5
_SMALLEST_SQUARE = 1e-24


def embedded(values: Float[Tensor, "n k"], octaves: int) -> Float[Tensor, "n m"]:
    """Return x, sin x, cos x, sin 2x, cos 2x, …: the frequencies are powers of two."""
    parts = [values]
    for octave in range(octaves):
        angle = values * float(2**octave)
        parts.append(torch.cat([torch.sin(angle), torch.cos(angle)], dim=1))
    while len(parts) > 1:  # two by two: no concatenation takes more than four
        parts = [torch.cat(parts[i : i + 4], dim=1) for i in range(0, len(parts), 4)]
    return parts[0]


class _Split(nn.Module):
    """A layer whose inputs come in two or three parts, of which time is the same for all rows."""

    def __init__(self, weight: Tensor, bias: Tensor, place: int, time: int) -> None:
        super().__init__()
        self.place = Dense(weight[:, :place], bias)
        self.time = Dense(weight[:, place : place + time], torch.zeros_like(bias))
        rest = weight[:, place + time :]
        self.rest = Dense(rest, torch.zeros_like(bias)) if rest.shape[1] else None

    def forward(self, place: Tensor, time: Tensor, hidden: Tensor | None = None) -> Tensor:
        made: Tensor = self.place(place) + time @ self.time.weight
        if self.rest is not None and hidden is not None:
            made = made + hidden @ self.rest.weight
        return made


@final
class Deformable3DGS(GaussianGenerator):
    """Gaussians that move with time."""

    family = "4d"

    position: Tensor
    scale: Tensor
    rotation: Tensor
    opacity: Tensor
    sh: Tensor

    def __init__(
        self,
        canonical: Canonical,
        net: Deformation,
        time: Input | None = None,
        *,
        rows: int = ROWS,
    ) -> None:
        """Activate what time does not change.

        Args:
            canonical: The Gaussians at rest.
            net: What moves them.
            time: How the input is declared; from 0 to 1 where absent.
            rows: How many go through the network at once.
        """
        super().__init__()
        self.inputs = (time or inputs.time(),)
        self.rows, self.skip = rows, net.skip
        self.time = nn.ModuleList(Dense(*layer) for layer in net.time or ())
        place = canonical.position.shape[1] * (2 * OCTAVES + 1)
        wide = net.layers[0][0].shape[1] - place
        self.layers = nn.ModuleList(
            _Split(*layer, place, wide) if index in (0, net.skip) else Dense(*layer)
            for index, layer in enumerate(net.layers)
        )
        self.warp = nn.ModuleList(Dense(*layer) for layer in net.warp)
        self.turn, self.stretch = Dense(*net.rotation), Dense(*net.scaling)
        self.register_buffer("position", canonical.position)
        self.register_buffer("scale", torch.exp(canonical.log_scale))
        unit = torch.nn.functional.normalize(canonical.rotation, dim=1, eps=1e-12)
        self.register_buffer("rotation", unit)
        self.register_buffer("opacity", torch.sigmoid(canonical.logit_opacity))
        self.register_buffer("sh", canonical.sh)

    def forward(self, time: Float[Tensor, "1"]) -> Gaussians:
        """Return the Gaussians at ``time``."""
        moment = self._moment(time)
        count = self.position.shape[0]
        parts = [
            self._moved(slice(start, start + self.rows), moment)
            for start in range(0, count, self.rows)
        ]
        position, covariance = (
            one[0] if len(one) == 1 else torch.cat(one) for one in zip(*parts, strict=True)
        )
        return Gaussians(
            position=position, opacity=self.opacity, covariance=covariance, sh=self.sh
        )

    def _moment(self, time: Tensor) -> Float[Tensor, "1 m"]:
        if not len(self.time):
            return embedded(time.reshape(1, 1), OCTAVES)
        first, second = self.time
        wide = embedded(time.reshape(1, 1), BLENDER_TIME_OCTAVES)
        made: Tensor = second(torch.relu(first(wide)))
        return made

    def _moved(self, part: slice, moment: Tensor) -> tuple[Tensor, Tensor]:
        """Return centres and covariances of some of the Gaussians."""
        rest = self.position[part]
        place = embedded(rest, OCTAVES)
        hidden = torch.relu(self.layers[0](place, moment))
        for index, layer in enumerate(self.layers[1:], start=1):
            made = layer(place, moment, hidden) if index == self.skip else layer(hidden)
            hidden = torch.relu(made)
        scale = self.scale[part] + self.stretch(hidden)
        # Not normalised: nor does the published rasteriser.
        rotation = self.rotation[part] + self.turn(hidden)
        covariance = covariance_planes(
            planes_of(scale), planes_of(rotation), normalise=False
        )
        return self._shifted(rest, hidden), stacked(covariance)

    def _shifted(self, rest: Tensor, hidden: Tensor) -> Tensor:
        if len(self.warp) == 1:
            made: Tensor = rest + self.warp[0](hidden)
            return made
        axis, moment = self.warp
        return _screwed(rest, axis(hidden), moment(hidden))


def _screwed(
    point: Float[Tensor, "n 3"], axis: Float[Tensor, "n 3"], moment: Float[Tensor, "n 3"]
) -> Float[Tensor, "n 3"]:
    """Move points along screws, as the published code does (its ``utils/rigid_utils.py``).

    With θ = ‖axis‖ the unit screw is w = axis/θ + 1e-5 and v = moment/θ + 1e-5, W its cross
    product, and a point goes to (I + sin θ W + (1 − cos θ) W²) x + (θ I + (1 − cos θ) W +
    (θ − sin θ) W²) v.
    """
    theta = torch.sqrt((axis * axis).sum(dim=1, keepdim=True).clamp(min=_SMALLEST_SQUARE))
    w = axis / theta + _AXIS_SHIFT
    v = moment / theta + _AXIS_SHIFT
    sine, versine = torch.sin(theta), 1 - torch.cos(theta)
    across, along = _cross(w, point), _cross(w, v)
    turned = point + sine * across + versine * _cross(w, across)
    return turned + theta * v + versine * along + (theta - sine) * _cross(w, along)


def _cross(a: Float[Tensor, "n 3"], b: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    ax, ay, az = a[:, 0:1], a[:, 1:2], a[:, 2:3]
    bx, by, bz = b[:, 0:1], b[:, 1:2], b[:, 2:3]
    return torch.cat([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], dim=1)
