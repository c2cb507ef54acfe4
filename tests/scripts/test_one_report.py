"""Workers that send one report of a test tell the outcomes that pytest tells."""

import os
import re
import subprocess
import sys
from pathlib import Path

from support.commands import ROOT

_TESTS = """
import pytest

@pytest.fixture
def broken():
    raise ValueError("setup")

@pytest.fixture
def leaking():
    yield
    raise ValueError("teardown")

def test_passes(): pass
def test_fails(): assert 0
def test_has_no_fixture(broken): pass
def test_leaves_something(leaking): pass
def test_fails_and_leaves_something(leaking): assert 0
def test_skips(): pytest.skip("so")
@pytest.mark.skip(reason="so")
def test_is_skipped(): pass
@pytest.mark.xfail(strict=False)
def test_is_expected_to_fail(): assert 0
@pytest.mark.xfail(strict=False)
def test_passes_out_of_turn(): pass
@pytest.mark.xfail(strict=True)
def test_must_fail(): pass
"""


def test_outcomes_are_those_of_pytest(tmp_path: Path) -> None:
    (tmp_path / "test_outcomes.py").write_text(_TESTS, "utf-8")
    (tmp_path / "pytest.ini").write_text("[pytest]\n", "utf-8")
    lines = [_outcomes(tmp_path, *words) for words in ((), ("-n", "1", "-p", "one_report"))]
    assert len(lines[0]) == 12
    assert lines[1] == lines[0]


def _outcomes(folder: Path, *words: str) -> list[str]:
    """Return the lines of pytest's summary, of which a test that passes has one, too."""
    path = str(ROOT / "tests/support/reports")
    command = [sys.executable, "-m", "pytest", "-q", "-rA", "--tb=line", *words]
    environment = {name: value for name, value in os.environ.items() if "XDIST" not in name}
    done = subprocess.run(
        command, cwd=folder, env=environment | {"PYTHONPATH": path}, capture_output=True, text=True
    )
    assert done.returncode == 1, done.stderr
    return sorted(re.findall(r"^(?:[A-Z]+ test_outcomes|SKIPPED).*$", done.stdout, re.MULTILINE))
