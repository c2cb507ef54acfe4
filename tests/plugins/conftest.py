"""Tests that export share what torch needs for it."""

from collections.abc import Iterator

import pytest

from support.models.shared_traces import share_traces
from support.reports.one_registry import share_operators


@pytest.fixture(scope="session", autouse=True)
def _one_registry() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        share_operators(patch)
        share_traces(patch)
        yield
