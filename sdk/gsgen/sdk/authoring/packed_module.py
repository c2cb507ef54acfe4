"""Between an author's module and the contract: pack, cast, pad and name the outputs."""

__all__ = [
    "APPEARANCE_RGB",
    "APPEARANCE_SH",
    "CELLS",
    "COUNT",
    "GAUSSIANS",
    "Packed",
    "PackedGenerator",
    "output_names",
    "refuse_parts",
]

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.contract.spec.layout import appearance_channels
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.sdk.authoring.cells import Cells
from gsgen.sdk.authoring.generator import GaussianGenerator, Gaussians
from gsgen.sdk.errors import GeneratorInvalid

# Names that every consumer we know binds right; the Visionary viewer looks for `gauss` in front
# and for `color` inside.
GAUSSIANS = "gaussians"
APPEARANCE_SH = "color_sh"
APPEARANCE_RGB = "color_rgb"
COUNT = "num_points"
CELLS = "cells"


def output_names(manifest: GeneratorManifest) -> tuple[str, ...]:
    """Return what the outputs of an exported model are called, in their order in the graph."""
    appearance = manifest.outputs.appearance
    assert appearance is not None
    names = (GAUSSIANS, appearance.name, COUNT)
    return names if manifest.outputs.cells is None else (*names, CELLS)


def refuse_parts(capacity: int, per_cell: int) -> None:
    """Refuse a capacity that ends within a cell of ``per_cell`` rows.

    Raises:
        GeneratorInvalid: It does.
    """
    if capacity % per_cell:
        raise GeneratorInvalid(
            f"{capacity} rows are no whole number of cells of {per_cell}",
            where="capacity",
            hint=f"Export with a capacity that {per_cell} divides.",
        )


@dataclass(frozen=True, slots=True)
class Packed:
    """How outputs are packed.

    Attributes:
        dtype: float32 or float16, of all outputs but the count.
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

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Return ``(gaussians, appearance, num_points)``, and ``cells`` where there are some."""
        made = self.generator(*inputs)
        if not isinstance(made, Gaussians):
            what = f"forward returned {type(made).__name__}, wanted gsgen.sdk.Gaussians"
            raise GeneratorInvalid(what, where=type(self.generator).__name__)
        rows = self._padded(self._rows(made))
        color = self._padded(self._color(made))
        outputs = (rows, color, self._count(made))
        return outputs if made.cells is None else (*outputs, self._cells(made, made.cells))

    def _rows(self, made: Gaussians) -> Tensor:
        n = made.position.shape[0]
        if n > self.packed.capacity:
            raise GeneratorInvalid(
                f"{n} Gaussians do not fit the capacity {self.packed.capacity}",
                where="capacity",
                hint=f"Export with a capacity of {n} or more.",
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

    def _cells(self, made: Gaussians, cells: Cells) -> Float[Tensor, "c 10"]:
        """Pack cells; those of which no Gaussian is live are not visible."""
        n, c = made.position.shape[0], cells.position.shape[0]
        per_cell = n // c
        refuse_parts(self.packed.capacity, per_cell)
        visibility = cells.visibility.reshape(c, 1)
        if made.count is not None:
            first = torch.arange(c, device=visibility.device) * per_cell
            live = first < made.count.reshape(1)
            visibility = visibility * live[:, None].to(visibility.dtype)
        rows = torch.cat([cells.position, visibility, cells.covariances()], dim=1)
        return self._padded(rows, self.packed.capacity // per_cell)

    def _padded(self, rows: Tensor, size: int | None = None) -> Tensor:
        missing = (self.packed.capacity if size is None else size) - rows.shape[0]
        rows = rows.to(self.packed.dtype)
        return (
            torch.cat([rows, rows.new_zeros(missing, rows.shape[1])]) if missing else rows
        )

    def _count(self, made: Gaussians) -> Tensor:
        n = made.position.shape[0]
        if made.count is None:
            return torch.full((1,), n, dtype=torch.int32)
        return made.count.reshape(1).clamp(0, n).to(torch.int32)
