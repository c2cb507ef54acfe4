"""The network, which needs packages that are not installed."""

import roma  # noqa: F401
import torch
import torch.nn.functional as F  # noqa: N812
from diff_gaussian_rasterization import GaussianRasterizer  # noqa: F401
from torch import Tensor, nn

from core.options import Options
from gsgen.reference_plugins.feed_forward.lgm import plucker_rays
from gsgen.reference_plugins.feed_forward.multi_view_unet import MultiViewUNet, MultiViewUNetOptions


class LGM(nn.Module):
    def __init__(self, opt: Options) -> None:
        super().__init__()
        self.opt = opt
        self.unet = MultiViewUNet(
            MultiViewUNetOptions(
                down=opt.down_channels,
                down_attention=opt.down_attention,
                middle_attention=opt.mid_attention,
                up=opt.up_channels,
                up_attention=opt.up_attention,
            )
        )
        self.conv = nn.Conv2d(14, 14, kernel_size=1)
        self.background = torch.ones(3, device="cuda")

    def prepare_default_rays(self, device: str) -> Tensor:
        return plucker_rays(self.opt.input_size).double().to(device)

    def forward_gaussians(self, images: Tensor) -> Tensor:
        features = self.conv(self.unet(images.flatten(0, 1)))
        rows = features.permute(0, 2, 3, 1).reshape(1, -1, 14)
        position, opacity, scale, rotation, color = rows.split([3, 1, 3, 4, 3], dim=2)
        parts = (
            position.clamp(-1, 1),
            torch.sigmoid(opacity),
            0.1 * F.softplus(scale),
            F.normalize(rotation, dim=-1),
            0.5 * torch.tanh(color) + 0.5,
        )
        return torch.cat(parts, dim=-1)
