"""Right models that are exported share torch's table of operators."""

from collections.abc import Iterator

import pytest

from support.reports.one_registry import share_operators


@pytest.fixture(scope="module", autouse=True)
def _one_registry() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        share_operators(patch)
        yield
