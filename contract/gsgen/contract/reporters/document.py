"""The JSON report as dataclasses; its published schema is made from them.

Fields that hold nothing are left out. Fields may be added within a major version of the schema;
none changes its meaning.
"""

__all__ = ["SCHEMA", "SCHEMA_FILE", "Document", "schema"]

from dataclasses import dataclass
from typing import Annotated, Literal

from gsgen.contract.spec.json_schema import schema_of
from gsgen.contract.spec.schema_text import Hint

SCHEMA = "gsgen-report/1"
SCHEMA_FILE = "report-1.schema.json"

SchemaName = Annotated[Literal["gsgen-report/1"], Hint("Name and major version.")]
SeverityName = Literal["error", "warning", "info"]
RuleId = Annotated[
    str, Hint("A rule's id.", pattern=r"^([a-z][a-z0-9-]*/)?[A-Z]{2}[0-9]{3}$")
]
Fingerprint = Annotated[
    str,
    Hint("The same over runs, machines and numbers of rows.", pattern="^[0-9a-f]{16}$"),
]


@dataclass(frozen=True, slots=True)
class Tool:
    """What judged."""

    name: str
    version: str
    rules_digest: Annotated[
        str,
        Hint(
            "Over what the rules declare: equal where they are.",
            pattern="^sha256:[0-9a-f]{64}$",
        ),
    ]


@dataclass(frozen=True, slots=True)
class SubjectEntry:
    """What was judged."""

    uri: Annotated[str, Hint("The model, as it was named.")]
    bytes: Annotated[int | None, Hint("Size of the file.", minimum=0)] = None
    sha256: Annotated[
        str | None,
        Hint(
            "Of the file, without its external data; absent where only the static level ran on "
            "64 MiB or more.",
            pattern="^[0-9a-f]{64}$",
        ),
    ] = None
    kind: Annotated[str | None, Hint("Kind of model, where known.")] = None
    name: Annotated[str | None, Hint("What the manifest calls it.")] = None
    contract: Annotated[
        str | None, Hint("Contract version that the manifest declares.")
    ] = None
    capacity: Annotated[int | None, Hint("Rows of the Gaussian output, where fixed.")] = (
        None
    )


@dataclass(frozen=True, slots=True)
class Counts:
    """How many findings count, of each severity, and how many do not; rules by status."""

    error: int
    warning: int
    info: int
    waived: Annotated[int, Hint("Findings that are ignored or waived.")]
    known: Annotated[int, Hint("Findings that stood in the baseline already.")]
    rules: dict[str, int]


@dataclass(frozen=True, slots=True)
class LevelEntry:
    """A level of validation, and whether it ran."""

    level: str
    status: Literal["ran", "skipped"]
    reason: str | None = None


@dataclass(frozen=True, slots=True)
class WhereEntry:
    """The place of a finding."""

    subject: Annotated[str, Hint("Such as `output gaussians` or `manifest bounds`.")]
    field: Annotated[str | None, Hint("The field of a packed row.")] = None


@dataclass(frozen=True, slots=True)
class ExampleEntry:
    """One offending row or thing."""

    value: str
    row: int | None = None
    probe: Annotated[str | None, Hint("Label of the inputs that gave it.")] = None


@dataclass(frozen=True, slots=True)
class Stats:
    """How much of it."""

    count: Annotated[int, Hint("Rows or things that break the rule; never capped.")]
    total: Annotated[int, Hint("Rows or things that were judged.")]
    examples: Annotated[tuple[ExampleEntry, ...], Hint("The first few.")]
    worst: ExampleEntry | None = None


@dataclass(frozen=True, slots=True)
class FindingEntry:
    """One rule that does not hold at one place."""

    rule: RuleId
    slug: Annotated[str, Hint("The rule's readable name.")]
    severity: SeverityName
    certainty: Literal["confirmed", "possible"]
    where: WhereEntry
    message: Annotated[str, Hint("What was seen and what was wanted.")]
    stats: Stats
    why: Annotated[str, Hint("What invalid because of it.")]
    hint: Annotated[str, Hint("What to do about it.")]
    source: Annotated[str, Hint("`contract`, or the target that raised it.")]
    waived: Annotated[
        bool, Hint("It does not count: its rule is ignored, or it is waived.")
    ]
    known: Annotated[bool, Hint("It does not count: it stood in the baseline already.")]
    truncated: Annotated[bool, Hint("It counts what was found at further places, too.")]
    fingerprint: Fingerprint
    help: Annotated[
        str | None, Hint("The rule's page, from the root of the documentation.")
    ] = None
    waiver: Annotated[str | None, Hint("The reason that its waiver gives.")] = None
    evidence: Annotated[
        str | None, Hint("Location the rule was seen to break something.")
    ] = None


@dataclass(frozen=True, slots=True)
class CauseEntry:
    """A rule that does not hold, and the rules that could not be judged because of it."""

    rule: RuleId
    status: str
    findings: Annotated[tuple[Fingerprint, ...], Hint("Those of the rule.")]
    blocked: Annotated[tuple[RuleId, ...], Hint("The rules that could not be judged.")]


@dataclass(frozen=True, slots=True)
class RuleEntry:
    """What became of one rule."""

    id: RuleId
    status: Literal["pass", "fail", "skipped", "not-applicable", "crashed"]
    reason: Annotated[str | None, Hint("Why it was not judged, or how it crashed.")] = None
    ms: Annotated[float | None, Hint("Milliseconds spent in its check.")] = None
    items: Annotated[int | None, Hint("Rows or things it looked at.")] = None


@dataclass(frozen=True, slots=True)
class ToleranceEntry:
    """How closely executions of the model must agree in one field."""

    field: str
    value: float
    unit: str
    source: Literal["default", "manifest", "config"]


@dataclass(frozen=True, slots=True)
class GoneEntry:
    """A finding of the baseline that is not there any more."""

    rule: RuleId
    slug: Annotated[str, Hint("The rule's readable name.")]
    where: WhereEntry
    message: Annotated[str, Hint("What was seen then.")]
    fingerprint: Fingerprint


@dataclass(frozen=True, slots=True)
class Document:
    """The report of one model."""

    schema: SchemaName
    tool: Tool
    subject: SubjectEntry
    target: Annotated[str, Hint("What it was judged for, name@version.")]
    level: Annotated[str, Hint("How far the validation was asked to go.")]
    fail_on: Annotated[SeverityName, Hint("The lowest severity that fails.")]
    settings: Annotated[str, Hint("Location the settings came from.")]
    verdict: Literal["conforms", "invalid", "internal-error"]
    counts: Counts
    levels: tuple[LevelEntry, ...]
    findings: Annotated[tuple[FindingEntry, ...], Hint("Worst first.")]
    causes: tuple[CauseEntry, ...]
    rules: Annotated[tuple[RuleEntry, ...], Hint("Every installed rule.")]
    tolerances: tuple[ToleranceEntry, ...]
    probes: Annotated[
        tuple[str, ...], Hint("Labels of the inputs that value rules actual.")
    ]
    environment: Annotated[dict[str, str], Hint("Versions of what ran.")]
    truncated: Annotated[bool, Hint("Some finding counts more places than its own.")]
    seconds: float
    baseline: Annotated[str | None, Hint("The report whose findings are known.")] = None
    gone: Annotated[
        tuple[GoneEntry, ...] | None,
        Hint("What the baseline lists and what is not there any more; absent without one."),
    ] = None


@dataclass(frozen=True, slots=True)
class Fault:
    """Why a file could not be judged."""

    message: str
    where: str
    hint: str


@dataclass(frozen=True, slots=True)
class UnreadableDocument:
    """What stands for a model that could not be read."""

    schema: SchemaName
    subject: SubjectEntry
    verdict: Literal["unreadable"]
    error: Fault


@dataclass(frozen=True, slots=True)
class Batch:
    """The reports of several models."""

    schema: SchemaName
    reports: tuple[Document | UnreadableDocument, ...]


def schema() -> dict[str, object]:
    """Return the JSON Schema that every report follows."""
    made = schema_of(Batch, title=f"gsgen report: {SCHEMA}")
    definitions = made["$defs"]
    assert isinstance(definitions, dict)
    kept = ("type", "description", "properties", "patternProperties")
    batch = {key: made[key] for key in (*kept, "additionalProperties", "required")}
    names = ("Document", "UnreadableDocument", "Batch")
    return {
        "$schema": made["$schema"],
        "title": made["title"],
        "anyOf": [{"$ref": f"#/$defs/{name}"} for name in names],
        "$defs": dict(sorted({**definitions, "Batch": batch}.items())),
    }
