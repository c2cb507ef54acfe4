"""Small checkouts, written to a temporary folder, on which the checks of the house run."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[3] / "scripts"
sys.path.insert(0, str(SCRIPTS))  # the checks are scripts, and no part of the package

from house.checks import CHECKS, Result, run_checks  # noqa: E402
from house.repository import Repository  # noqa: E402

Measure = Callable[..., Result]


@pytest.fixture
def measure(tmp_path: Path) -> Measure:
    """Return a function that writes files and runs one check on them."""

    def run(name: str, files: dict[str, str], *selection: str) -> Result:
        for path, text in files.items():
            (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / path).write_text(text, "utf-8")
        check = next(check for check in CHECKS if check.name == name)
        (result,) = run_checks(Repository(tmp_path, selection), [check], [])
        return result

    return run
