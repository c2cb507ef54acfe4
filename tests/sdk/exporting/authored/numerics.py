"""Motion and algebra: spectra, splines, rotations and covariances in closed form."""

__all__ = ["MODULES"]

import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812 - the name that every method uses

from gsgen.sdk import Gaussians, math
from sdk.exporting.authored.cloud import Cloud, N


class SpectralMotion(Cloud):
    """Displacements as an inverse FFT of spectra whose phase turns with time."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("real", 0.1 * torch.randn(N // 2 + 1, 3))
        self.register_buffer("imag", 0.1 * torch.randn(N // 2 + 1, 3))

    def forward(self, time: Tensor) -> Gaussians:
        spectrum = torch.complex(self.real * torch.cos(time), self.imag * torch.sin(time))
        return self.cloud(position=self.rest + torch.fft.irfft(spectrum, n=N, dim=0))


class ComplexRotation(Cloud):
    """A turn in the plane, written as a product of complex numbers."""

    def forward(self, time: Tensor) -> Gaussians:
        plane = torch.view_as_complex(self.rest[:, :2].contiguous())
        turned = torch.view_as_real(plane * torch.polar(torch.ones(1), 3.0 * time))
        half = 1.5 * time
        turn = torch.cat([torch.cos(half), torch.zeros(2), torch.sin(half)])[None]
        return self.cloud(
            position=torch.cat([turned, self.rest[:, 2:]], dim=1),
            rotation=math.quaternion_multiply(turn.expand(N, 4), self.rotation),
        )


class PolynomialAndRadial(Cloud):
    """SpacetimeGaussians: polynomial motion, linear rotation, opacity as a bump in time."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("center", torch.rand(N, 1))
        self.register_buffer("motion", 0.2 * torch.randn(N, 9))
        self.register_buffer("omega", 0.2 * torch.randn(N, 4))

    def forward(self, time: Tensor) -> Gaussians:
        dt = time - self.center
        position = self.rest
        for power in range(3):
            position = position + self.motion[:, 3 * power : 3 * power + 3] * dt ** (power + 1)
        radial_basis = torch.exp(-(dt**2) / 0.5**2)
        rotation = F.normalize(self.rotation + dt * self.omega)
        return self.cloud(position=position, rotation=rotation, opacity=self.opacity * radial_basis)


class ConditionedOnTime(Cloud):
    """Rotor 4DGS: a 4-D covariance, conditioned on time."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("factor", 0.2 * torch.randn(N, 4, 4) + 0.2 * torch.eye(4))
        self.register_buffer("center", torch.rand(N, 1))

    def forward(self, time: Tensor) -> Gaussians:
        sigma = self.factor @ self.factor.transpose(1, 2)
        cross, variance = sigma[:, :3, 3:], sigma[:, 3:, 3:]
        dt = time - self.center
        position = self.rest + (cross / variance).squeeze(-1) * dt
        marginal = torch.exp(-0.5 * dt**2 / variance.squeeze(-1))
        spatial = sigma[:, :3, :3] - cross @ cross.transpose(1, 2) / variance
        upper = torch.triu_indices(3, 3)
        return self.cloud(
            position=position,
            opacity=self.opacity * marginal,
            covariance=spatial[:, upper[0], upper[1]] + 1e-3 * torch.tensor([1.0, 0, 0, 1, 0, 1]),
        )


class InverseOfTheSdk(Cloud):
    """``math.inverse_3x3``: normals turn by the inverse transpose of a matrix per Gaussian."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("shear", 0.3 * torch.randn(N, 3, 3))

    def forward(self, time: Tensor) -> Gaussians:
        matrix = torch.eye(3) + time * self.shear
        return self.cloud(position=(math.inverse_3x3(matrix) @ self.rest[:, :, None])[..., 0])


class KeyframeSpline(Cloud):
    """Catmull-Rom splines between keyframes that are gathered at the current time."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("keys", torch.randn(8, N, 3))

    def forward(self, time: Tensor) -> Gaussians:
        moment = 1 + 4.999 * time
        index = torch.floor(moment).long().clamp(1, 5)
        u = moment - index
        a, b, c, d = (self.keys[index + shift].squeeze(0) for shift in (-1, 0, 1, 2))
        position = b + 0.5 * u * (
            c - a + u * (2 * a - 5 * b + 4 * c - d + u * (3 * (b - c) + d - a))
        )
        return self.cloud(position=position)


class SearchedKeyframes(Cloud):
    """Uneven keyframes: ``searchsorted`` finds the segment of the current time."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("times", torch.tensor([0.0, 0.13, 0.42, 0.77, 1.0]))
        self.register_buffer("keys", torch.randn(5, N, 3))

    def forward(self, time: Tensor) -> Gaussians:
        right = torch.searchsorted(self.times, time).clamp(1, 4)
        left = right - 1
        share = (time - self.times[left]) / (self.times[right] - self.times[left])
        return self.cloud(position=torch.lerp(self.keys[left][0], self.keys[right][0], share))


class CovarianceOfNeighbours(Cloud):
    """Covariances estimated from the nearest neighbours in every frame, by ``cdist``."""

    def forward(self, time: Tensor) -> Gaussians:
        points = self.rest * (1 + 0.3 * time * torch.sin(3 * self.rest))
        _, neighbours = torch.cdist(points, points).topk(6, largest=False)
        around = points[neighbours]
        centered = around - around.mean(dim=1, keepdim=True)
        covariance = 0.02 * torch.einsum("nki,nkj->nij", centered, centered)
        return self.cloud(position=points, covariance=math.upper_triangle(covariance))


class GradientInForward(Cloud):
    """Normals of a field, taken by autograd within forward."""

    def forward(self, time: Tensor) -> Gaussians:
        with torch.enable_grad():
            point = self.rest.clone().requires_grad_()
            field = (torch.sin(point) * time).sum()
            (normal,) = torch.autograd.grad(field, point)
        return self.cloud(position=self.rest + 0.1 * normal)


MODULES = (
    SpectralMotion,
    ComplexRotation,
    PolynomialAndRadial,
    ConditionedOnTime,
    InverseOfTheSdk,
    KeyframeSpline,
    SearchedKeyframes,
    CovarianceOfNeighbours,
    GradientInForward,
)
