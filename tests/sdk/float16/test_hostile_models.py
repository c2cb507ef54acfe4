"""A model of a stranger is converted only after it ran within the limits."""

import time
from pathlib import Path

import pytest

from gsgen.contract.process.limits import Limits
from gsgen.sdk.errors import RewriteFailed
from gsgen.sdk.float16.convert_model import write_float16
from support.models.hostile import HOSTILE

_SECONDS = 3.0


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_model_ends_a_conversion_at_a_limit(tmp_path: Path, name: str) -> None:
    path = HOSTILE[name](tmp_path)
    start_time = time.monotonic()
    with pytest.raises(RewriteFailed, match="cannot run the model"):
        write_float16(path, tmp_path / "half.onnx", limits=Limits(seconds=_SECONDS))
    assert time.monotonic() - start_time < _SECONDS + 10
    assert not (tmp_path / "half.onnx").exists()
