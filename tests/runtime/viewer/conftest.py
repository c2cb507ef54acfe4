from collections.abc import Iterator
from pathlib import Path

import pytest

from gsgen.conformance.fixtures import find
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.playback.live_playback import LivePlayback
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.scene_source import sources_of
from gsgen.runtime.viewer.surface_renderer import SurfaceRenderer
from support.rendering.viewers import Hand, round_cloud


@pytest.fixture(scope="session")
def painter() -> SurfaceRenderer:
    device = Device.open()
    return SurfaceRenderer(lambda: device)


@pytest.fixture(scope="module")
def cloud() -> SplatData:
    return round_cloud()


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
