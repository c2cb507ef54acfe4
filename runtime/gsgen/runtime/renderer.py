"""The renderer: a scene and a camera in, an image out."""

__all__ = ["Renderer"]

from collections.abc import Sequence
from typing import Final, final

import numpy as np

from gsgen.runtime.camera import Camera
from gsgen.runtime.device import Device
from gsgen.runtime.frame import Frame
from gsgen.runtime.kernels.counts import BYTES, Counts
from gsgen.runtime.plan import Kernels, Plan
from gsgen.runtime.residency import Residency
from gsgen.runtime.scene import Scene

_FIRST_PAIRS: Final = 1 << 16
_ROOM: Final = 1.25


@final
class Renderer:
    """Draws scenes of Gaussians on a graphics device.

    Args:
        device: Where to draw; the fastest there is where absent.

    Raises:
        DeviceUnavailable: There is none.
    """

    def __init__(self, device: Device | None = None) -> None:
        self.device = device or Device.open()
        self._kernels = Kernels(self.device)
        self._residency = Residency(self.device)
        self._plan: Plan | None = None

    def render(
        self,
        scene: Scene,
        camera: Camera,
        *,
        background: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    ) -> Frame:
        """Draw ``scene`` as ``camera`` sees it.

        Args:
            scene: What to draw.
            camera: From where, and how large.
            background: Red, green, blue and alpha behind it all.
        """
        red, green, blue, alpha = background
        behind = np.array([red * alpha, green * alpha, blue * alpha, alpha])
        pages = [
            (one, page) for one in scene.sets for page in self._residency.pages(one.data)
        ]
        size = (camera.width, camera.height)
        pairs = _FIRST_PAIRS
        while True:
            plan = Plan(self.device, self._kernels, pages, size, pairs)
            plan.submit(pages, camera, behind)
            counts = self.device.read(plan.counts, np.uint32, BYTES // 4)
            wanted = int(counts[Counts.WANTED_PAIRS])
            if wanted <= plan.pair_capacity:
                break
            pairs = int(wanted * _ROOM)
        pixels = self.device.read(plan.image, np.float32, 4 * size[0] * size[1])
        self._plan = plan
        return Frame(
            pixels.reshape(size[1], size[0], 4), int(counts[Counts.VISIBLE]), wanted
        )
