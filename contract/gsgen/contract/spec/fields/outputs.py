"""Manifest fields of model outputs, for each kind of model."""

__all__ = [
    "AppearanceOutput",
    "CellsOutput",
    "CountOutput",
    "FutureOutput",
    "GaussiansOutput",
    "GeneratorOutputs",
    "ImageOutput",
    "PostProcessOutputs",
    "TrajectoryOutputs",
    "UncertaintyOutput",
]

from dataclasses import KW_ONLY, dataclass
from typing import Annotated, Literal

from gsgen.contract.spec.fields.json_schema import Hint
from gsgen.contract.spec.fields.values import Name, Positive


@dataclass(frozen=True, slots=True)
class GaussiansOutput:
    """The output with packed Gaussians, [capacity, 10]: x y z opacity xx xy xz yy yz zz."""

    name: Name
    capacity: Annotated[int, Hint(text="Rows of the tensor, padding included.", minimum=1)]
    dtype: Literal["float32", "float16"] = "float32"
    layout: Literal["packed10"] = "packed10"


@dataclass(frozen=True, slots=True)
class AppearanceOutput:
    """The output with the Gaussians' colours, [capacity, channels]."""

    name: Name
    space: Annotated[
        Literal["sh", "rgb"],
        Hint(text="`sh`: coefficient-major, RGB innermost. `rgb`: raw colour."),
    ]
    degree: Annotated[
        int | None, Hint(text="SH degree; required for `sh`.", minimum=0, maximum=3)
    ] = None
    color_space: Literal["srgb", "linear"] = "srgb"
    _: KW_ONLY
    range: Annotated[
        tuple[float, float] | None, Hint(text="Lowest and highest `rgb`; [0, 1] if absent.")
    ] = None


@dataclass(frozen=True, slots=True)
class CountOutput:
    """The output with the number of live Gaussian rows, int32 [1]; later rows are padding."""

    name: Name
    semantics: Annotated[
        Literal["exact", "upper-bound"],
        Hint(
            text="`exact`: every row before it is drawn. `upper-bound`: some of them may be inert."
        ),
    ] = "exact"


@dataclass(frozen=True, slots=True)
class CellsOutput:
    """The output with cells (groups of Gaussians) for weighted blending, [capacity / per_cell, 10].

    A row is x y z visibility xx xy xz yy yz zz; Gaussian r belongs to cell r // per_cell.
    """

    name: Name
    per_cell: Annotated[int, Hint(text="Rows of Gaussians in a row to one cell.", minimum=1)]
    dtype: Literal["float32", "float16"] = "float32"


@dataclass(frozen=True, slots=True)
class GeneratorOutputs:
    """The outputs of a Gaussian Generator: Gaussians, appearance, row count, cells (groups)."""

    gaussians: GaussiansOutput | None = None
    appearance: AppearanceOutput | None = None
    count: CountOutput | None = None
    cells: CellsOutput | None = None


@dataclass(frozen=True, slots=True)
class ImageOutput:
    """The image output of a post-process model, [1, 3 or 4, H, W], ``scale`` times its input's size."""

    name: Name
    dtype: Literal["float32", "float16"] = "float32"
    range: Annotated[tuple[float, float], Hint(text="Values of black and white.")] = (0.0, 1.0)
    color_space: Literal["srgb", "linear"] = "srgb"
    _: KW_ONLY
    scale: Annotated[
        int, Hint(text="Height and width, as multiples of those of the input image.", minimum=1)
    ] = 1


@dataclass(frozen=True, slots=True)
class PostProcessOutputs:
    """The output of a post-process model."""

    image: ImageOutput


@dataclass(frozen=True, slots=True)
class FutureOutput:
    """The output with predicted camera states, [time steps, values], nearest in time first."""

    name: Name
    steps: Positive
    representation: Literal["position+quaternion-wxyz", "position+axis-angle"]


@dataclass(frozen=True, slots=True)
class UncertaintyOutput:
    """The output with the uncertainty of predicted camera states, one row per time step."""

    name: Name
    semantics: Literal["standard-deviation", "covariance-upper"] = "standard-deviation"


@dataclass(frozen=True, slots=True)
class TrajectoryOutputs:
    """The outputs of a camera-trajectory predictor: future camera states, and uncertainty."""

    future: FutureOutput
    uncertainty: UncertaintyOutput
