"""Collects the outcome and the findings of every rule in one validation."""

__all__ = ["ResultCollector"]

import time
import traceback
from collections.abc import Iterable
from dataclasses import dataclass, field
from importlib.metadata import version

import numpy as np

from gsgen.contract._entry_points import plugin_exits_as_errors
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.finding import Finding, Violation
from gsgen.contract.validation.finding_counter import FindingCounter
from gsgen.contract.validation.report import LevelOutcome, Outcome, Report, Status
from gsgen.contract.validation.rule import Registry, Rule
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validation.waivers import apply_waivers

_MAX_LOCATIONS = 20
_MAX_CRASH_CHARACTERS = 4000


@dataclass(slots=True, kw_only=True)
class ResultCollector:
    """Collects the outcomes and the violations of all rules in one validation.

    Attributes:
        registry: All rules.
        settings: Severities and waivers.
        kind: The kind of model, empty if unknown.
        outcomes: Rule id → outcome, for all settled rules.
    """

    registry: Registry
    settings: Settings
    kind: str
    outcomes: dict[str, Outcome] = field(default_factory=dict)
    _counters_by_rule: dict[str, dict[str, FindingCounter]] = field(default_factory=dict)
    _seconds_by_rule: dict[str, float] = field(default_factory=dict)

    def ready_rules(self, rules: Iterable[Rule]) -> list[Rule]:
        """Return the validation rules that can be checked now; record an outcome for the others."""
        return [rule for rule in rules if self.is_ready(rule)]

    def is_ready(self, rule: Rule) -> bool:
        """Return whether ``rule`` can be checked now; if not, record why as the rule's outcome."""
        if rule.id in self.outcomes:
            return False
        reason = self._inapplicable_reason(rule)
        if reason:
            self.outcomes[rule.id] = Outcome(rule=rule, status="not-applicable", reason=reason)
            return False
        for needed_rule in rule.needs:
            blocking_rule_id = self._blocking_rule(needed_rule)
            if blocking_rule_id:
                text = f"because {blocking_rule_id} {self._blocking_reason(blocking_rule_id)}"
                self.outcomes[rule.id] = Outcome(
                    rule=rule, status="not-applicable", reason=text, blocked_by=blocking_rule_id
                )
                return False
        return True

    def _inapplicable_reason(self, rule: Rule) -> str:
        target = self.settings.target
        if rule.target and rule.target != target.name:
            return f"only for target {rule.target}"
        if rule.limit and rule.limit not in target.limits:
            return f"target {target.name} sets no limit {rule.limit}"
        if self.kind and self.kind not in rule.kinds:
            return f"only for kind {', '.join(rule.kinds)}"
        return ""

    def _blocking_rule(self, needed_rule: str) -> str:
        outcome = self.outcomes.get(needed_rule)
        if outcome is None:
            return needed_rule
        return (
            needed_rule if outcome.status in ("fail", "crashed", "skipped") else outcome.blocked_by
        )

    def _blocking_reason(self, blocking_rule_id: str) -> str:
        outcome = self.outcomes.get(blocking_rule_id)
        is_rule_skipped = outcome is not None and outcome.status == "skipped"
        return "was not checked" if is_rule_skipped else "does not hold"

    def check(self, rule: Rule, subject: object, probe: str = "", start: int = 0) -> bool:
        """Run the check of a rule once, and count its violations; return False if it crashed."""
        start_time = time.perf_counter()
        try:
            with (
                plugin_exits_as_errors(),
                np.errstate(all="ignore"),
            ):  # outputs may hold NaN and infinity
                for violation in rule.check(subject):
                    self._add(rule, violation, probe, start)
        except Exception:  # a faulty rule must not prevent the report
            self.outcomes[rule.id] = Outcome(rule=rule, status="crashed", reason=_crash_text())
            return False
        finally:
            seconds = time.perf_counter() - start_time
            self._seconds_by_rule[rule.id] = self._seconds_by_rule.get(rule.id, 0.0) + seconds
        return True

    def _add(self, rule: Rule, violation: Violation, probe: str, start: int) -> None:
        counters = self._counters_by_rule.setdefault(rule.id, {})
        key = str(violation.where)
        if key not in counters and len(counters) >= _MAX_LOCATIONS:
            key = next(iter(counters))
            counters[key].truncated = True
        elif key not in counters:
            counters[key] = FindingCounter(
                where=violation.where,
                expected=violation.expected,
                actual=violation.actual,
                certainty=violation.certainty,
            )
        counters[key].add(violation, probe, start)

    def has_failing_finding(self, rule: Rule) -> bool:
        """Return whether the violations so far are enough for a validation rule to fail."""
        return any(
            counter.has_failing_finding
            for counter in self._counters_by_rule.get(rule.id, {}).values()
        )

    def settle(self, rules: Iterable[Rule], items: int = 0) -> None:
        """Convert the counted violations of checked validation rules to pass or fail outcomes."""
        for rule in rules:
            if rule.id in self.outcomes:
                continue
            status: Status = "fail" if self.has_failing_finding(rule) else "pass"
            milliseconds = 1000 * self._seconds_by_rule.get(rule.id, 0.0)
            self.outcomes[rule.id] = Outcome(
                rule=rule, status=status, milliseconds=milliseconds, items=items
            )

    def crash(self, rules: Iterable[Rule]) -> None:
        """Record validation rules as crashed, with the exception that is being handled."""
        reason = _crash_text()
        for rule in rules:
            self.outcomes.setdefault(rule.id, Outcome(rule=rule, status="crashed", reason=reason))

    def exclude(self, rules: Iterable[Rule], reason: str) -> None:
        """Record rules as not applicable to the model, with the reason."""
        for rule in rules:
            outcome = Outcome(rule=rule, status="not-applicable", reason=reason)
            self.outcomes.setdefault(rule.id, outcome)

    def skip(self, rules: Iterable[Rule], reason: str) -> None:
        """Record rules as skipped, with the reason."""
        for rule in rules:
            self.outcomes.setdefault(rule.id, Outcome(rule=rule, status="skipped", reason=reason))

    def withdraw_predictions(self) -> None:
        """Withdraw predicted findings that running the model in WebGPU (level `live`) disproved."""
        if not self.settings.target.runs_natively:
            return
        for rule in self.registry.rules.values():
            settling_outcomes = [self.outcomes.get(id) for id in rule.settled_by]
            is_prediction_confirmed = all(
                outcome is not None and outcome.status == "pass" for outcome in settling_outcomes
            )
            if settling_outcomes and is_prediction_confirmed and rule.id in self._counters_by_rule:
                del self._counters_by_rule[rule.id]
                reason = f"because {' and '.join(rule.settled_by)} hold: level live ran the model"
                outcome = Outcome(rule=rule, status="not-applicable", reason=reason)
                self.outcomes[rule.id] = outcome

    def withdraw_consequences(self) -> None:
        """Withdraw findings that another rule's failure, at a later level, already explains."""
        for rule in self.registry.rules.values():
            causes = [id for id in rule.explained_by if self._does_explain_finding(id)]
            if causes and rule.id in self._counters_by_rule:
                del self._counters_by_rule[rule.id]
                reason = f"because {causes[0]} explains what it found"
                outcome = Outcome(rule=rule, status="not-applicable", reason=reason)
                self.outcomes[rule.id] = outcome

    def _does_explain_finding(self, id: str) -> bool:
        outcome = self.outcomes.get(id)
        return outcome is not None and outcome.status == "fail"

    def findings(self) -> tuple[Finding, ...]:
        """Return all findings: the most severe first, then the likeliest, then in catalogue order.

        Of one severity, what runs of the model showed stands above remarks on its file.
        """
        findings = [
            self._finding_of_rule(rule, counter)
            for rule in self.registry.rules.values()
            for counter in self._counters_by_rule.get(rule.id, {}).values()
            if counter.has_failing_finding
        ]
        return tuple(sorted(findings, key=self._rank))

    def report(
        self, path: str, levels: Iterable[LevelOutcome], start: float, size: int, sha256: str
    ) -> Report:
        """Return the report of a file of another kind than models.

        Args:
            path: The file, as given by the caller.
            levels: The outcomes of the requested levels.
            start: When the validation began, by ``time.perf_counter``.
            size: Bytes of the file.
            sha256: Digest of these bytes.
        """
        settings = self.settings
        return Report(
            path=path,
            size=size,
            kind=self.kind,
            name="",
            contract="",
            capacity=None,
            target=settings.target,
            level=settings.level,
            fail_on=settings.fail_on,
            findings=apply_waivers(self.findings(), settings.waivers, settings.today),
            outcomes=tuple(self.outcomes[id] for id in self.registry.rules),
            levels=tuple(levels),
            environment={"gsgen": version("gsgen")},
            settings=settings.source,
            seconds=time.perf_counter() - start,
            sha256=sha256,
            required=settings.required,
            timed=settings.timings,
            docs_url=settings.docs_url,
        )

    def _rank(self, finding: Finding) -> tuple[int, bool, bool]:
        is_remark = (
            finding.severity < Severity.ERROR
            and self.registry.rules[finding.rule].level is Level.STATIC
        )
        return -finding.severity, is_remark, finding.certainty == "possible"

    def _finding_of_rule(self, rule: Rule, counter: FindingCounter) -> Finding:
        severity: Severity = self.settings.severity_of(rule)
        if counter.certainty == "possible":
            severity = min(severity, Severity.WARNING)  # it alone makes no model invalid
        source = "contract"
        if rule.target or rule.limit or rule.id in self.settings.target.severities:
            source = self.settings.target.label
        return Finding(
            rule=rule.id,
            slug=rule.slug,
            severity=severity,
            where=counter.where,
            message=counter.message(),
            hint=counter.hint_of(rule.hint),
            count=counter.count,
            total=counter.total,
            examples=tuple(counter.examples),
            worst=counter.worst,
            certainty=counter.certainty,
            source=source,
            waived=rule.id in self.settings.ignore,
            truncated=counter.truncated,
            statistic=counter.statistic,
            distribution=counter.distribution(),
        )


def _crash_text() -> str:
    """Return the end of the traceback of the exception that is being handled."""
    with plugin_exits_as_errors():  # the exception's class may be a third party's
        text = traceback.format_exc(limit=-3).strip()
    return text if len(text) <= _MAX_CRASH_CHARACTERS else f"… {text[-_MAX_CRASH_CHARACTERS:]}"
