"""Right models that are exported share torch's tables of operators, and equal ones their graph."""

from collections.abc import Iterator

import pytest

from support.models.shared_traces import share_traces
from support.reports.one_registry import share_operators


@pytest.fixture(scope="module", autouse=True)
def _one_registry() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        share_operators(patch)
        share_traces(patch)
        yield
