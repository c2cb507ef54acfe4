"""The result of a validation, as data; reporters turn it into text, JSON and more."""

__all__ = [
    "Cause",
    "Entry",
    "Gone",
    "LevelOutcome",
    "Outcome",
    "Report",
    "Status",
    "Tolerance",
    "Unreadable",
    "exit_code",
]

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.spec.targets import Target
from gsgen.contract.validation.finding import Finding, Location
from gsgen.contract.validation.rule import Rule

Status = Literal["pass", "fail", "skipped", "not-applicable", "crashed"]
Verdict = Literal["conforms", "invalid", "internal-error"]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one rule.

    Attributes:
        rule: The rule.
        status: ``pass``, ``fail``, ``skipped``, ``not-applicable`` or ``crashed``.
        reason: Why it was skipped, does not apply or crashed; empty otherwise.
        milliseconds: Time spent in its check.
        items: Rows or things it looked at.
        blocked_by: The failed rule that keeps this one from being judged.
    """

    rule: Rule
    status: Status
    reason: str = ""
    milliseconds: float = 0.0
    items: int = 0
    blocked_by: str = ""


@dataclass(frozen=True, slots=True)
class LevelOutcome:
    """Whether a level ran, and if not, why."""

    level: Level
    ran: bool
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Cause:
    """A rule that does not hold, and those that could not be judged because of it."""

    outcome: Outcome
    blocked: tuple[Rule, ...]


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How closely executions of a model must agree in one field.

    Attributes:
        field: Such as ``position``.
        value: The largest difference.
        unit: What it is measured in.
        source: ``config`` where settings say so, else ``manifest``, else ``default``.
    """

    field: str
    value: float
    unit: str
    source: Literal["default", "manifest", "config"]


@dataclass(frozen=True, slots=True)
class Gone:
    """A finding that stood in the baseline, and that is not there any more.

    Attributes:
        rule: Id of its rule.
        slug: The rule's readable name.
        fingerprint: What it was told by.
        where: The place.
        message: What was seen then.
    """

    rule: str
    slug: str
    fingerprint: str
    where: Location
    message: str


@dataclass(frozen=True, slots=True)
class Report:
    """Everything a validation found out.

    Attributes:
        path: The model, as it was named.
        size: Bytes of the file.
        kind: The kind of model, if known.
        name: The manifest's name for it.
        contract: The version the manifest declares; empty if it has none.
        capacity: Rows of the Gaussian output, where static.
        target: What it was judged for.
        level: How far the validation was asked to go.
        fail_on: The lowest severity that fails.
        findings: Worst first; ignored ones included, marked as waived.
        outcomes: Every installed rule, in catalogue order.
        levels: Every level, and whether it ran.
        probes: Labels of the probes that value rules looked at.
        environment: Versions of what ran.
        settings: Where the settings came from.
        seconds: Wall-clock time, and what ONNX Runtime's process took of it.
        sha256: Digest of the file; empty where it was not computed.
        tolerances: How closely executions must agree, field by field.
        baseline: The earlier report whose findings are known; empty without one.
        gone: What that report lists and what does not break its rule any more.
    """

    path: str
    size: int
    kind: str
    name: str
    contract: str
    capacity: int | None
    target: Target
    level: Level
    fail_on: Severity
    findings: tuple[Finding, ...]
    outcomes: tuple[Outcome, ...]
    levels: tuple[LevelOutcome, ...]
    probes: tuple[str, ...] = ()
    environment: dict[str, str] = field(default_factory=dict)
    settings: str = "defaults"
    seconds: float = 0.0
    runtime_seconds: float = 0.0
    sha256: str = ""
    tolerances: tuple[Tolerance, ...] = ()
    baseline: str = ""
    gone: tuple[Gone, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """``conforms``, ``invalid``, or ``internal-error`` where a rule crashed."""
        if any(outcome.status == "crashed" for outcome in self.outcomes):
            return "internal-error"
        return (
            "invalid"
            if any(self.fails_by(finding) for finding in self.findings)
            else "conforms"
        )

    def fails_by(self, finding: Finding) -> bool:
        """Say whether ``finding`` alone makes the model invalid."""
        confirmed = finding.counts and finding.certainty == "confirmed"
        return confirmed and finding.severity >= self.fail_on

    def count(self, severity: Severity) -> int:
        """Return how many findings of ``severity`` count."""
        return sum(f.severity == severity and f.counts for f in self.findings)

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The rules that keep others from being judged, in catalogue order."""
        blocked: dict[str, list[Rule]] = {}
        for outcome in self.outcomes:
            if outcome.blocked_by:
                blocked.setdefault(outcome.blocked_by, []).append(outcome.rule)
        roots = (outcome for outcome in self.outcomes if outcome.rule.id in blocked)
        return tuple(Cause(root, tuple(blocked[root.rule.id])) for root in roots)

    @property
    def statuses(self) -> Counter[str]:
        """How many rules have each status."""
        return Counter(outcome.status for outcome in self.outcomes)

    def outcome(self, rule_id: str) -> Outcome:
        """Return the outcome of one rule; raises KeyError if it is not installed."""
        for outcome in self.outcomes:
            if outcome.rule.id == rule_id:
                return outcome
        raise KeyError(rule_id)


@dataclass(frozen=True, slots=True)
class Unreadable:
    """A file that could not be judged at all, and why."""

    path: str
    error: GsgenError


# What becomes of one file that was to be validated.
Entry = Report | Unreadable


def exit_code(reports: Iterable[Report]) -> int:
    """Return 0 if all conform, 1 if one is invalid, 3 if a rule crashed."""
    verdicts = {report.verdict for report in reports}
    if "internal-error" in verdicts:
        return 3
    return 1 if "invalid" in verdicts else 0
