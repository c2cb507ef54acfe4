"""Dataclasses of a viewer test kit's index.json and result file, and of their JSON Schemas.

The kit itself is written and checked without them, so that its script needs NumPy alone. A major
version of a schema may gain fields, but no field changes its meaning.
"""

__all__ = ["INDEX_SCHEMA_FILE", "RESULT_SCHEMA_FILE", "viewer_kit_schemas"]

from dataclasses import dataclass
from typing import Annotated, Final, Literal

from gsgen.contract.spec.fields.json_schema import Hint, schema_of

INDEX_SCHEMA_FILE: Final = "viewer-kit-1.schema.json"
"""File name of the schema of index.json."""

RESULT_SCHEMA_FILE: Final = "viewer-kit-result-1.schema.json"
"""File name of the schema of a result."""

Verdict = Literal["passed", "failed"]
Row = tuple[float, float, float, float]
Share = Annotated[float, Hint(minimum=0, maximum=1)]
Pixels = Annotated[float, Hint(exclusive_minimum=0)]
Picture = Annotated[str, Hint(text="File name of a picture, without its suffix.", min_length=1)]
CaseName = Annotated[str, Hint(text="Name of a case.", min_length=1)]
RuleId = Annotated[str, Hint(pattern="^[A-Z]{2}[0-9]{3}$")]


@dataclass(frozen=True, slots=True, kw_only=True)
class Tool:
    """The name and version of the program that wrote a viewer test kit."""

    name: str
    version: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """The largest differences from the reference with which a viewer's picture passes."""

    pixel: Annotated[Share, Hint(text="Difference of a channel of a pixel.")]
    share: Annotated[Share, Hint(text="Share of the pixels that may differ by more.")]
    mean: Annotated[Share, Hint(text="Mean difference of all channels.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """A rendering fault of viewers, and the test cases whose pictures the fault changes."""

    id: str
    title: Annotated[str, Hint(text="What the viewer does.")]
    hint: Annotated[str, Hint(text="The repair.")]
    cases: tuple[CaseName, ...]
    slight: Annotated[
        tuple[CaseName, ...], Hint(text="Cases that the fault may leave within the tolerance.")
    ] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraEntry:
    """A pinhole camera with +x right, +y down and +z forward."""

    view: Annotated[
        tuple[Row, Row, Row, Row],
        Hint(text="World → camera, row by row, acting on column vectors."),
    ]
    fx: Annotated[Pixels, Hint(text="Horizontal focal length, in pixels.")]
    fy: Annotated[Pixels, Hint(text="Vertical focal length, in pixels.")]
    cx: Annotated[float, Hint(text="Principal point from the left edge, in pixels.")]
    cy: Annotated[float, Hint(text="Principal point from the upper edge, in pixels.")]
    width: Annotated[int, Hint(minimum=1)]
    height: Annotated[int, Hint(minimum=1)]
    near: Annotated[
        float, Hint(text="Distance of the near plane, in world units.", exclusive_minimum=0)
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameEntry:
    """One frame to draw: the camera, and the values of the model's inputs."""

    picture: Picture
    camera: CameraEntry
    values: Annotated[
        dict[str, float], Hint(text="By input name; an input that is absent has its default.")
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class CaseEntry:
    """A viewer test case: a model, and the frames that a viewer draws of that model in order."""

    name: CaseName
    tests: Annotated[str, Hint(text="What the pictures depend on.")]
    model: Annotated[str, Hint(text="Path of the model, relative to index.json.")]
    faults: Annotated[tuple[str, ...], Hint(text="The ids of faults that spoil a picture.")]
    frames: tuple[FrameEntry, ...]
    breaks: Annotated[tuple[RuleId, ...], Hint(text="Rules that the model breaks on purpose.")] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Index:
    """The index.json of a viewer test kit: test cases, viewer faults and image tolerance."""

    schema: Literal["gsgen-viewer-kit/1"]
    tool: Tool
    tolerance: Tolerance
    faults: tuple[Fault, ...]
    cases: tuple[CaseEntry, ...]
    tolerance_8_bits: Annotated[Tolerance | None, Hint(text="The tolerance of PNGs.")] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Counts:
    """The number of viewer test cases that passed, and of those that failed."""

    passed: Annotated[int, Hint(minimum=0)]
    failed: Annotated[int, Hint(minimum=0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureCounts:
    """The number of pictures of a kit, of those that are missing, and that cannot be read."""

    total: Annotated[int, Hint(minimum=0)]
    missing: Annotated[int, Hint(minimum=0)]
    unreadable: Annotated[int, Hint(minimum=0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Exceeded:
    """A limit of the tolerance that a picture exceeds."""

    limit: Literal["share", "mean"]
    actual: Share
    expected: Annotated[Share, Hint(text="The largest value with which a picture passes.")]
    message: str


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameResult:
    """One frame's differences from the reference picture, or why a picture cannot be read."""

    picture: Picture
    verdict: Verdict
    problem: str | None = None
    max: Annotated[Share | None, Hint(text="Largest difference of a channel.")] = None
    mean: Annotated[Share | None, Hint(text="Mean difference.")] = None
    share: Annotated[Share | None, Hint(text="Share of the pixels beyond the tolerance.")] = None
    exceeded: Annotated[tuple[Exceeded, ...], Hint(text="The limits that are exceeded.")] = ()
    cause: Annotated[
        Literal["missing", "unreadable"] | None, Hint(text="The kind of a problem.")
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CaseResult:
    """Whether a viewer passed one test case, and the results of the case's frames."""

    name: CaseName
    verdict: Verdict
    tests: str
    frames: tuple[FrameResult, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """The result of comparing a viewer's pictures with a test kit's reference pictures."""

    schema: Literal["gsgen-viewer-kit-result/1"]
    verdict: Verdict
    counts: Counts
    tolerance: Tolerance
    faults: Annotated[tuple[Fault, ...], Hint(text="The suspected faults.")]
    cases: tuple[CaseResult, ...]
    tolerance_8_bits: Annotated[Tolerance | None, Hint(text="The tolerance of PNGs.")] = None
    pictures: PictureCounts | None = None


def viewer_kit_schemas() -> dict[str, dict[str, object]]:
    """Return the JSON Schemas of a viewer test kit's index.json and result file, by file name."""
    index = schema_of(Index, title="gsgen viewer kit: index.json")
    definitions = index["$defs"]
    assert isinstance(definitions, dict)
    # An input's value is a number, or a list of any depth, which no dataclass describes.
    tensor = {"$ref": "#/$defs/Tensor"}
    definitions["FrameEntry"]["properties"]["values"]["additionalProperties"] = tensor
    definitions["Tensor"] = {
        "anyOf": [{"type": "number"}, {"type": "boolean"}, {"type": "array", "items": tensor}]
    }
    result = schema_of(Result, title="gsgen viewer kit: result")
    return {INDEX_SCHEMA_FILE: index, RESULT_SCHEMA_FILE: result}
