"""Every software driver draws the golden picture, orders near ties, and sorts as NumPy does.

The other tests run on one driver, whichever is first; these name theirs.
"""

import pytest

from support.commands import shared
from support.rendering.drivers import DRIVERS, on_driver

MAX_ERROR = 2e-6


@pytest.mark.parametrize("driver", DRIVERS)
def test_driver_renders_golden_meshes_and_sorts(driver: str) -> None:
    golden = shared("data/goldens/tiny_case.safetensors")
    sizes = ("0", "4097", "20000")
    message = on_driver(driver, "support.rendering.driver_report", str(golden), *sizes)
    assert driver in message["driver"]
    assert message["software"]
    assert set(message["pictures"]) == {"tiles", "tiles, cut as for a GPU", "quads"}
    assert max(message["pictures"].values()) <= MAX_ERROR, message["pictures"]
    assert message["disordered"] == []
    assert message["unmet"] == []
    assert message["miscounted"] == []
    assert message["unscanned"] == []
    assert message["unsorted"] == []
