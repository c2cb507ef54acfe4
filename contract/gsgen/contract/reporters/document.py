"""Dataclasses of the JSON validation report, which define the report's published schema.

Empty fields are omitted. A major version of the schema may gain fields, but no field changes its
meaning.
"""

__all__ = ["SCHEMA", "Document", "schema"]

from dataclasses import dataclass
from typing import Annotated, Literal

from gsgen.contract.spec.fields.json_schema import Hint, schema_of

SCHEMA = "gsgen-report/1"

SchemaName = Annotated[Literal["gsgen-report/1"], Hint(text="Name and major version.")]
SeverityName = Literal["error", "warning", "info"]
RuleId = Annotated[str, Hint(text="A rule's id.", pattern=r"^([a-z][a-z0-9-]*/)?[A-Z]{2}[0-9]{3}$")]
Fingerprint = Annotated[
    str, Hint(text="The same over runs, machines and numbers of rows.", pattern="^[0-9a-f]{16}$")
]


@dataclass(frozen=True, slots=True)
class Tool:
    """The name and version of the validator that wrote the report."""

    name: str
    version: str
    rules_digest: Annotated[
        str,
        Hint(
            text="SHA-256 of all rule declarations; equal for equal rules.",
            pattern="^sha256:[0-9a-f]{64}$",
        ),
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class SubjectEntry:
    """The validated model: its path, digest, kind and contract version."""

    uri: Annotated[str, Hint(text="The model, as given on the command line.")]
    bytes: Annotated[int | None, Hint(text="Size of the file.", minimum=0)] = None
    external_bytes: Annotated[
        int | None, Hint(text="Size of its external data; absent without any.", minimum=0)
    ] = None
    sha256: Annotated[
        str | None,
        Hint(
            text="Of the file, without its external data; absent if only the static level ran on a "
            "file of 64 MiB or more.",
            pattern="^[0-9a-f]{64}$",
        ),
    ] = None
    kind: Annotated[str | None, Hint(text="Kind of model, where known.")] = None
    name: Annotated[str | None, Hint(text="The model's name in the manifest.")] = None
    contract: Annotated[str | None, Hint(text="Contract version that the manifest declares.")] = (
        None
    )
    capacity: Annotated[int | None, Hint(text="Rows of the Gaussian output, where fixed.")] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Counts:
    """Counts of findings (by severity, waived, in an earlier report) and of rules by outcome."""

    error: int
    warning: int
    info: int
    waived: Annotated[int, Hint(text="Findings that are ignored or waived.")]
    known: Annotated[int, Hint(text="Findings that the baseline lists already.")]
    rules: dict[str, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelEntry:
    """A validation level, whether it ran, and the model runs and seconds that it took."""

    level: str
    status: Literal["ran", "skipped"]
    reason: str | None = None
    runs: Annotated[int, Hint(text="How often the model ran in ONNX Runtime on the CPU.")] = 0
    seconds: Annotated[
        float | None, Hint(text="Time of runs and rules; only where times were asked for.")
    ] = None


@dataclass(frozen=True, slots=True)
class WhereEntry:
    """The location of a finding: a tensor, node, manifest field or file."""

    subject: Annotated[str, Hint(text="Such as `output gaussians` or `manifest bounds`.")]
    field: Annotated[str | None, Hint(text="The field of a packed row.")] = None


@dataclass(frozen=True, slots=True)
class ExampleEntry:
    """One row or value that breaks a validation rule, as an example in a finding."""

    value: str
    row: int | None = None
    probe: Annotated[str | None, Hint(text="Label of the probe that gave it.")] = None


@dataclass(frozen=True, slots=True)
class Stats:
    """Counts, statistics and example rows of a finding."""

    count: Annotated[int, Hint(text="Rows or values that break the rule; never capped.")]
    total: Annotated[int, Hint(text="Rows or values that were checked.")]
    examples: Annotated[tuple[ExampleEntry, ...], Hint(text="The first few.")]
    worst: ExampleEntry | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class FindingEntry:
    """A finding: one validation rule that a model breaks at one location."""

    rule: RuleId
    slug: Annotated[str, Hint(text="The rule's readable name.")]
    severity: SeverityName
    certainty: Literal["confirmed", "possible"]
    where: WhereEntry
    message: Annotated[str, Hint(text="The actual and the expected value.")]
    stats: Stats
    why: Annotated[str, Hint(text="The damage that the fault causes.")]
    hint: Annotated[str, Hint(text="How to repair the model.")]
    source: Annotated[str, Hint(text="`contract`, or the target that raised it.")]
    waived: Annotated[
        bool, Hint(text="The finding does not count: its rule is ignored, or it is waived.")
    ]
    known: Annotated[bool, Hint(text="The finding does not count: the baseline lists it already.")]
    truncated: Annotated[
        bool, Hint(text="The finding also counts violations at further locations.")
    ]
    fingerprint: Fingerprint
    help: Annotated[
        str | None, Hint(text="The rule's page, from the root of the documentation.")
    ] = None
    waiver: Annotated[str | None, Hint(text="The reason of its waiver.")] = None
    evidence: Annotated[str | None, Hint(text="A documented case of such damage.")] = None


@dataclass(frozen=True, slots=True)
class CauseEntry:
    """A failed validation rule, and the rules that could not be checked because of it."""

    rule: RuleId
    status: str
    findings: Annotated[tuple[Fingerprint, ...], Hint(text="The findings of the rule.")]
    blocked: Annotated[tuple[RuleId, ...], Hint(text="The rules that could not be checked.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class RuleEntry:
    """The outcome of checking one validation rule on the model."""

    id: RuleId
    status: Literal["pass", "fail", "skipped", "not-applicable", "crashed"]
    reason: Annotated[str | None, Hint(text="Why it was not checked, or how it crashed.")] = None
    ms: Annotated[
        float | None, Hint(text="Milliseconds spent in its check; only where times were asked for.")
    ] = None
    items: Annotated[int | None, Hint(text="The number of checked rows or values.")] = None


@dataclass(frozen=True, slots=True)
class UncheckedEntry:
    """A validation rule that is required but was not checked."""

    rule: RuleId
    status: str
    reason: str


@dataclass(frozen=True, slots=True)
class ToleranceEntry:
    """The largest tolerated difference of one field, e.g. opacity, between two executions."""

    field: str
    value: float
    unit: str
    source: Literal["default", "manifest", "config"]


@dataclass(frozen=True, slots=True, kw_only=True)
class GoneEntry:
    """A finding of an earlier report (the baseline) that no longer occurs."""

    rule: RuleId
    slug: Annotated[str, Hint(text="The rule's readable name.")]
    where: WhereEntry
    message: Annotated[str, Hint(text="The message of the earlier report.")]
    fingerprint: Fingerprint


@dataclass(frozen=True, slots=True, kw_only=True)
class Document:
    """The JSON validation report of one model."""

    schema: SchemaName
    tool: Tool
    subject: SubjectEntry
    target: Annotated[
        str, Hint(text="The consumer that the model was validated for, name@version.")
    ]
    level: Annotated[str, Hint(text="The requested level.")]
    fail_on: Annotated[SeverityName, Hint(text="The lowest severity that fails.")]
    settings: Annotated[str, Hint(text="The source of the settings.")]
    verdict: Literal["conforms", "invalid", "internal-error"]
    counts: Counts
    levels: tuple[LevelEntry, ...]
    findings: Annotated[tuple[FindingEntry, ...], Hint(text="Worst first.")]
    causes: tuple[CauseEntry, ...]
    rules: Annotated[tuple[RuleEntry, ...], Hint(text="Every installed rule.")]
    tolerances: tuple[ToleranceEntry, ...]
    probes: Annotated[
        tuple[str, ...], Hint(text="Labels of the probes whose outputs were checked.")
    ]
    environment: Annotated[
        dict[str, str], Hint(text="Versions of the libraries and drivers that ran.")
    ]
    truncated: Annotated[bool, Hint(text="A finding also counts violations at further locations.")]
    seconds: Annotated[float | None, Hint(text="Duration; only where times were asked for.")] = None
    unchecked: Annotated[
        tuple[UncheckedEntry, ...], Hint(text="Required rules that were not checked.")
    ] = ()
    moments: Annotated[
        tuple[str, ...],
        Hint(text="Labels of the named moments at which level behaviour ran the model."),
    ] = ()
    not_checked: Annotated[
        tuple[RuleId, ...],
        Hint(text="Rules of levels that ran, without time or memory for their runs."),
    ] = ()
    baseline: Annotated[str | None, Hint(text="The report whose findings are known.")] = None
    gone: Annotated[
        tuple[GoneEntry, ...] | None,
        Hint(
            text="Findings of the baseline that do not occur any more; absent without a baseline."
        ),
    ] = None


@dataclass(frozen=True, slots=True)
class Fault:
    """The reason why a model file could not be read."""

    message: str
    where: str
    hint: str


@dataclass(frozen=True, slots=True)
class UnreadableDocument:
    """The JSON report of a model file that could not be read."""

    schema: SchemaName
    subject: SubjectEntry
    verdict: Literal["unreadable"]
    error: Fault


@dataclass(frozen=True, slots=True)
class Batch:
    """The JSON validation reports of several models."""

    schema: SchemaName
    reports: tuple[Document | UnreadableDocument, ...]


def schema() -> dict[str, object]:
    """Return the JSON Schema that every JSON validation report follows."""
    batch_schema = schema_of(Batch, title=f"gsgen report: {SCHEMA}")
    definitions = batch_schema["$defs"]
    assert isinstance(definitions, dict)
    keys = ("type", "description", "properties", "patternProperties")
    batch = {key: batch_schema[key] for key in (*keys, "additionalProperties", "required")}
    names = ("Document", "UnreadableDocument", "Batch")
    return {
        "$schema": batch_schema["$schema"],
        "title": batch_schema["title"],
        "anyOf": [{"$ref": f"#/$defs/{name}"} for name in names],
        "$defs": dict(sorted({**definitions, "Batch": batch}.items())),
    }
