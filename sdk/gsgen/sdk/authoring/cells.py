"""Cells: groups of Gaussians that weighted blending sorts instead of single Gaussians."""

__all__ = ["Cells", "expect_shape", "expect_spread"]

from dataclasses import KW_ONLY, dataclass

from jaxtyping import Float
from torch import Tensor

from gsgen.sdk.errors import GeneratorInvalid
from gsgen.sdk.math import covariance_upper


@dataclass(frozen=True, slots=True)
class Cells:
    """C cells in local space, each a group of equally many consecutive Gaussians.

    Pass either ``scale`` and ``rotation`` or ``covariance``.

    Attributes:
        position: Centres, [C, 3]: renderers sort by their depth.
        visibility: Factor in [0, 1] for the weights of the cell's Gaussians, [C] or [C, 1]; at 0
            they are not drawn.
        scale: Linear standard deviations, [C, 3]; all of the cell is drawn within about twice
            of the ellipsoid's longest axis on the screen.
        rotation: Quaternions (w, x, y, z), [C, 4]; need not be normalised.
        covariance: Upper triangle xx xy xz yy yz zz, [C, 6].

    Raises:
        GeneratorInvalid: A shape differs, or two alternatives are passed, or none of them.
    """

    position: Float[Tensor, "c 3"]
    visibility: Float[Tensor, "..."]
    scale: Float[Tensor, "c 3"] | None = None
    rotation: Float[Tensor, "c 4"] | None = None
    _: KW_ONLY
    covariance: Float[Tensor, "c 6"] | None = None

    def __post_init__(self) -> None:
        expect_spread(self.scale, self.rotation, self.covariance, "Cells")
        c = self.position.shape[0]
        expect_shape("Cells.position", self.position, (c, 3))
        expect_shape("Cells.visibility", self.visibility, (c,), (c, 1))
        expect_shape("Cells.scale", self.scale, (c, 3))
        expect_shape("Cells.rotation", self.rotation, (c, 4))
        expect_shape("Cells.covariance", self.covariance, (c, 6))

    def covariances(self) -> Float[Tensor, "c 6"]:
        """Return the upper triangles of the covariances, computed from scale and rotation if needed."""
        if self.covariance is not None:
            return self.covariance
        assert self.scale is not None
        assert self.rotation is not None
        return covariance_upper(self.scale, self.rotation)


def expect_shape(
    where: str, value: Tensor | None, *shapes: tuple[int, ...], hint: str = ""
) -> None:
    """Raise if a tensor's shape is not one of the allowed shapes; None passes."""
    if value is None or tuple(value.shape) in shapes:
        return
    expected = " or ".join(str(list(shape)) for shape in shapes)
    message = f"shape is {list(value.shape)}, expected {expected}"
    raise GeneratorInvalid(message, where=where, hint=hint)


def expect_spread(
    scale: Tensor | None, rotation: Tensor | None, covariance: Tensor | None, where: str
) -> None:
    """Raise unless Gaussians have either scales and rotations, or covariances."""
    has_covariance_parts = (scale is not None, rotation is not None, covariance is not None)
    if has_covariance_parts not in ((True, True, False), (False, False, True)):
        raise GeneratorInvalid(
            "the extent is missing or given twice, expected either scale and rotation, or covariance",
            where=where,
        )
