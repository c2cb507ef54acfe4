"""Models that several tests of the export look at."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

Exported = Callable[..., Path]


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Exported:
    """Return what exports a class of ``support.models.generators`` once, with room for 256 rows."""
    from gsgen.sdk import GaussianGenerator, export

    folder = tmp_path_factory.mktemp("exported")

    @cache
    def find(kind: type[GaussianGenerator], dtype: str = "float32") -> Path:
        path = folder / f"{kind.__name__}_{dtype}.onnx"
        exported = export(kind(), path, dtype=dtype, capacity=256)
        assert exported.parity.holds
        assert exported.parity.probes >= 8
        return path

    return find
