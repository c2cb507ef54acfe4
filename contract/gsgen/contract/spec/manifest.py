"""The manifest: the JSON document inside a model that declares the meaning of its tensors.

These dataclasses are the single source of truth. The published JSON Schemas
(``schemas/*.schema.json``) are generated from them by :mod:`gsgen.contract.spec.json_schema`.
"""

__all__ = [
    "AppearanceOutput",
    "Bounds",
    "Capture",
    "CellsOutput",
    "Cost",
    "CountOutput",
    "ExternalData",
    "FutureOutput",
    "GaussiansOutput",
    "GeneratorManifest",
    "GeneratorOutputs",
    "ImageOutput",
    "Input",
    "Joint",
    "Manifest",
    "PostProcessManifest",
    "PostProcessOutputs",
    "Producer",
    "ReferenceImage",
    "Space",
    "TestVector",
    "Tolerances",
    "TrajectoryManifest",
    "TrajectoryOutputs",
    "TrajectoryTolerances",
    "UncertaintyOutput",
    "VectorFile",
    "WeightedSum",
    "manifest_type",
]

import math
from dataclasses import KW_ONLY, dataclass, field
from typing import Annotated, Literal

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.errors import UnknownName
from gsgen.contract.spec.json_schema import Hint
from gsgen.contract.spec.roles import ROLES

CONTRACT = "1.2"

# The rounding error of a time, as a share of a frame.
_FRAME_ROUNDING = 1e-6

RoleName = Annotated[str, Hint(text="What the input means.", enum=tuple(ROLES))]
Name = Annotated[str, Hint(text="The tensor's name in the graph.", min_length=1)]
Positive = Annotated[int, Hint(minimum=1)]
Sha256 = Annotated[str, Hint(text="SHA-256, in lower-case hex.", pattern="^[0-9a-f]{64}$")]
Fraction = Annotated[float, Hint(minimum=0)]
AboveZero = Annotated[float, Hint(above=0)]
ExtensionName = Annotated[
    str, Hint(text="The field of its data: x-writer-name.", pattern="^x-[a-z0-9]+(-[a-z0-9]+)*$")
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Space:
    """The coordinate frame of Gaussians, cameras and bounds."""

    handedness: Literal["right"] = "right"
    up: Annotated[
        Literal["+x", "-x", "+y", "-y", "+z", "-z"], Hint(text="The world's upward axis.")
    ] = "-y"
    unit: Annotated[
        Literal["metre", "arbitrary"],
        Hint(text="What one unit of length is; SfM scenes: arbitrary."),
    ] = "arbitrary"
    matrix_order: Annotated[
        Literal["column", "row"],
        Hint(
            text="`column`: the [4,4] tensor holds Mᵀ, as column-major bytes do. `row`: it holds M."
        ),
    ] = "column"
    origin: Annotated[
        tuple[float, float, float] | None,
        Hint(text="Where the local origin lies in the author's world, in units, as float64."),
    ] = None
    metres_per_unit: Annotated[AboveZero | None, Hint(text="Length of one unit, in metres.")] = None


@dataclass(frozen=True, slots=True)
class Bounds:
    """An axis-aligned box that holds the Gaussians' centres for all inputs (at every probe)."""

    min: Annotated[tuple[float, float, float], Hint(text="Lower corner, x y z.")]
    max: Annotated[tuple[float, float, float], Hint(text="Upper corner, x y z.")]

    @classmethod
    def around(cls, points: Float[np.ndarray, "n 3"], margin: float) -> "Bounds | None":
        """Return the bounding box of all finite points, or None without any finite point.

        Args:
            points: Centres, in local units.
            margin: How much wider the box is, as a share of its size.
        """
        float64_points = np.asarray(points, np.float64)
        finite = float64_points[np.isfinite(float64_points).all(axis=1)]
        if not len(finite):
            return None
        low, high = finite.min(axis=0), finite.max(axis=0)
        room = margin * (high - low) + 1e-6
        corners = [[float(f"{value:.6g}") for value in end] for end in (low - room, high + room)]
        return cls(*((x, y, z) for x, y, z in corners))


@dataclass(frozen=True, slots=True)
class Producer:
    """The author of the model, its sources, and its licence."""

    tool: Annotated[str, Hint(text="Program and version.")]
    source: str | None = None
    license: Annotated[str | None, Hint(text="An SPDX expression.")] = None
    weights_sha256: Sha256 | None = None


@dataclass(frozen=True, slots=True)
class Joint:
    """One joint of a skeleton; joints are listed in the order of a pose's rows."""

    name: Annotated[str, Hint(min_length=1)]
    parent: Annotated[str | None, Hint(text="Name of its parent; absent for a root.")] = None
    rest: Annotated[
        tuple[float, float, float] | None,
        Hint(text="Its position in the rest pose, in local units."),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Input:
    """One model input that a runtime feeds in every frame."""

    name: Name
    role: RoleName
    shape: Annotated[tuple[Positive, ...] | None, Hint(text="Static size of every axis.")] = None
    range: Annotated[
        tuple[float, float] | None,
        Hint(text="Smallest and largest meaningful value, both included."),
    ] = None
    default: Annotated[
        float | Literal["zeros", "identity"] | tuple[float, ...] | None,
        Hint(text="What a runtime feeds if it has nothing better; row-major where a list."),
    ] = None
    convention: Annotated[str | None, Hint(text="Which of the role's conventions it follows.")] = (
        None
    )
    loop: Annotated[
        bool | None, Hint(text="Time: the end of the range continues at its start.")
    ] = None
    frames: Annotated[Positive | None, Hint(text="Time: how many distinct frames there are.")] = (
        None
    )
    fps: Annotated[
        float | None, Hint(text="Time: frames per second at natural speed.", minimum=0)
    ] = None
    label: Annotated[str | None, Hint(text="What a user interface calls it.")] = None
    joints: Annotated[tuple[Joint, ...], Hint(text="Pose: one joint for each row, in order.")] = ()
    rate: Annotated[AboveZero | None, Hint(text="Audio: samples per second.")] = None
    window: Annotated[
        Positive | None, Hint(text="Audio, mel: samples under the window of one column.")
    ] = None
    hop: Annotated[
        Positive | None, Hint(text="Audio, mel: samples from one column to the next.")
    ] = None

    def moment(self, frame: int) -> float:
        """Return the time at which a frame begins; frames divide the range equally."""
        low, high, count = self._frames()
        return low + (high - low) * frame / count

    def frame_at(self, time: float) -> int:
        """Return the frame shown at a time; a loop's end shows the first frame, else the last."""
        low, high, count = self._frames()
        frame = math.floor(count * (time - low) / (high - low) + _FRAME_ROUNDING)
        return frame % count if self.loop else min(max(frame, 0), count - 1)

    def _frames(self) -> tuple[float, float, int]:
        if self.role != "time" or self.range is None or self.frames is None:
            raise ValueError(f"input {self.name!r} is not a time input with a range and frames")
        return *self.range, self.frames


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
    """The output with the number of live rows, int32 [1]; all rows after it are padding."""

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
    """The outputs of a Gaussian Generator: Gaussians, appearance, row count, optionally cells."""

    gaussians: GaussiansOutput | None = None
    appearance: AppearanceOutput | None = None
    count: CountOutput | None = None
    cells: CellsOutput | None = None


@dataclass(frozen=True, slots=True)
class WeightedSum:
    """Parameters of weighted blending cell by cell, required by `blend: wsr`."""

    background: Annotated[Fraction, Hint(text="Weight of the background.")]
    depth_range: Annotated[
        AboveZero | None,
        Hint(text="Depth at which weights reach 0, in units of length; absent: they do not fall."),
    ] = None
    opacity_divisor: Annotated[
        AboveZero, Hint(text="What opacity is divided by before it takes light away.")
    ] = 1.0


@dataclass(frozen=True, slots=True)
class Capture:
    """The model's promises to a runtime that records its GPU kernels once (graph capture)."""

    static_shapes: bool = True


@dataclass(frozen=True, slots=True)
class Tolerances:
    """The largest differences between two executions of the model, each field in its unit."""

    position: Annotated[Fraction, Hint(text="In standard deviations of the Gaussian.")] = 1e-3
    covariance: Annotated[Fraction, Hint(text="Relative to the covariance's trace.")] = 1e-3
    opacity: Annotated[Fraction, Hint(text="Absolute.")] = 2e-3
    appearance: Annotated[Fraction, Hint(text="Absolute, of the colour seen from a direction.")] = (
        2e-3
    )


@dataclass(frozen=True, slots=True)
class VectorFile:
    """The file with one input of a test vector: an ONNX TensorProto."""

    input: Annotated[str, Hint(text="The tensor's name in the graph.", min_length=1)]
    path: Annotated[str, Hint(text="A file in the model's folder or below it.", min_length=1)]
    sha256: Sha256


@dataclass(frozen=True, slots=True)
class TestVector:
    """A named set of test inputs, and the digest of the outputs that the model promises for it."""

    inputs: Annotated[str, Hint(text="Which probe, by its label.")]
    expected_sha256: Sha256
    seed: Annotated[int, Hint(text="Seed of the probe set.", minimum=0)] = 0
    files: Annotated[
        tuple[VectorFile, ...], Hint(text="The inputs as files, for readers without the probe set.")
    ] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceImage:
    """A picture beside the model, and the camera from which a render of the model matches it.

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
    psnr: Annotated[AboveZero, Hint(text="Least peak signal-to-noise ratio, in decibels.")] = 40.0
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


@dataclass(frozen=True, slots=True, kw_only=True)
class _Common:
    """The manifest fields of every kind of model."""

    name: Annotated[str, Hint(text="What people call the model.", min_length=1)]
    inputs: tuple[Input, ...] = ()
    version: Annotated[str, Hint(text="The model's own version.")] = "1.0.0"
    family: Annotated[str | None, Hint(text="Method family: static, mlp, 4d, avatar, …")] = None
    producer: Producer | None = None
    test_vectors: tuple[TestVector, ...] = ()
    contract: Annotated[
        str, Hint(text="Contract version, major.minor.", pattern=r"^[0-9]+\.[0-9]+$")
    ] = CONTRACT
    extensions_used: Annotated[
        tuple[ExtensionName, ...], Hint(text="Registered extensions that the manifest uses.")
    ] = ()
    extensions_required: Annotated[
        tuple[ExtensionName, ...], Hint(text="Those without which the model is misread.")
    ] = ()
    operator_profile: Annotated[
        str | None, Hint(text="The operators that suffice to run it: a profile's name.")
    ] = None
    external_data: tuple[ExternalData, ...] = ()
    cost: tuple[Cost, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class GeneratorManifest(_Common):
    """The manifest of a Gaussian Generator: frame inputs → packed Gaussians."""

    outputs: GeneratorOutputs
    space: Space | None = None
    bounds: Bounds | None = None
    depends_on: Annotated[
        dict[str, bool],
        Hint(text="Input or role → does any output change with it; absent means yes."),
    ] = field(default_factory=dict)
    antialias: Annotated[
        Literal["classic", "mip"], Hint(text="`classic`: 0.3 px dilation. `mip`: compensated.")
    ] = "classic"
    blend: Annotated[
        Literal["alpha", "wsr"], Hint(text="`alpha`: sorted. `wsr`: weighted sum with cells.")
    ] = "alpha"
    weighted_sum: WeightedSum | None = None
    capture: Capture = Capture()
    tolerances: Tolerances | None = None
    reference_images: tuple[ReferenceImage, ...] = ()
    kind: Literal["gaussian-generator"] = "gaussian-generator"

    def depends(self, entry: Input) -> bool:
        """Return whether the outputs may change with an input, as `depends_on` declares."""
        return self.depends_on.get(entry.name, self.depends_on.get(entry.role, True))


@dataclass(frozen=True, slots=True)
class ImageOutput:
    """The image output of a post-process model, [1, 3 or 4, H, W], as large as its input image."""

    name: Name
    dtype: Literal["float32", "float16"] = "float32"
    range: Annotated[tuple[float, float], Hint(text="Values of black and white.")] = (0.0, 1.0)
    color_space: Literal["srgb", "linear"] = "srgb"


@dataclass(frozen=True, slots=True)
class PostProcessOutputs:
    """The output of a post-process model."""

    image: ImageOutput


@dataclass(frozen=True, slots=True, kw_only=True)
class PostProcessManifest(_Common):
    """The manifest of a post-process model: image (and conditioning) → image."""

    outputs: PostProcessOutputs
    image_range: Annotated[
        tuple[float, float], Hint(text="Values of black and white in the input image.")
    ] = (0.0, 1.0)
    capture: Capture = Capture()
    kind: Literal["post-process"] = "post-process"


@dataclass(frozen=True, slots=True)
class FutureOutput:
    """The output with predicted camera states, [steps, S], the nearest in time first."""

    name: Name
    steps: Positive
    representation: Literal["position+quaternion-wxyz", "position+axis-angle"]


@dataclass(frozen=True, slots=True)
class UncertaintyOutput:
    """The output with the uncertainty of predicted camera states, one row per step."""

    name: Name
    semantics: Literal["standard-deviation", "covariance-upper"] = "standard-deviation"


@dataclass(frozen=True, slots=True)
class TrajectoryOutputs:
    """The outputs of a trajectory predictor."""

    future: FutureOutput
    uncertainty: UncertaintyOutput


@dataclass(frozen=True, slots=True)
class TrajectoryTolerances:
    """The largest differences between two executions of a trajectory predictor."""

    position: Annotated[Fraction, Hint(text="In units of length.")] = 1e-3
    rotation: Annotated[Fraction, Hint(text="Angle between two rotations, in radians.")] = 1e-3
    uncertainty: Annotated[Fraction, Hint(text="Relative.")] = 1e-2


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryManifest(_Common):
    """The manifest of a trajectory predictor: past camera states → future states, uncertainty."""

    outputs: TrajectoryOutputs
    step_seconds: Annotated[float, Hint(text="Time between two states, in seconds.", minimum=0)]
    space: Space | None = None
    tolerances: TrajectoryTolerances | None = None
    kind: Literal["trajectory-predictor"] = "trajectory-predictor"


Manifest = GeneratorManifest | PostProcessManifest | TrajectoryManifest

_TYPES: dict[str, type[GeneratorManifest] | type[PostProcessManifest] | type[TrajectoryManifest]]
_TYPES = {
    "gaussian-generator": GeneratorManifest,
    "post-process": PostProcessManifest,
    "trajectory-predictor": TrajectoryManifest,
}


def manifest_type(
    kind: str,
) -> type[GeneratorManifest] | type[PostProcessManifest] | type[TrajectoryManifest]:
    """Return the manifest's dataclass for a model of ``kind``.

    Raises:
        UnknownName: The kind does not exist.
    """
    if kind not in _TYPES:
        raise UnknownName.among("kind", kind, _TYPES)
    return _TYPES[kind]
