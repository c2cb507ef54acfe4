"""Between an author's module and the contract: pack, cast, pad and name the outputs."""

__all__ = [
    "APPEARANCE_RGB",
    "APPEARANCE_SH",
    "COUNT",
    "GAUSSIANS",
    "Packed",
    "PackedGenerator",
]

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from gsgen.contract.layout import appearance_channels
from gsgen.sdk.errors import GeneratorInvalid
from gsgen.sdk.generator import GaussianGenerator, Gaussians

# Names that every consumer we know binds right; the Visionary viewer looks for `gauss` in front
# and for `color` inside.
GAUSSIANS = "gaussians"
APPEARANCE_SH = "color_sh"
APPEARANCE_RGB = "color_rgb"
COUNT = "num_points"


@dataclass(frozen=True, slots=True)
class Packed:
    """How outputs are packed.

    Attributes:
        dtype: float32 or float16, of both outputs.
        capacity: Rows of the outputs; rows behind the Gaussians are zero.
    """

    dtype: torch.dtype
    capacity: int


class PackedGenerator(nn.Module):
    """An author's module, with outputs as the contract wants them."""

    def __init__(self, generator: GaussianGenerator, packed: Packed) -> None:
        super().__init__()
        self.generator = generator
        self.packed = packed

    def forward(
        self, *inputs: Tensor
    ) -> tuple[Float[Tensor, "c 10"], Float[Tensor, "c channels"], Int[Tensor, "1"]]:
        """Return ``(gaussians, appearance, num_points)``."""
        made = self.generator(*inputs)
        if not isinstance(made, Gaussians):
            what = f"forward returned {type(made).__name__}, wanted gsgen.sdk.Gaussians"
            raise GeneratorInvalid(what, where=type(self.generator).__name__)
        rows = self._padded(self._rows(made))
        color = self._padded(self._color(made))
        return rows, color, self._count(made)

    def _rows(self, made: Gaussians) -> Tensor:
        n = made.position.shape[0]
        if n > self.packed.capacity:
            raise GeneratorInvalid(
                f"{n} Gaussians do not fit the capacity {self.packed.capacity}",
                where="capacity",
                mend=f"Export with a capacity of {n} or more.",
            )
        opacity = made.opacity.reshape(n, 1)
        if made.count is not None:
            live = torch.arange(n, device=opacity.device) < made.count.reshape(1)
            opacity = opacity * live[:, None].to(opacity.dtype)
        return torch.cat([made.position, opacity, made.covariances()], dim=1)

    def _color(self, made: Gaussians) -> Tensor:
        if made.sh is not None:
            return made.sh.flatten(1)
        assert made.rgb is not None
        channels = appearance_channels("rgb", None, self.packed.dtype.itemsize)
        if channels == made.rgb.shape[1]:
            return made.rgb
        # Not a column of ones: that would be stored.
        return torch.nn.functional.pad(made.rgb, (0, 1), value=1.0)

    def _padded(self, rows: Tensor) -> Tensor:
        missing = self.packed.capacity - rows.shape[0]
        rows = rows.to(self.packed.dtype)
        return (
            torch.cat([rows, rows.new_zeros(missing, rows.shape[1])]) if missing else rows
        )

    def _count(self, made: Gaussians) -> Tensor:
        n = made.position.shape[0]
        if made.count is None:
            return torch.full((1,), n, dtype=torch.int32)
        return made.count.reshape(1).clamp(0, n).to(torch.int32)
