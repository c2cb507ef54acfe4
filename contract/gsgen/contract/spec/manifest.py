"""The manifest: the JSON document inside a model that declares the meaning of its tensors.

These dataclasses, and those of :mod:`gsgen.contract.spec.fields`, are the single source of truth.
The published JSON Schemas (``schemas/*.schema.json``) are generated from them by
:mod:`gsgen.contract.spec.fields.json_schema`.
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
    "VectorInput",
    "VectorRows",
    "WeightedSum",
    "manifest_type",
]

from dataclasses import dataclass, field
from typing import Annotated, Literal

from gsgen.contract.errors import UnknownName
from gsgen.contract.spec.fields.inputs import Input, Joint
from gsgen.contract.spec.fields.json_schema import Hint
from gsgen.contract.spec.fields.outputs import (
    AppearanceOutput,
    CellsOutput,
    CountOutput,
    FutureOutput,
    GaussiansOutput,
    GeneratorOutputs,
    ImageOutput,
    PostProcessOutputs,
    TrajectoryOutputs,
    UncertaintyOutput,
)
from gsgen.contract.spec.fields.records import (
    Cost,
    ExternalData,
    Producer,
    ReferenceImage,
    TestVector,
    VectorFile,
    VectorInput,
    VectorRows,
)
from gsgen.contract.spec.fields.scene import Bounds, Space, Tolerances, WeightedSum
from gsgen.contract.spec.fields.values import ExtensionName, Fraction
from gsgen.contract.spec.upgrades import CONTRACT_VERSION


@dataclass(frozen=True, slots=True)
class Capture:
    """The model's promises to a runtime that records its GPU kernels once (graph capture)."""

    static_shapes: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class _BaseManifest:
    """The manifest fields of every kind of model."""

    name: Annotated[str, Hint(text="What people call the model.", min_length=1)]
    inputs: tuple[Input, ...] = ()
    version: Annotated[str, Hint(text="The model's own version.")] = "1.0.0"
    family: Annotated[str | None, Hint(text="Method family: static, mlp, 4d, avatar, …")] = None
    producer: Producer | None = None
    test_vectors: tuple[TestVector, ...] = ()
    contract: Annotated[
        str, Hint(text="Contract version, major.minor.", pattern=r"^[0-9]+\.[0-9]+$")
    ] = CONTRACT_VERSION
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
class GeneratorManifest(_BaseManifest):
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


@dataclass(frozen=True, slots=True, kw_only=True)
class PostProcessManifest(_BaseManifest):
    """The manifest of a post-process model: image (and conditioning) → image."""

    outputs: PostProcessOutputs
    image_range: Annotated[
        tuple[float, float], Hint(text="Values of black and white in the input image.")
    ] = (0.0, 1.0)
    capture: Capture = Capture()
    kind: Literal["post-process"] = "post-process"


@dataclass(frozen=True, slots=True)
class TrajectoryTolerances:
    """The largest allowed differences between two runs of a trajectory predictor."""

    position: Annotated[Fraction, Hint(text="In units of length.")] = 1e-3
    rotation: Annotated[Fraction, Hint(text="Angle between two rotations, in radians.")] = 1e-3
    uncertainty: Annotated[Fraction, Hint(text="Relative.")] = 1e-2


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryManifest(_BaseManifest):
    """The manifest of a trajectory predictor: past camera states → future states, uncertainty."""

    outputs: TrajectoryOutputs
    step_seconds: Annotated[float, Hint(text="Time between two states, in seconds.", minimum=0)]
    space: Space | None = None
    tolerances: TrajectoryTolerances | None = None
    kind: Literal["trajectory-predictor"] = "trajectory-predictor"


Manifest = GeneratorManifest | PostProcessManifest | TrajectoryManifest

_MANIFEST_TYPES: dict[
    str, type[GeneratorManifest] | type[PostProcessManifest] | type[TrajectoryManifest]
]
_MANIFEST_TYPES = {
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
    if kind not in _MANIFEST_TYPES:
        raise UnknownName.among("kind", kind, _MANIFEST_TYPES)
    return _MANIFEST_TYPES[kind]
