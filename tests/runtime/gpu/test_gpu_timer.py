"""Times of stages: differences of timestamps, passes of one name added."""

from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import MagicMock, patch

import numpy as np
import pytest

from gsgen.runtime.gpu import gpu_timer


def test_passes_of_a_stage_are_added() -> None:
    timestamps = np.array([100, 350, 400, 1400, 2000, 2005], np.uint64)
    read = MagicMock(return_value=timestamps)
    device = cast(Any, SimpleNamespace(raw=MagicMock(), read=read))
    with patch.object(gpu_timer, "timestamp_period", lambda _: 2.0):  # ns a tick
        clock = gpu_timer.StageClock(device)
    for number, stage in enumerate(("sort", "blend", "sort")):
        writes = clock.timestamp_writes(stage)
        assert writes["beginning_of_pass_write_index"] == 2 * number
        assert writes["end_of_pass_write_index"] == 2 * number + 1
    assert clock.seconds() == pytest.approx({"sort": 510e-9, "blend": 2000e-9}, rel=1e-12)
    assert read.call_args.args[2] == 6
    clock.begin()
    read.return_value = timestamps[:0]
    assert clock.seconds() == {}
