"""One validation a fixture, shared by all tests of the session."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from gsgen.conformance.fixtures import Fixture
from gsgen.contract.validation.report import Report
from gsgen.contract.validator import validate

Judge = Callable[[Fixture], Report]


@pytest.fixture(scope="session")
def judge(tmp_path_factory: pytest.TempPathFactory) -> Judge:
    @cache
    def judged(fixture: Fixture) -> Report:
        return validate(fixture.write(_folder(tmp_path_factory)), fixture.settings)

    return judged


def _folder(factory: pytest.TempPathFactory) -> Path:
    return factory.mktemp("corpus")
