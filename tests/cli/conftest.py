from pathlib import Path

import numpy as np
import pytest

from cli.packed_models import rows, write_rows


@pytest.fixture
def good(tmp_path: Path) -> Path:
    return write_rows(tmp_path / "good.onnx", rows())


@pytest.fixture
def nan(tmp_path: Path) -> Path:
    packed = rows()
    packed[7, 0] = np.nan
    return write_rows(tmp_path / "nan.onnx", packed)


@pytest.fixture
def dim(tmp_path: Path) -> Path:
    """A model that breaks GV004, a warning, and nothing else."""
    packed = rows()
    packed[:, 3] = 0.001
    return write_rows(tmp_path / "dim.onnx", packed)
