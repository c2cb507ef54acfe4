"""Log the frames of a generator to a Rerun recording, which its viewer plays over time.

python log_to_rerun.py model.onnx frames.rrd && rerun frames.rrd
"""

import argparse

import numpy as np
import rerun
from scipy.spatial.transform import Rotation

from gsgen.contract.layout import DecodedGaussians
from gsgen.sdk.binding import FrameSession

SH_C0 = 0.28209479177387814  # the constant harmonic
MATRIX = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # the numbers xx xy xz yy yz zz in Σ


def archetype(gaussians: DecodedGaussians) -> rerun.GaussianSplats3D:
    """Convert the Gaussians of a frame: Rerun has axes and quaternions (x, y, z, w) for Σ."""
    variances, axes = np.linalg.eigh(gaussians.covariance[:, MATRIX])
    axes[:, :, 0] *= np.linalg.det(axes)[:, None]  # a mirrored axis is the same ellipsoid
    colors = gaussians.rgb if gaussians.sh is None else 0.5 + SH_C0 * gaussians.sh[:, 0]
    rgba = np.column_stack((np.clip(colors, 0, 1), gaussians.opacity))
    return rerun.GaussianSplats3D(
        gaussians.position,
        scales=np.sqrt(np.maximum(variances, 0)),
        quaternions=Rotation.from_matrix(axes).as_quat(),
        colors=np.rint(255 * rgba).astype(np.uint8),
        spherical_harmonics_degree=0,
    )


def log(model: str, path: str, frames: int) -> None:
    """Write a recording of frames from time 0 to 1."""
    with rerun.RecordingStream("gsgen") as recording, FrameSession(model) as session:
        recording.save(path)
        for time in np.linspace(0, 1, frames):
            recording.set_time("time", duration=time)
            recording.log("generator", archetype(session.run({"time": time}).gaussians()))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("model")
    parser.add_argument("recording")
    parser.add_argument("--frames", type=int, default=30)
    options = parser.parse_args()
    log(options.model, options.recording, options.frames)
