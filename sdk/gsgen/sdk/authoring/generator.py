"""The base class of Gaussian generators: torch modules with declared inputs."""

__all__ = ["GaussianGenerator", "Gaussians"]

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, ClassVar, Literal

from jaxtyping import Float, Int
from torch import Tensor, nn

from gsgen.contract.spec.manifest import Input, Producer, Space, WeightedSum
from gsgen.contract.spec.spherical_harmonics import MAX_DEGREE, SH_COEFFICIENT_COUNTS
from gsgen.sdk.authoring.cells import Cells, expect_shape, expect_spread
from gsgen.sdk.errors import GeneratorInvalid
from gsgen.sdk.math import covariance_upper


@dataclass(frozen=True, slots=True)
class Gaussians:
    """N Gaussians in the model's local space, as torch tensors of float32 or float16.

    Pass either ``scale`` and ``rotation`` or ``covariance``, and either ``sh`` or ``rgb``.

    Attributes:
        position: Centres, [N, 3].
        opacity: Opacity after activation in [0, 1], [N] or [N, 1].
        scale: Linear standard deviations, [N, 3] (after ``exp`` if the method stores logarithms).
        rotation: Quaternions (w, x, y, z), [N, 4]; need not be normalised.
        covariance: Upper triangle xx xy xz yy yz zz, [N, 6].
        sh: Spherical harmonics, coefficient-major, [N, K, 3] with K = 1, 4, 9 or 16.
        rgb: Raw colour in [0, 1], [N, 3].
        count: Number of live rows at the front, an integer tensor of one element; all if absent.
        cells: Cells of N / C Gaussians each, in the order of the rows, for a generator with a
            ``weighted_sum``.

    Raises:
        GeneratorInvalid: A shape differs, or two alternatives are passed, or none of them.
    """

    position: Float[Tensor, "n 3"]
    opacity: Float[Tensor, "..."]
    scale: Float[Tensor, "n 3"] | None = None
    rotation: Float[Tensor, "n 4"] | None = None
    _: KW_ONLY
    covariance: Float[Tensor, "n 6"] | None = None
    sh: Float[Tensor, "n k 3"] | None = None
    rgb: Float[Tensor, "n 3"] | None = None
    count: Int[Tensor, "..."] | None = None
    cells: Cells | None = None

    def __post_init__(self) -> None:
        expect_spread(self.scale, self.rotation, self.covariance, "Gaussians")
        if (self.sh is None) == (self.rgb is None):
            raise GeneratorInvalid("give colours as exactly one of sh and rgb", where="Gaussians")
        n = self.position.shape[0]
        for name, width in (("position", 3), ("scale", 3), ("rotation", 4), ("covariance", 6)):
            self._require_shape(name, (n, width))
        self._require_shape("rgb", (n, 3))
        self._require_shape("opacity", (n,), (n, 1))
        self._require_shape("sh", *((n, k, 3) for k in SH_COEFFICIENT_COUNTS))
        if self.count is not None and self.count.numel() != 1:
            count_shape = list(self.count.shape)
            message = f"shape is {count_shape}, expected one element"
            raise GeneratorInvalid(message, where="Gaussians.count")
        cells = 0 if self.cells is None else self.cells.position.shape[0]
        if self.cells is not None and (not cells or n % cells):
            message = f"{n} Gaussians do not fill {cells} cells equally"
            raise GeneratorInvalid(message, where="Gaussians.cells")

    def _require_shape(self, name: str, *shapes: tuple[int, ...]) -> None:
        value: Tensor | None = getattr(self, name)
        if value is None:
            return
        hint = ""
        if name == "sh" and value.ndim == 3 and value.shape[1] == 3:
            hint = "It looks channel-major [N, 3, K]: transpose(1, 2) makes it coefficient-major."
        if name == "sh" and value.ndim == 2:
            hint = "Reshape to [N, K, 3]; f_rest of a 3DGS PLY is channel-major: [N, 3, K-1] first."
        if name == "sh" and value.ndim == 3 and value.shape[1] > SH_COEFFICIENT_COUNTS[-1]:
            hint = (
                f"Harmonics end at degree {MAX_DEGREE} in every viewer: "
                f"gsgen.sdk.math.sh_of_degree(sh, {MAX_DEGREE}) leaves the higher ones out."
            )
        expect_shape(f"Gaussians.{name}", value, *shapes, hint=hint)

    def take(self, rows: Int[Tensor, " m"], count: Int[Tensor, "1"] | None = None) -> "Gaussians":
        """Return the Gaussians at the given row indices, in their order.

        Args:
            rows: Row indices, for example from :func:`gsgen.sdk.math.keep_rows`.
            count: Number of live rows; all if absent.

        Raises:
            GeneratorInvalid: The Gaussians belong to cells, which single rows cannot leave.
        """
        if self.cells is not None:
            hint = "Select cells, and create the Gaussians of these cells only."
            message = "Gaussians cannot be taken out of their cells"
            raise GeneratorInvalid(message, where="Gaussians.take", hint=hint)
        fields = ("position", "opacity", "scale", "rotation", "covariance", "sh", "rgb")
        selected = {
            name: value.index_select(0, rows)
            for name in fields
            if (value := getattr(self, name)) is not None
        }
        return Gaussians(**selected, count=count)

    def covariances(self) -> Float[Tensor, "n 6"]:
        """Return the upper triangles of the covariances, computed from scale and rotation if needed."""
        if self.covariance is not None:
            return self.covariance
        assert self.scale is not None
        assert self.rotation is not None
        return covariance_upper(self.scale, self.rotation)


class GaussianGenerator(nn.Module, ABC):
    """Base class of Gaussian generators: a torch module that returns Gaussians for every frame.

    Subclasses set the class attributes below (or set them on the instance) and write
    ``forward``, which takes the declared inputs in order and returns :class:`Gaussians`.

    Attributes:
        inputs: Frame inputs, from the functions of :mod:`gsgen.sdk.authoring.inputs`.
        space: Coordinate frame and matrix memory order.
        color_space: Colour space of the colours from SH or RGB.
        color_range: Lowest and highest RGB of a method that clips the picture, not its splats;
            [0, 1] if absent.
        antialias: How the model was trained: ``classic`` (0.3 px dilation) or ``mip``.
        depends_on: Input or role → whether outputs change with it; those not named do.
        count_semantics: ``upper-bound`` if rows before the count may have opacity 0.
        family: ``static``, ``mlp``, ``4d``, ``avatar`` or another word.
        producer: Tool, source and licence; the SDK itself if absent.
        weighted_sum: The weights of Gaussians, for methods that sum them cell by cell instead of
            sorting them: ``forward`` then returns :attr:`Gaussians.cells`.
        smaller: Options of ``gsgen export`` that make a frame smaller, for the hint where it is too
            large for the target.
    """

    inputs: Sequence[Input] = ()
    space: Space = Space()
    color_space: Literal["srgb", "linear"] = "srgb"
    color_range: tuple[float, float] | None = None
    antialias: Literal["classic", "mip"] = "classic"
    depends_on: ClassVar[dict[str, bool]] = {}
    count_semantics: Literal["exact", "upper-bound"] = "exact"
    family: str | None = None
    producer: Producer | None = None
    weighted_sum: WeightedSum | None = None
    smaller: Sequence[str] = ()

    @abstractmethod
    def forward(self, *inputs: Any, **_: Any) -> Any:
        """Return the :class:`Gaussians` of one frame for the values of the declared inputs.

        Args:
            inputs: One tensor for each declared input, in order, of its role's shape and dtype.
        """
