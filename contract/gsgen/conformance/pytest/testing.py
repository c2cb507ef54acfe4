"""Parametrizes pytest tests of plugins by models and rules, each with a ``check`` to call.

Needs pytest: ``pip install 'gsgen[conformance]'``.
"""

__all__ = ["Check", "RuleWarning", "parametrize_with_rules", "requested_checks"]

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import pytest

from gsgen.conformance.cases import Case
from gsgen.conformance.expected import ExpectedFailure, read_expected, unmatched_entries
from gsgen.conformance.pytest.session import (
    ConformanceSession,
    RuleWarning,
    fail_if_crashed,
    raise_outcome,
)
from gsgen.conformance.run import ModelRun
from gsgen.conformance.suite import find_suite
from gsgen.contract.errors import GsgenError
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.validation.rule import Rule
from gsgen.contract.validation.settings import Settings

PathLike = str | os.PathLike[str]
Models = Iterable[PathLike] | Callable[[], Iterable[PathLike]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """The models and rules that :func:`parametrize_with_rules` requests for a test."""

    models: Models
    target: str | None
    level: str | None
    settings: Settings | None
    suites: tuple[str, ...]
    expected: PathLike | tuple[ExpectedFailure, ...] | None


def parametrize_with_rules(
    models: Models,
    *,
    target: str | None = None,
    level: str | None = None,
    settings: Settings | None = None,
    suites: Iterable[str] = (),
    expected_failures: PathLike | Iterable[ExpectedFailure] | None = None,
) -> pytest.MarkDecorator:
    """Run the decorated test for each rule of each model, passing a ``check`` to call.

    Such as::

        @parametrize_with_rules(["drift.onnx"], target="webgpu")
        def test_drift_keeps_the_contract(check):
            check()

    Args:
        models: ONNX files, or a function that returns them (called when tests are collected).
            Relative paths start at the folder of the test file.
        target: The target of the validation; None takes ``--gsgen-target``.
        level: The level of the validation; None takes ``--gsgen-level``.
        settings: All settings, in place of the options and of ``gsgen.toml``.
        suites: The names of the suites; empty takes ``--gsgen-suite``.
        expected_failures: A TOML file, or entries; None takes ``--gsgen-xfails``.
    """
    expected = expected_failures
    if expected is not None and not isinstance(expected, (str, os.PathLike)):
        expected = tuple(expected)
    request = Request(
        models=models,
        target=target,
        level=level,
        settings=settings,
        suites=tuple(suites),
        expected=expected,
    )
    return pytest.mark.gsgen_rules(request)


class Check:
    """A callable that checks one validation rule on one model, which a pytest test calls once."""

    def __init__(
        self, model: Path, suite: str, rule: Rule, run_model: Callable[[], ModelRun]
    ) -> None:
        self.model = model
        self.suite = suite
        self.rule = rule
        self.is_called = False
        self._run_model = run_model

    @property
    def name(self) -> str:
        """The test's name: model, suite and rule, such as ``drift-basic-GV003-opacity-range``."""
        return f"{self.model.stem}-{self.suite}-{self.rule.id}-{self.rule.slug}"

    @property
    def run(self) -> ModelRun:
        """The results of validating the model, which is validated once per pytest session."""
        return self._run_model()

    @property
    def case(self) -> Case:
        """The outcome of the validation rule on the model, as a test case."""
        return self.run.case(self.rule.id)

    def fail_if_crashed(self) -> None:
        """Validate the model before the test; a crashed validation rule is a test error."""
        fail_if_crashed(self.run, self.case)

    def __call__(self) -> None:
        """Pass, fail, skip, warn or xfail the running test, by the outcome of the contract rule."""
        __tracebackhide__ = True
        self.is_called = True
        raise_outcome(self.run, self.case)


def requested_checks(
    request: Request, pytest_session: ConformanceSession, folder: Path
) -> list[Check]:
    """Return a check (callable) for each validation rule of each model that a test requests."""
    try:
        return _checks(request, pytest_session, folder)
    except GsgenError as error:
        raise pytest.UsageError(f"gsgen: the model cannot be tested: {error}") from error


def _checks(request: Request, pytest_session: ConformanceSession, folder: Path) -> list[Check]:
    settings = request.settings or pytest_session.make_settings(
        target=request.target, level=request.level
    )
    suites = [find_suite(name, "suites").name for name in request.suites] or pytest_session.suites
    expected = _resolve_expected_findings(request.expected, pytest_session, folder)
    models = request.models() if callable(request.models) else request.models
    paths = [folder / path for path in models]
    rules_by_model = {path: pytest_session.plan(path, settings) for path in paths}
    if request.expected is not None:
        refuse_unmatched_entries(expected, rules_by_model)

    def run_model(path: Path) -> Callable[[], ModelRun]:
        return lambda: pytest_session.run(path, settings, expected)

    return [
        Check(path, name, rule, run_model(path))
        for path, rules_by_suite in rules_by_model.items()
        for name, rules in rules_by_suite.items()
        if not suites or name in suites
        for rule in rules
    ]


def _resolve_expected_findings(
    entries: PathLike | tuple[ExpectedFailure, ...] | None,
    pytest_session: ConformanceSession,
    folder: Path,
) -> tuple[ExpectedFailure, ...]:
    if entries is None:
        return pytest_session.expected
    if isinstance(entries, tuple):
        return entries
    return read_expected(folder / entries, installed_rules())


def refuse_unmatched_entries(
    expected: Iterable[ExpectedFailure], rules_by_model: dict[Path, dict[str, tuple[Rule, ...]]]
) -> None:
    """Raise UsageError if an expected failure matches no validation rule of any tested model."""
    tested_cases = {
        path: [rule.id for rules in rules_by_suite.values() for rule in rules]
        for path, rules_by_suite in rules_by_model.items()
    }
    for entry in unmatched_entries(expected, tested_cases):
        raise pytest.UsageError(
            f"gsgen: an expected failure matches no rule of any tested model: remove it\n  {entry}"
        )
