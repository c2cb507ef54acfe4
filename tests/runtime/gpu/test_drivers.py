"""Every software driver draws the golden picture, orders near ties, and sorts as NumPy does.

The other tests run on one driver, whichever is first; these name theirs.
"""

import pytest

from support.commands import shared
from support.rendering.drivers import DRIVERS, on_driver

BAR = 2e-6


@pytest.mark.parametrize("driver", DRIVERS)
def test_driver_renders_golden_meshes_and_sorts(driver: str) -> None:
    golden = shared("data/goldens/tiny_case.safetensors")
    sizes = ("0", "4097", "20000")
    told = on_driver(driver, "support.rendering.driver_report", str(golden), *sizes)
    assert driver in told["driver"]
    assert told["software"]
    assert set(told["pictures"]) == {"tiles", "tiles, cut as for a GPU", "quads"}
    assert max(told["pictures"].values()) <= BAR, told["pictures"]
    assert told["disordered"] == []
    assert told["unmet"] == []
    assert told["miscounted"] == []
    assert told["unscanned"] == []
    assert told["unsorted"] == []
