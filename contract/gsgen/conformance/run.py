"""Runs conformance suites: validates a model once, and returns a test case for each rule."""

__all__ = ["ModelRun", "run_model", "suites_of"]

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from gsgen.conformance.cases import Case, CaseStatus, make_case
from gsgen.conformance.evidence import Evidence, EvidenceDumps, collect_evidence
from gsgen.conformance.expected import ExpectedFailure
from gsgen.conformance.suite import DeclaredFeatures, plan_suites
from gsgen.contract.model.inspected_model import inspect_model
from gsgen.contract.model.model_file import open_model
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.validation.engine import Progress
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.rule import Rule
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate

# The results of a test other than passed.
FAILED_CASE_STATUSES: tuple[CaseStatus, ...] = ("failed", "crashed")


@dataclass(frozen=True, slots=True)
class ModelRun:
    """The results of the conformance suites of one model.

    Attributes:
        report: The report of `gsgen validate`.
        cases: The case of every rule, suite by suite.
        evidence: Rule id → the means to reproduce its failure.
    """

    report: Report
    cases: tuple[Case, ...]
    evidence: Mapping[str, Evidence]

    def case(self, rule: str) -> Case:
        """Return the test case of a rule; raise KeyError if no suite of this run tests the rule."""
        for case in self.cases:
            if case.rule.id == rule:
                return case
        raise KeyError(rule)

    def text(self, case: Case) -> str:
        """Return a test case as text: the rule's findings, and the command to reproduce them."""
        evidence = self.evidence.get(case.rule.id)
        return (
            f"{case.text}\n{evidence}"
            if evidence and case.status in FAILED_CASE_STATUSES
            else case.text
        )

    @property
    def suites(self) -> dict[str, list[Case]]:
        """The test cases of the model, grouped by the name of the conformance suite."""
        cases_by_suite: dict[str, list[Case]] = {}
        for case in self.cases:
            cases_by_suite.setdefault(case.suite, []).append(case)
        return cases_by_suite


def suites_of(path: Path, settings: Settings) -> dict[str, tuple[Rule, ...]]:
    """Return the conformance suites that apply to a model with their rules; nothing is run."""
    subject = inspect_model(open_model(path), settings.target, settings.limits, settings.tolerances)
    rules = installed_rules().rules.values()
    return plan_suites(rules, DeclaredFeatures.from_model(subject), settings.target)


def run_model(
    path: Path,
    settings: Settings,
    *,
    suites: Iterable[str] = (),
    expected: Iterable[ExpectedFailure] = (),
    dumps: EvidenceDumps | None = None,
    progress: Progress = lambda words: None,
) -> ModelRun:
    """Validate a model once, and return the test case of every validation rule of its suites.

    Args:
        path: The ONNX file.
        settings: The level, target, limits and severities.
        suites: The names of the reported suites; empty for all that apply.
        expected: The expected failures.
        dumps: The folder for inputs and outputs of failing probes; None discards them.
        progress: Called with the name of each stage when it begins.

    Raises:
        ModelUnreadable: The file is not an ONNX model at all.
    """
    suite_names, entries = set(suites), tuple(expected)
    rules_by_suite = suites_of(path, settings)
    report = validate(path, settings, progress=progress)
    cases = tuple(
        make_case(report, rule, name, entries)
        for name, rules in rules_by_suite.items()
        if not suite_names or name in suite_names
        for rule in rules
    )
    failed_cases = [case for case in cases if case.status in FAILED_CASE_STATUSES]
    return ModelRun(report, cases, collect_evidence(path, settings, failed_cases, dumps))
