"""Where Gaussians come from: a file that holds them, or a generator that makes them every frame."""

__all__ = ["GeneratorSource", "Source", "StillSource", "direction", "open_source"]

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Literal, final

import numpy as np
from jaxtyping import Float

from gsgen.contract.manifest import GeneratorManifest, Input, Space
from gsgen.formats import FormatError, PackedRows, PointCloud, Splats, open_splats
from gsgen.runtime.camera import Camera
from gsgen.runtime.errors import SceneInvalid, SceneUnreadable
from gsgen.runtime.splat_data import SplatData

Center = Float[np.ndarray, "3"]

_UNSEEN = 2.0  # percent of the centres, at each end of each axis, that framing leaves out


class Source(ABC):
    """Gaussians, whatever they come from.

    Attributes:
        name: What it was opened from.
        data: The Gaussians as they are now.
        up: Which direction is up.
        antialias: How the scene was trained.
        color_space: Of the colours.
    """

    name: str
    data: SplatData
    up: tuple[float, float, float] = (0.0, -1.0, 0.0)
    antialias: Literal["classic", "mip"] = "classic"
    color_space: Literal["srgb", "linear"] = "srgb"

    @abstractmethod
    def update(self, camera: Camera, time: float | None) -> None:
        """Bring the Gaussians to a moment, for a camera; a time of None is the default."""

    @property
    @abstractmethod
    def time(self) -> Input | None:
        """What the manifest says of the time, or None where nothing moves with it."""

    def extent(self) -> tuple[Center, float]:
        """Return the middle of the Gaussians and half the diagonal of the box around most."""
        centers = self.data.rows[: self.data.count, :3].astype(np.float64)
        centers = centers[np.isfinite(centers).all(axis=1)]
        if not len(centers):
            return np.zeros(3), 1.0
        low, high = np.percentile(centers, [_UNSEEN, 100 - _UNSEEN], axis=0)
        return (low + high) / 2, float(np.linalg.norm(high - low)) / 2 or 1.0

    @abstractmethod
    def close(self) -> None:
        """Release what computes the frames."""


@final
class StillSource(Source):
    """A file of Gaussians.

    Args:
        path: PLY, NPZ or whatever ``open_splats`` reads.
    """

    def __init__(self, path: Path) -> None:
        self.name = str(path)
        try:
            content = open_splats(path)
        except FormatError as error:
            raise SceneUnreadable(str(error)) from error
        self.data = _drawable(content)
        if isinstance(content, Splats):
            self.antialias = "mip" if content.antialiased else "classic"
            self.color_space = content.color_space

    def update(self, camera: Camera, time: float | None) -> None:
        """Do nothing: a file stays as it is."""

    @property
    def time(self) -> Input | None:
        """None: a file stays as it is."""
        return None

    def close(self) -> None:
        """Do nothing: the file was closed when it was read."""


@final
class GeneratorSource(Source):
    """An ONNX model that makes Gaussians every frame.

    Args:
        path: The model.
        provider: What ONNX Runtime runs it on: cpu, webgpu, cuda or auto.
    """

    def __init__(self, path: Path, provider: str = "cpu") -> None:
        from gsgen.sdk.binding import FrameSession

        self.name = str(path)
        self._session = FrameSession(path, provider=provider)
        manifest = self._session.manifest
        if not isinstance(manifest, GeneratorManifest):
            self._session.close()
            seen = f"is a {manifest.kind}" if manifest else "has no manifest"
            raise SceneInvalid(
                f"{seen}, wanted a gaussian-generator",
                where=self.name,
                mend="`gsgen inspect --emit-manifest` derives a manifest from names and shapes.",
            )
        self._manifest = manifest
        self.up = direction((manifest.space or Space()).up)
        self.antialias = manifest.antialias
        appearance = manifest.outputs.appearance
        self._space: Literal["sh", "rgb"] = appearance.space if appearance else "rgb"
        self.color_space = appearance.color_space if appearance else "srgb"
        self._compute()

    def update(self, camera: Camera, time: float | None) -> None:
        """Run the model for a camera and a time."""
        values = {} if time is None or self.time is None else {"time": time}
        self._session.update(values, camera=camera)
        self._compute()

    def _compute(self) -> None:
        frame = self._session.run()
        outputs = self._manifest.outputs
        if outputs.gaussians is None or outputs.appearance is None:
            raise SceneInvalid("declares no gaussians or no appearance", where=self.name)
        rows, color = frame[outputs.gaussians.name], frame[outputs.appearance.name]
        if hasattr(self, "data") and self.data.rows.shape == rows.shape:
            self.data.update(rows, color, frame.count)
        else:
            self.data = SplatData(rows, color, self._space, count=frame.count)

    @property
    def time(self) -> Input | None:
        """What the manifest says of the time."""
        inputs = self._manifest.inputs
        return next((one for one in inputs if one.role == "time"), None)

    def close(self) -> None:
        """Release the session."""
        self._session.close()


def open_source(path: Path, provider: str = "cpu") -> Source:
    """Open a file of Gaussians or a generator, which the suffix ``.onnx`` tells.

    Args:
        path: The file.
        provider: What ONNX Runtime runs a generator on.

    Raises:
        SceneUnreadable: The file holds no Gaussians that can be read.
        ModelUnreadable: The file is no ONNX model.
        SceneInvalid: The model is no generator.
    """
    if path.suffix.lower() == ".onnx":
        return GeneratorSource(path, provider)
    return StillSource(path)


def _drawable(content: Splats | PointCloud | PackedRows) -> SplatData:
    if isinstance(content, Splats):
        return SplatData.from_splats(content)
    if isinstance(content, PointCloud):
        return SplatData.from_points(content)
    return SplatData.from_packed(content)


def direction(axis: str) -> tuple[float, float, float]:
    """Return the unit vector of an axis such as ``-y``."""
    sign = -1.0 if axis[0] == "-" else 1.0
    x, y, z = (sign * (name == axis[1]) for name in "xyz")
    return x, y, z
