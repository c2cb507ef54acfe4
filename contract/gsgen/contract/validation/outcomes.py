"""The score board: which rules have been judged, with which outcome, and what they found."""

__all__ = ["ResultCollector"]

import time
import traceback
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Finding, Violation
from gsgen.contract.validation.finding_counter import FindingCounter
from gsgen.contract.validation.report import Outcome, Status
from gsgen.contract.validation.rule import Registry, Rule
from gsgen.contract.validation.settings import Settings

_MAX_PLACES = 20


@dataclass(slots=True)
class ResultCollector:
    """Outcomes and tallies of one validation.

    Attributes:
        registry: All rules.
        settings: Severities and waivers.
        kind: The kind of model, empty if unknown.
        outcomes: Rule id → outcome, as far as judged.
    """

    registry: Registry
    settings: Settings
    kind: str
    outcomes: dict[str, Outcome] = field(default_factory=dict)
    _tallies: dict[str, dict[str, FindingCounter]] = field(default_factory=dict)
    _spent: dict[str, float] = field(default_factory=dict)

    def ready(self, rules: Iterable[Rule]) -> list[Rule]:
        """Return the rules that apply and are not blocked; settle the outcome of the others."""
        return [rule for rule in rules if self.is_ready(rule)]

    def is_ready(self, rule: Rule) -> bool:
        """Say whether ``rule`` can be judged now; if not, note why."""
        if rule.id in self.outcomes:
            return False
        reason = self._inapplicable(rule)
        if reason:
            self.outcomes[rule.id] = Outcome(rule, "not-applicable", reason)
            return False
        for need in rule.needs:
            blocker = self._blocker(need)
            if blocker:
                text = f"because {blocker} {self._why(blocker)}"
                self.outcomes[rule.id] = Outcome(
                    rule, "not-applicable", text, blocked_by=blocker
                )
                return False
        return True

    def _inapplicable(self, rule: Rule) -> str:
        target = self.settings.target
        if rule.target and rule.target != target.name:
            return f"only for target {rule.target}"
        if rule.limit and rule.limit not in target.limits:
            return f"target {target.name} sets no limit {rule.limit}"
        if self.kind and self.kind not in rule.kinds:
            return f"only for kind {', '.join(rule.kinds)}"
        return ""

    def _blocker(self, need: str) -> str:
        outcome = self.outcomes.get(need)
        if outcome is None:
            return need
        return (
            need if outcome.status in ("fail", "crashed", "skipped") else outcome.blocked_by
        )

    def _why(self, blocker: str) -> str:
        outcome = self.outcomes.get(blocker)
        skipped = outcome is not None and outcome.status == "skipped"
        return "was not judged" if skipped else "does not hold"

    def judge(self, rule: Rule, subject: object, probe: str = "", start: int = 0) -> bool:
        """Run one check once and tally its breaches; False if it crashed."""
        began = time.perf_counter()
        try:
            with np.errstate(
                all="ignore"
            ):  # a model may emit any number: rules look for that
                for breach in rule.check(subject):
                    self._add(rule, breach, probe, start)
        except Exception:  # a rule's fault must not take the report down
            last = traceback.format_exc(limit=-3).strip()
            self.outcomes[rule.id] = Outcome(rule, "crashed", last)
            return False
        finally:
            spent = time.perf_counter() - began
            self._spent[rule.id] = self._spent.get(rule.id, 0.0) + spent
        return True

    def _add(self, rule: Rule, breach: Violation, probe: str, start: int) -> None:
        places = self._tallies.setdefault(rule.id, {})
        key = str(breach.where)
        if key not in places and len(places) >= _MAX_PLACES:
            key = next(iter(places))
            places[key].truncated = True
        elif key not in places:
            places[key] = FindingCounter(
                breach.where, breach.expected, breach.actual, certainty=breach.certainty
            )
        places[key].add(breach, probe, start)

    def fails(self, rule: Rule) -> bool:
        """Say whether what was found so far is enough for ``rule`` to fail."""
        return any(tally.fails for tally in self._tallies.get(rule.id, {}).values())

    def settle(self, rules: Iterable[Rule], items: int = 0) -> None:
        """Turn the tallies of judged rules into outcomes."""
        for rule in rules:
            if rule.id in self.outcomes:
                continue
            status: Status = "fail" if self.fails(rule) else "pass"
            spent = 1000 * self._spent.get(rule.id, 0.0)
            self.outcomes[rule.id] = Outcome(rule, status, milliseconds=spent, items=items)

    def crash(self, rules: Iterable[Rule]) -> None:
        """Note that rules could not be judged because of the error being handled."""
        last = traceback.format_exc(limit=-3).strip()
        for rule in rules:
            self.outcomes.setdefault(rule.id, Outcome(rule, "crashed", last))

    def skip(self, rules: Iterable[Rule], reason: str) -> None:
        """Note that rules were not run, and why."""
        for rule in rules:
            self.outcomes.setdefault(rule.id, Outcome(rule, "skipped", reason))

    def findings(self) -> tuple[Finding, ...]:
        """Return what failed, worst first, then in catalogue order."""
        found = [
            self._finding(rule, tally)
            for rule in self.registry.rules.values()
            for tally in self._tallies.get(rule.id, {}).values()
            if tally.fails
        ]
        return tuple(sorted(found, key=lambda one: -one.severity))

    def _finding(self, rule: Rule, tally: FindingCounter) -> Finding:
        severity: Severity = self.settings.severity_of(rule)
        source = "contract"
        if rule.target or rule.limit or rule.id in self.settings.target.severities:
            source = self.settings.target.label
        return Finding(
            rule=rule.id,
            slug=rule.slug,
            severity=severity,
            where=tally.where,
            message=tally.message(),
            hint=rule.hint,
            count=tally.count,
            total=tally.total,
            examples=tuple(tally.examples),
            worst=tally.worst,
            certainty=tally.certainty,
            source=source,
            waived=rule.id in self.settings.ignore,
            truncated=tally.truncated,
        )
