"""GV059 compares all pairs of views, also if the row count of one view differs."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from gsgen.contract.probing.run_comparison import ProbeRuns
from gsgen.contract.rules.values import camera_space
from gsgen.contract.spec.geometry import look_at


def seen(eye: list[float], points: np.ndarray, *, moves: bool) -> camera_space._RowsInCameras:
    """Return what a view shows: centres in camera space, or in local space."""
    view = look_at(np.array(eye), np.zeros(3), np.array([0.0, -1, 0])).astype(np.float64)
    position = points @ view[:3, :3].T + view[:3, 3] if moves else points
    drawn = np.ones(len(points), bool)
    return camera_space._RowsInCameras(view=view, projection=None, position=position, drawn=drawn)


@pytest.mark.parametrize("moves", [True, False])
def test_view_with_other_rows_does_not_mask_other_views(
    monkeypatch: pytest.MonkeyPatch, moves: bool
) -> None:
    points = np.random.default_rng(1).normal(size=(40, 3))
    views = [
        seen([0, 0, -5], points[:30], moves=moves),
        seen([5, 0, 0], points, moves=moves),
        seen([0, 5, 1], points, moves=moves),
    ]
    monkeypatch.setattr(camera_space, "_isolated_views", lambda _: views)
    declared = SimpleNamespace(name="gaussians")
    runs = SimpleNamespace(subject=SimpleNamespace(declared_gaussians=declared))
    violations = list(camera_space.rows_in_local_space.check(cast(ProbeRuns, runs)))
    assert len(violations) == moves
