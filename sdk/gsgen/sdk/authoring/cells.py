"""The cells of a method that blends by a weighted sum: what is sorted in place of Gaussians."""

__all__ = ["Cells", "expect_shape", "expect_spread"]

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from gsgen.sdk.errors import GeneratorInvalid
from gsgen.sdk.math import covariance_upper


@dataclass(frozen=True, slots=True)
class Cells:
    """C cells in the model's local space; each holds an equal number of Gaussians in a row.

    Shape is given either by ``scale`` and ``rotation`` or by ``covariance``.

    Attributes:
        position: Centres, [C, 3]: renderers sort by their depth.
        visibility: How much is seen of the cell's Gaussians, in [0, 1], [C] or [C, 1]; their
            weights are multiplied by it, and at 0 they are not drawn.
        scale: Linear standard deviations, [C, 3]; all of the cell is drawn within about twice
            of the ellipsoid's longest axis on the screen.
        rotation: Quaternions (w, x, y, z), [C, 4]; need not be normalised.
        covariance: Upper triangle xx xy xz yy yz zz, [C, 6].

    Raises:
        GeneratorInvalid: A shape is not as above, or a choice is made twice or not at all.
    """

    position: Float[Tensor, "c 3"]
    visibility: Float[Tensor, "..."]
    scale: Float[Tensor, "c 3"] | None = None
    rotation: Float[Tensor, "c 4"] | None = None
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
        """Return the covariance's upper triangle, computed if it was not given."""
        if self.covariance is not None:
            return self.covariance
        assert self.scale is not None
        assert self.rotation is not None
        return covariance_upper(self.scale, self.rotation)


def expect_shape(
    where: str, value: Tensor | None, *shapes: tuple[int, ...], hint: str = ""
) -> None:
    """Refuse a tensor of none of the ``shapes``; an absent one is fine.

    Raises:
        GeneratorInvalid: It has another shape.
    """
    if value is None or tuple(value.shape) in shapes:
        return
    wanted = " or ".join(str(list(shape)) for shape in shapes)
    what = f"shape is {list(value.shape)}, wanted {wanted}"
    raise GeneratorInvalid(what, where=where, hint=hint)


def expect_spread(
    scale: Tensor | None, rotation: Tensor | None, covariance: Tensor | None, where: str
) -> None:
    """Refuse all but a scale with a rotation, or a covariance.

    Raises:
        GeneratorInvalid: Both are given, or neither, or half of one.
    """
    given = (scale is not None, rotation is not None, covariance is not None)
    if given not in ((True, True, False), (False, False, True)):
        raise GeneratorInvalid("give scale and rotation, or covariance", where=where)
