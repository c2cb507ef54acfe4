"""The result of a validation as data, which reporters convert to text, JSON and others."""

__all__ = [
    "REPORT_SCHEMA_FILE",
    "Cause",
    "Entry",
    "LevelOutcome",
    "Outcome",
    "Picture",
    "Report",
    "ResolvedFinding",
    "Status",
    "Tolerance",
    "Unreadable",
    "exit_code",
]

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import ClassVar, Literal

from gsgen.contract.errors import ExitCode, GsgenError
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.spec.targets import Target
from gsgen.contract.validation.finding import Finding, Location
from gsgen.contract.validation.rule import Rule

# The published schema of JSON reports, among the package's schemas.
REPORT_SCHEMA_FILE = "report-1.schema.json"

Status = Literal["pass", "fail", "skipped", "not-applicable", "crashed"]
Verdict = Literal["conforms", "invalid", "internal-error"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """The outcome of one validation rule: pass, fail, skipped, not-applicable or crashed.

    Attributes:
        rule: The rule.
        status: ``pass``, ``fail``, ``skipped``, ``not-applicable`` or ``crashed``.
        reason: Why the rule was skipped, does not apply or crashed; empty otherwise.
        milliseconds: Time spent in its check.
        items: The number of checked rows or values.
        blocked_by: The failed rule that prevents this check.
    """

    rule: Rule
    status: Status
    reason: str = ""
    milliseconds: float = 0.0
    items: int = 0
    blocked_by: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelOutcome:
    """Whether a validation level ran, or why not; its number of model runs, and the seconds taken.

    Attributes:
        level: The level.
        ran: Whether it ran.
        reason: Why it did not run; else empty.
        runs: How often it ran the model in ONNX Runtime on the CPU.
        seconds: Time of these runs and of the level's rules, without the start of ONNX Runtime.
    """

    level: Level
    ran: bool
    reason: str = ""
    runs: int = 0
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class Cause:
    """A failed validation rule, and the rules that could not be checked because of it."""

    outcome: Outcome
    blocked_rules: tuple[Rule, ...]


@dataclass(frozen=True, slots=True)
class Tolerance:
    """The largest tolerated difference of one field, e.g. opacity, between two executions.

    Attributes:
        field: The field, such as ``position``.
        value: The largest allowed difference.
        unit: The unit of the value.
        source: ``config`` if the settings give it, else ``manifest``, else ``default``.
    """

    field: str
    value: float
    unit: str
    source: Literal["default", "manifest", "config"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolvedFinding:
    """A finding of an earlier report (the baseline) that no longer occurs.

    Attributes:
        rule: Id of its rule.
        slug: The rule's readable name.
        fingerprint: Identifier of the fault.
        where: The location.
        message: The message of the earlier report.
    """

    rule: str
    slug: str
    fingerprint: str
    where: Location
    message: str


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture of a validated model for one set of test inputs, or why no picture was drawn.

    Attributes:
        probe: Label of the probe.
        png: The picture; empty if there is none.
        problem: Why there is none; else empty.
    """

    probe: str = ""
    png: bytes = b""
    problem: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """The result of validating one model.

    Attributes:
        path: The model, as given by the caller.
        size: Bytes of the file.
        kind: The kind of model, if known.
        name: The manifest's name for it.
        contract: The contract version in the manifest; empty without one.
        capacity: Rows of the Gaussian output, where static.
        target: The consumer that the model was validated for.
        level: The requested level.
        fail_on: The lowest severity that fails.
        findings: Worst first; ignored ones included, marked as waived.
        outcomes: The outcome of every installed rule, in catalogue order.
        levels: Whether each level ran.
        probes: Labels of the probes whose outputs were checked.
        environment: Versions of the libraries and drivers that ran.
        settings: The source of the settings.
        seconds: Wall-clock time of the validation.
        runtime_seconds: The part of it that ONNX Runtime's process took.
        sha256: Digest of the file; empty where it was not computed.
        tolerances: The largest allowed difference of each field between two executions.
        baseline: The earlier report whose findings are known; empty without one.
        resolved: The findings of the baseline that do not occur any more.
        external_size: Bytes of the file's external data.
        required: Rules that must have been checked.
        selected: The only rules that were requested; empty for all.
        timed: Reporters show times, so that two reports of equal input differ.
        docs_url: Root of the published documentation; empty if unknown.
        picture: The model drawn at one probe; None where nothing was drawn.
        moments: Labels of the named moments at which the model ran.
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
    resolved: tuple[ResolvedFinding, ...] = ()
    external_size: int = 0
    required: frozenset[str] = frozenset()
    selected: frozenset[str] = frozenset()
    timed: bool = False
    docs_url: str = ""
    picture: Picture | None = None
    moments: tuple[str, ...] = ()
    # How a report is printed; the validator, which is above the reporters, sets it.
    to_text: ClassVar[Callable[["Report"], str]] = repr

    @property
    def not_checked(self) -> tuple[Outcome, ...]:
        """The validation rules that were skipped although their level ran."""
        levels_run = {outcome.level for outcome in self.levels if outcome.ran}
        return tuple(
            outcome
            for outcome in self.outcomes
            if outcome.status == "skipped" and outcome.rule.level in levels_run
        )

    @property
    def unchecked(self) -> tuple[Outcome, ...]:
        """The required validation rules whose check neither passed nor failed."""
        required = (outcome for outcome in self.outcomes if outcome.rule.id in self.required)
        return tuple(outcome for outcome in required if outcome.status not in ("pass", "fail"))

    @property
    def verdict(self) -> Verdict:
        """The report's verdict: ``conforms``, ``invalid``, or ``internal-error`` after a crash."""
        if any(outcome.status == "crashed" for outcome in self.outcomes):
            return "internal-error"
        return "invalid" if any(self.fails_by(finding) for finding in self.findings) else "conforms"

    def fails_by(self, finding: Finding) -> bool:
        """Return whether a finding alone makes the model invalid."""
        is_confirmed_finding = finding.counts and finding.certainty == "confirmed"
        return is_confirmed_finding and finding.severity >= self.fail_on

    def count(self, severity: Severity) -> int:
        """Return the number of findings of a severity, except waived and baseline findings."""
        return sum(f.severity == severity and f.counts for f in self.findings)

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The failed contract rules that prevented the check of other rules, in catalogue order."""
        blocked_rules: dict[str, list[Rule]] = {}
        for outcome in self.outcomes:
            if outcome.blocked_by:
                blocked_rules.setdefault(outcome.blocked_by, []).append(outcome.rule)
        roots = (outcome for outcome in self.outcomes if outcome.rule.id in blocked_rules)
        return tuple(Cause(root, tuple(blocked_rules[root.rule.id])) for root in roots)

    @property
    def statuses(self) -> Counter[str]:
        """The number of validation rules by outcome, such as passed or skipped."""
        return Counter(outcome.status for outcome in self.outcomes)

    def outcome(self, rule_id: str) -> Outcome:
        """Return the outcome of one validation rule of the report.

        Raises:
            KeyError: The rule is not installed.
        """
        for outcome in self.outcomes:
            if outcome.rule.id == rule_id:
                return outcome
        raise KeyError(rule_id)

    def __str__(self) -> str:
        """Return the report as ``gsgen validate`` prints it."""
        return type(self).to_text(self)

    def __repr__(self) -> str:
        counts = ", ".join(f"{self.count(entry)} of severity {entry.word}" for entry in Severity)
        return f"<Report: {self.path}: {self.verdict}, {counts}>"

    def _repr_html_(self) -> str:
        """Return the validation report's conclusion and findings as HTML, for notebooks."""
        from gsgen.contract._notebook import summary_html

        checked = f"for {self.target.name}, at level {self.level.word}; {self.statuses['pass']} rules hold"
        findings = [
            (
                f"{finding.rule} {finding.severity.word}",
                f"{finding.where.subject}: {finding.message}",
            )
            for finding in self.findings
        ]
        picture = (self.picture.png or None) if self.picture else None
        return summary_html(
            f"{self.path}: {self.verdict}", [("checked", checked), *findings], picture
        )


@dataclass(frozen=True, slots=True)
class Unreadable:
    """A model file that could not be read, and the error."""

    path: str
    error: GsgenError


# The result for one file.
Entry = Report | Unreadable


def exit_code(reports: Iterable[Report]) -> ExitCode:
    """Return the exit code for reports: 0 if all models conform, 3 if a rule crashed, else 1.

    A required rule that was not checked fails, too.
    """
    report_list = list(reports)
    verdicts = {report.verdict for report in report_list}
    if "internal-error" in verdicts:
        return ExitCode.INTERNAL
    has_failure = "invalid" in verdicts or any(report.unchecked for report in report_list)
    return ExitCode.FAILURE if has_failure else ExitCode.SUCCESS
