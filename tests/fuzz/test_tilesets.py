"""A small share of the fuzzing of tilesets; ``make fuzz-tiles`` does the rest."""

import subprocess
import sys

import pytest

from fuzz.tilesets import _ENVIRONMENT, judge, mutant

pytestmark = pytest.mark.slow


def test_mutants_are_validated_or_refused() -> None:
    command = [sys.executable, "-m", "fuzz.tilesets", "--count", "250", "--seed", "11"]
    completed = subprocess.run(command, capture_output=True, text=True, env=_ENVIRONMENT)
    assert completed.returncode == 0, completed.stdout + completed.stderr
    assert "250 mutants" in completed.stdout
    assert " 0 failed" in completed.stdout


def test_a_mutant_is_always_the_same_and_not_the_original() -> None:
    assert mutant(1, 5) == mutant(1, 5)
    assert mutant(1, 5) != mutant(1, 6)


def test_the_fuzzer_notices_a_crash(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(source: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("fuzz.tilesets._validate", broken)
    files, packed = mutant(0, 0)
    trial = judge(tmp_path, files, packed=packed)
    assert trial.failure.startswith("ZeroDivisionError")
