"""Packs, casts, pads and names the outputs of a user's torch module for ONNX export."""

__all__ = ["Packed", "PackedGenerator", "check_whole_cells"]

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.contract.spec.layout import appearance_channels
from gsgen.sdk.authoring.cells import Cells
from gsgen.sdk.authoring.generator import GaussianGenerator, Gaussians
from gsgen.sdk.errors import GeneratorInvalid


def check_whole_cells(capacity: int, per_cell: int) -> None:
    """Raise if the capacity is not a multiple of ``per_cell``, the Gaussians per cell."""
    if capacity % per_cell:
        message = (
            f"{capacity} packed Gaussians are not a multiple of {per_cell}, the size of a cell"
        )
        hint = f"Export with a capacity that {per_cell} divides."
        raise GeneratorInvalid(message, where="capacity", hint=hint)


@dataclass(frozen=True, slots=True)
class Packed:
    """The dtype of a generator's packed outputs, and their capacity (number of rows)."""

    dtype: torch.dtype  # float32 or float16, for all outputs except the count
    capacity: int  # number of rows of the outputs; rows after the Gaussians are zero


class PackedGenerator(nn.Module):
    """Wraps a Gaussian generator as a torch module with outputs in the packed layout."""

    def __init__(self, generator: GaussianGenerator, packed: Packed) -> None:
        super().__init__()
        self.generator = generator
        self.packed = packed

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Return ``(gaussians, appearance, num_points)``, and ``cells`` for weighted blending."""
        gaussians = self.generator(*inputs)
        if not isinstance(gaussians, Gaussians):
            message = f"forward returned {type(gaussians).__name__}, expected gsgen.sdk.Gaussians"
            raise GeneratorInvalid(message, where=type(self.generator).__name__)
        rows = self._padded(self._rows(gaussians))
        color = self._padded(self._color(gaussians))
        outputs = (rows, color, self._count_tensor(gaussians))
        if gaussians.cells is None:
            return outputs
        return (*outputs, self._cells(gaussians, gaussians.cells))

    def _rows(self, gaussians: Gaussians) -> Tensor:
        n = gaussians.position.shape[0]
        if n > self.packed.capacity:
            message = f"{n} Gaussians do not fit the capacity {self.packed.capacity}"
            hint = f"Export with a capacity of {n} or more."
            raise GeneratorInvalid(message, where="capacity", hint=hint)
        opacity = gaussians.opacity.reshape(n, 1)
        if gaussians.count is not None:
            live_mask = torch.arange(n, device=opacity.device) < gaussians.count.reshape(1)
            opacity = opacity * live_mask[:, None].to(opacity.dtype)
        return torch.cat([gaussians.position, opacity, gaussians.covariances()], dim=1)

    def _color(self, gaussians: Gaussians) -> Tensor:
        if gaussians.sh is not None:
            return gaussians.sh.flatten(1)
        assert gaussians.rgb is not None
        channels = appearance_channels("rgb", None, self.packed.dtype.itemsize)
        if channels == gaussians.rgb.shape[1]:
            return gaussians.rgb
        # Padding, because a column of ones would be stored in the file.
        return torch.nn.functional.pad(gaussians.rgb, (0, 1), value=1.0)

    def _cells(self, gaussians: Gaussians, cells: Cells) -> Float[Tensor, "c 10"]:
        """Pack the cells (groups) of Gaussians; cells after the row count get visibility 0."""
        n, c = gaussians.position.shape[0], cells.position.shape[0]
        per_cell = n // c
        check_whole_cells(self.packed.capacity, per_cell)
        visibility = cells.visibility.reshape(c, 1)
        if gaussians.count is not None:
            first = torch.arange(c, device=visibility.device) * per_cell
            live_mask = first < gaussians.count.reshape(1)
            visibility = visibility * live_mask[:, None].to(visibility.dtype)
        rows = torch.cat([cells.position, visibility, cells.covariances()], dim=1)
        return self._padded(rows, self.packed.capacity // per_cell)

    def _padded(self, rows: Tensor, size: int | None = None) -> Tensor:
        missing = (self.packed.capacity if size is None else size) - rows.shape[0]
        rows = rows.to(self.packed.dtype)
        # A mask that an input reaches gives a number of rows that only the frame knows.
        is_full = isinstance(missing, int) and not missing
        return rows if is_full else torch.cat([rows, rows.new_zeros(missing, rows.shape[1])])

    def _count_tensor(self, gaussians: Gaussians) -> Tensor:
        n = gaussians.position.shape[0]
        if gaussians.count is None:
            return torch.full((1,), n, dtype=torch.int32)
        return gaussians.count.reshape(1).clamp(0, n).to(torch.int32)
