"""Watch a generator in viser: a page in the browser, with a slider for the time.

python watch_in_viser.py model.onnx
"""

import argparse
import time

import numpy as np
import viser

from gsgen.contract.layout import DecodedGaussians
from gsgen.sdk.binding import FrameSession

SH_C0 = 0.28209479177387814  # the constant harmonic
MATRIX = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # the numbers xx xy xz yy yz zz in Σ


def show(server: viser.ViserServer, gaussians: DecodedGaussians) -> None:
    """Draw the Gaussians of a frame instead of those before; viser has no harmonics."""
    colors = gaussians.rgb if gaussians.sh is None else 0.5 + SH_C0 * gaussians.sh[:, 0]
    server.scene.add_gaussian_splats(
        "/generator",
        centers=gaussians.position,
        covariances=gaussians.covariance[:, MATRIX],
        rgbs=np.clip(colors, 0, 1),
        opacities=gaussians.opacity[:, None],
    )


def watch(model: str, server: viser.ViserServer, seconds: float) -> None:
    """Run a model whenever the slider moves."""
    server.scene.set_up_direction("-y")
    slider = server.gui.add_slider("time", min=0.0, max=1.0, step=0.01, initial_value=0.0)
    deadline, shown = time.monotonic() + seconds, None
    with FrameSession(model) as session:
        while time.monotonic() < deadline:
            if slider.value != shown:
                shown = slider.value
                show(server, session.run({"time": shown}).gaussians())
            time.sleep(0.01)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("model")
    parser.add_argument("--port", type=int, default=8080)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    options = parser.parse_args()
    watch(options.model, viser.ViserServer(port=options.port), options.seconds)
