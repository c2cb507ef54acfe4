"""Tests that export share what torch needs for it, and models that several of them look at."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from support.models.shared_traces import share_traces
from support.reports.one_registry import share_operators

Exported = Callable[..., Path]


@pytest.fixture(scope="session", autouse=True)
def _one_registry() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        share_operators(patch)
        share_traces(patch)
        yield


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Exported:
    """Return the export of a class of ``support.models.generators``, with room for 256 Gaussians.

    It is made once for all workers of a run; two that ask at once make the same file.
    """
    from gsgen.sdk import GaussianGenerator, export

    own = tmp_path_factory.getbasetemp()
    folder = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own

    def find(kind: type[GaussianGenerator], dtype: str = "float32") -> Path:
        path = folder / f"exported_{kind.__name__}_{dtype}.onnx"
        if not path.exists():
            made = export(kind(), path, dtype=dtype, capacity=256)
            assert made.parity.holds
            assert made.parity.probes >= 8
        return path

    return find
