"""Warnings about training options that change a method's result."""

from types import SimpleNamespace
from typing import Any

import pytest

from gsgen.reference_plugins.loading.options import warn_unsupported


@pytest.mark.parametrize(
    ("values", "expected_warnings"),
    [
        ({}, []),
        ({"ratio": 1, "deep": True}, []),
        ({"ratio": 0}, ["ratio=0"]),
        ({"ratio": 2, "deep": False}, ["ratio=2", "deep=False"]),
    ],
)
def test_each_other_value_is_warned_of(
    values: dict[str, Any], expected_warnings: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    expected = {"ratio": (1, "fewer offsets"), "deep": (True, "a smaller network")}
    warn_unsupported(SimpleNamespace(values=values), expected)  # type: ignore[arg-type]
    lines = capsys.readouterr().err.splitlines()
    assert [line.split()[1] for line in lines] == expected_warnings
    assert all(line.startswith("warning: ") and "is not supported: " in line for line in lines)
