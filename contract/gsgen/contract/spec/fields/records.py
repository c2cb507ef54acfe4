"""Facts about a model that its author recorded: sources, test vectors, pictures, cost."""

__all__ = [
    "Cost",
    "ExternalData",
    "Producer",
    "ReferenceImage",
    "TestVector",
    "VectorFile",
    "VectorInput",
    "VectorRows",
]

from dataclasses import dataclass
from typing import Annotated, Literal

from gsgen.contract.spec.fields.json_schema import Hint
from gsgen.contract.spec.fields.scene import Tolerances
from gsgen.contract.spec.fields.values import Fraction, Name, PositiveFloat, RowNumber, Sha256


@dataclass(frozen=True, slots=True)
class Producer:
    """The author of the model, its sources, and its licence."""

    tool: Annotated[str, Hint(text="Program and version.")]
    source: str | None = None
    license: Annotated[str | None, Hint(text="An SPDX expression.")] = None
    weights_sha256: Sha256 | None = None


@dataclass(frozen=True, slots=True)
class VectorFile:
    """The file with one input of a test vector: an ONNX TensorProto."""

    input: Annotated[str, Hint(text="The tensor's name in the graph.", min_length=1)]
    path: Annotated[str, Hint(text="A file in the model's folder or below it.", min_length=1)]
    sha256: Sha256


@dataclass(frozen=True, slots=True)
class VectorInput:
    """The numbers of one input of a test vector, inside the manifest."""

    input: Name
    shape: tuple[int, ...]
    values: Annotated[tuple[float, ...], Hint(text="All numbers, in row-major order.")]


@dataclass(frozen=True, slots=True)
class VectorRows:
    """Some rows of one output, as the original (torch) model computed them for a test vector."""

    output: Name
    rows: Annotated[tuple[RowNumber, ...], Hint(text="Row numbers, along the first axis.")]
    values: Annotated[
        tuple[tuple[float, ...], ...], Hint(text="The numbers of each row, in the order of `rows`.")
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class TestVector:
    """A named set of test inputs, and the digest of the outputs that the model promises for it."""

    inputs: Annotated[str, Hint(text="Which probe, by its label.")]
    expected_sha256: Sha256
    seed: Annotated[int, Hint(text="Seed of the probe set.", minimum=0)] = 0
    files: Annotated[
        tuple[VectorFile, ...], Hint(text="The inputs as files, for readers without the probe set.")
    ] = ()
    values: Annotated[
        tuple[VectorInput, ...], Hint(text="The inputs themselves, instead of the probe's.")
    ] = ()
    outputs: Annotated[
        tuple[VectorRows, ...], Hint(text="Rows of the source's outputs for `values`.")
    ] = ()
    tolerances: Annotated[
        Tolerances | None, Hint(text="For `outputs`; absent: the manifest's.")
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceImage:
    """A reference picture of the model, and the camera from which a render matches it.

    The camera looks along +z, x is right and y down; colours are over black.
    """

    path: Annotated[str, Hint(text="A PNG in the model's folder or below it.", min_length=1)]
    sha256: Sha256
    inputs: Annotated[str, Hint(text="Which probe, by its label.", min_length=1)]
    view: Annotated[
        tuple[tuple[float, float, float, float], ...],
        Hint(text="World to camera: the first three rows of the matrix."),
    ]
    focal: Annotated[tuple[float, float], Hint(text="Focal lengths in x and y, in pixels.")]
    center: Annotated[tuple[float, float], Hint(text="Principal point, in pixels from the corner.")]
    psnr: Annotated[PositiveFloat, Hint(text="Least peak signal-to-noise ratio, in decibels.")] = (
        40.0
    )
    from_: Annotated[
        Literal["model", "source"],
        Hint(text="`source`: drawn by the training code. `model`: by this model, as it was then."),
    ] = "model"


@dataclass(frozen=True, slots=True)
class Cost:
    """The declared time and memory that one frame takes on one device."""

    device: Annotated[str, Hint(text="The device, as its driver calls it.", min_length=1)]
    milliseconds: Annotated[Fraction | None, Hint(text="Median time of one run.")] = None
    bytes: Annotated[
        int | None, Hint(text="Peak memory of a session, weights included.", minimum=0)
    ] = None


@dataclass(frozen=True, slots=True)
class ExternalData:
    """A file with external weights of the model, and the file's digest."""

    path: Annotated[str, Hint(text="As the model writes it: its `location`.", min_length=1)]
    sha256: Sha256
