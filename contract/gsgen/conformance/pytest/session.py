"""The state that the tests of one pytest session share: options and validated models."""

__all__ = [
    "ConformanceSession",
    "RuleWarning",
    "fail_if_crashed",
    "raise_outcome",
    "report_properties",
]

import json
import warnings
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest

from gsgen.conformance.cases import Case
from gsgen.conformance.evidence import EvidenceDumps
from gsgen.conformance.expected import ExpectedFailure, read_expected
from gsgen.conformance.run import ModelRun, run_model, suites_of
from gsgen.conformance.suite import find_suite
from gsgen.contract.errors import GsgenError
from gsgen.contract.reporters.json_report import to_dict
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.validation.rule import Rule
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validation.settings_from_options import make_settings

# A dump without an option must not fill a disk: models of this field return 0.5 GB a frame.
_MAX_DEFAULT_DUMP_BYTES = 64 << 20


class RuleWarning(UserWarning):
    """Warning for a broken validation rule whose severity is below ``--gsgen-fail-on``."""


class ConformanceSession:
    """The options of a pytest session, and the models that it has validated.

    Attributes:
        tested: Model → ids of its collected rules.
    """

    def __init__(self, config: pytest.Config) -> None:
        self.config = config
        self.tested_rules: dict[Path, set[str]] = {}
        self._run_by_key: dict[object, ModelRun | Exception] = {}

    @classmethod
    def from_config(cls, config: pytest.Config) -> "ConformanceSession":
        """Return gsgen's state of a pytest session: options and validated models."""
        if _SESSION_KEY not in config.stash:
            pytest_session = config.stash[_SESSION_KEY] = cls(config)
            try:
                _ = pytest_session.settings, pytest_session.suites, pytest_session.expected
                _ = pytest_session.option("dump") and pytest_session.dumps
            except GsgenError as error:
                raise pytest.UsageError(f"gsgen: an option is invalid: {error}") from error
        return config.stash[_SESSION_KEY]

    def option(self, name: str) -> Any:
        """Return the value of the option ``--gsgen-NAME``, or None."""
        return self.config.getoption(f"--gsgen-{name}")

    @cached_property
    def settings(self) -> Settings:
        """The validation settings that the pytest options define."""
        return self.make_settings()

    def make_settings(self, *, target: str | None = None, level: str | None = None) -> Settings:
        """Return validation settings from pytest options; arguments replace options."""
        config = self.option("config")
        return make_settings(
            installed_rules(),
            level=level or self.option("level"),
            target=target or self.option("target"),
            fail_on=self.option("fail-on"),
            config=Path(config) if config else None,
            prefix="--gsgen-",
        )

    @cached_property
    def suites(self) -> tuple[str, ...]:
        """The names of the conformance suites that the user selected; empty for all."""
        return tuple(find_suite(name, "--gsgen-suite").name for name in self.option("suite"))

    @cached_property
    def expected(self) -> tuple[ExpectedFailure, ...]:
        """The expected failures in the file of ``--gsgen-xfails``."""
        file = self.option("xfails")
        return read_expected(Path(file), installed_rules()) if file else ()

    @cached_property
    def dumps(self) -> EvidenceDumps:
        """The folder for saved inputs and outputs of failed model runs."""
        folder = self.option("dump")
        if folder:
            return EvidenceDumps(Path(folder))
        factory: pytest.TempPathFactory = self.config._tmp_path_factory  # type: ignore[attr-defined]
        return EvidenceDumps(factory.mktemp("gsgen-dumps"), _MAX_DEFAULT_DUMP_BYTES)

    def plan(self, path: Path, settings: Settings) -> dict[str, tuple[Rule, ...]]:
        """Return a model's conformance suites with their rules, and mark the rules as tested."""
        rules_by_suite = suites_of(path, settings)
        rules = self.tested_rules.setdefault(path, set())
        rules |= {rule.id for suite_rules in rules_by_suite.values() for rule in suite_rules}
        return rules_by_suite

    def run(self, path: Path, settings: Settings, expected: Iterable[ExpectedFailure]) -> ModelRun:
        """Validate a model once per pytest session, and return the result."""
        entries = tuple(expected)
        file_stat = path.stat() if path.is_file() else None
        version = (file_stat.st_mtime_ns, file_stat.st_size) if file_stat else ()
        key = (path.resolve(), version, repr(settings), entries)
        if key not in self._run_by_key:
            self._run_by_key[key] = self._validate_safely(path, settings, entries)
        model_run = self._run_by_key[key]
        if isinstance(model_run, Exception):
            raise model_run
        return model_run

    def _validate_safely(
        self, path: Path, settings: Settings, expected: tuple[ExpectedFailure, ...]
    ) -> ModelRun | Exception:
        """Validate a model; return an exception as a value, so that every test can raise it."""
        try:
            return run_model(path, settings, expected=expected, dumps=self.dumps)
        except Exception as error:
            return error


_SESSION_KEY = pytest.StashKey[ConformanceSession]()


def fail_if_crashed(run: ModelRun, case: Case) -> None:
    """Raise if the check of a test's rule crashed: pytest reports an error, not a failure."""
    if case.status == "crashed":
        pytest.fail(run.text(case), pytrace=False)


def raise_outcome(run: ModelRun, case: Case) -> None:
    """Pass, fail, skip, warn or xfail the running test, by the status of the validation rule."""
    __tracebackhide__ = True
    if case.status == "failed":
        pytest.fail(run.text(case).lstrip(), pytrace=False)
    if case.status == "expected":
        pytest.xfail(case.text)
    if case.status == "skipped":
        pytest.skip(case.text)
    if case.status == "warned":
        warnings.warn(RuleWarning(case.text.lstrip()), stacklevel=2)


def report_properties(run: ModelRun, case: Case) -> list[tuple[str, object]]:
    """Return the properties of a test report: rule id, status, and findings as JSON."""
    entries: list[tuple[str, object]] = [("gsgen.rule", case.rule.id)]
    entries.append(("gsgen.status", case.status))
    if case.findings:
        findings = to_dict(run.report)["findings"]
        matches = [finding for finding in findings if finding["rule"] == case.rule.id]
        entries.append(("gsgen.findings", json.dumps(matches, ensure_ascii=False)))
    return entries
