from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures import find
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.playback.live_playback import LivePlayback
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.scene_source import sources_of
from gsgen.runtime.viewer.surface_renderer import SurfaceRenderer
from support.rendering.viewers import Hand


@pytest.fixture(scope="session")
def painter() -> SurfaceRenderer:
    device = Device.open()
    return SurfaceRenderer(lambda: device)


@pytest.fixture(scope="module")
def cloud() -> SplatData:
    rng = np.random.default_rng(3)
    rows = np.zeros((300, 10), np.float32)
    rows[:, :3] = rng.normal(size=(300, 3)) * 0.5
    rows[:, 3], rows[:, [4, 7, 9]] = 0.8, 0.01
    return SplatData(rows, rng.uniform(size=(300, 27)).astype(np.float32) - 0.3, "sh")


@pytest.fixture
def still(cloud: SplatData, painter: SurfaceRenderer) -> Hand:
    return Hand(LivePlayback(sources_of(cloud)), painter)


@pytest.fixture(scope="module")
def drift(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return find("drift").write(tmp_path_factory.mktemp("drift"))


@pytest.fixture
def moving(drift: Path, painter: SurfaceRenderer) -> Iterator[Hand]:
    hand = Hand(LivePlayback(sources_of(drift), frames=11, fps=10), painter)
    yield hand
    hand.viewer.playback.close()
