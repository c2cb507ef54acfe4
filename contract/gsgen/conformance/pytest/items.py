"""Collects ONNX files as pytest nodes: a file holds suites, a suite holds a test for each rule."""

__all__ = ["ModelFile", "RuleItem", "StaleEntry", "SuiteNode", "stale_entries"]

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gsgen.conformance.expected import ExpectedFailure, unmatched_entries
from gsgen.conformance.pytest.session import (
    ConformanceSession,
    fail_if_crashed,
    raise_outcome,
    report_properties,
)
from gsgen.conformance.run import ModelRun
from gsgen.contract.errors import GsgenError
from gsgen.contract.validation.rule import Rule


class ModelFile(pytest.File):
    """A pytest node for an ONNX file named with ``--gsgen``."""

    def collect(self) -> "Iterator[SuiteNode]":
        """Yield a pytest node for each chosen conformance suite that applies to the model."""
        pytest_session = ConformanceSession.from_config(self.config)
        try:
            rules_by_suite = pytest_session.plan(self.path, pytest_session.settings)
        except GsgenError as error:
            raise self.CollectError(f"gsgen: the model cannot be tested: {error}") from error
        for name, rules in rules_by_suite.items():
            if not pytest_session.suites or name in pytest_session.suites:
                yield SuiteNode.from_parent(self, name=name, rules=rules)

    def run_model(self) -> ModelRun:
        """Validate the ONNX file once per pytest session, and return the result."""
        pytest_session = ConformanceSession.from_config(self.config)
        return pytest_session.run(self.path, pytest_session.settings, pytest_session.expected)


class SuiteNode(pytest.Collector):
    """A pytest node for one conformance suite of one model."""

    def __init__(self, *, rules: tuple[Rule, ...], **options: Any) -> None:
        super().__init__(**options)
        self.rules = rules

    def collect(self) -> "Iterator[RuleItem]":
        """Yield a pytest item for each validation rule of the suite."""
        for rule in self.rules:
            name = f"{rule.id}-{rule.slug}"
            yield RuleItem.from_parent(self, name=name, rule=rule)


class RuleItem(pytest.Item):
    """A pytest item that tests one validation rule on one model."""

    def __init__(self, *, rule: Rule, **options: Any) -> None:
        super().__init__(**options)
        self.rule = rule

    @property
    def file(self) -> ModelFile:
        """The pytest node of the tested ONNX file."""
        parent = self.getparent(ModelFile)
        assert parent is not None
        return parent

    def setup(self) -> None:
        """Validate the model before the test; a crashed validation rule is a test error."""
        run = self.file.run_model()
        case = run.case(self.rule.id)
        self.user_properties += report_properties(run, case)
        fail_if_crashed(run, case)

    def runtest(self) -> None:
        """Pass, fail, skip, warn or xfail the test, by the status of the validation rule."""
        run = self.file.run_model()
        raise_outcome(run, run.case(self.rule.id))

    def reportinfo(self) -> tuple[Path, None, str]:
        """Return the location of the test for the headings of pytest's failure reports."""
        assert self.parent is not None
        return self.path, None, f"{self.path.name}: {self.parent.name}: {self.name}"


class StaleEntry(pytest.Item):
    """A pytest item that always fails: an expected failure that matches no tested contract rule."""

    def __init__(self, *, entry: ExpectedFailure, **options: Any) -> None:
        super().__init__(**options)
        self.entry = entry

    def setup(self) -> None:
        """Raise UsageError with the expected failure that matches no tested validation rule."""
        text = f"matches no rule of any tested model: remove or correct the entry\n  {self.entry}"
        pytest.fail(text, pytrace=False)

    def runtest(self) -> None:
        """Do nothing, because the set-up of this test always raises."""


def stale_entries(session: pytest.Session) -> Iterator[StaleEntry]:
    """Yield a failing item for each entry of ``--gsgen-xfails`` that matches no collected model."""
    pytest_session = ConformanceSession.from_config(session.config)
    if pytest_session.tested_rules:
        for number, entry in enumerate(
            unmatched_entries(pytest_session.expected, pytest_session.tested_rules), start=1
        ):
            yield StaleEntry.from_parent(session, name=f"xfail-{number}", entry=entry)
