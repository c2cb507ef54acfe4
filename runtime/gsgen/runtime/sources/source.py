"""Where Gaussians come from: a file that holds them, or a generator that makes them every frame."""

__all__ = [
    "GeneratorSource",
    "Source",
    "StillSource",
    "Values",
    "direction",
    "named",
    "open_source",
]

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Literal, final

import numpy as np
from jaxtyping import Float, Float64

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec import layout
from gsgen.contract.spec.manifest import Input, Space, WeightedSum
from gsgen.formats import FormatError, PackedRows, PointCloud, Splats, open_splats
from gsgen.runtime.errors import SceneUnreadable, placed
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.mesh import Mesh
from gsgen.runtime.scene.scene import SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.generator_worker import FrameDelta, Inference

Center = Float[np.ndarray, "3"]

Values = Mapping[str, object]
"""Tensor name or role → value."""

_UNSEEN = 2.0  # percent of the centres, at each end of each axis, that framing leaves out


class Source(ABC):
    """Gaussians, whatever they come from.

    Attributes:
        name: What it was opened from.
        data: The Gaussians as they are now.
        up: Which direction is up.
        antialias: How the scene was trained.
        color_space: Of the colours.
        weighted: How Gaussians are weighed where they are summed cell by cell.
        meshes: Triangles that are drawn with the Gaussians.
        inputs: What may be fed to it.
        seconds: What computing the present frame took.
    """

    name: str
    data: SplatData
    up: tuple[float, float, float] = (0.0, -1.0, 0.0)
    antialias: Literal["classic", "mip"] = "classic"
    color_space: Literal["srgb", "linear"] = "srgb"
    weighted: WeightedSum | None = None
    meshes: tuple[Mesh, ...] = ()
    inputs: tuple[Input, ...] = ()
    seconds: float = 0.0
    _extent: tuple[Center, float] | None = None

    @abstractmethod
    def start(self, camera: Camera | None, values: Values, frame: int = 0) -> None:
        """Begin to bring the Gaussians to a moment; they stay as they are until :meth:`finish`.

        Args:
            camera: Who will see them; None where nobody knows yet.
            values: Tensor name or role → value; what is not named keeps its value.
            frame: What an error calls the frame.
        """

    @abstractmethod
    def finish(self) -> None:
        """Bring the Gaussians to the moment that was begun.

        Raises:
            GsgenError: A value does not fit, or the model fails; it names model, input and frame.
        """

    @property
    def ready(self) -> bool:
        """Whether :meth:`finish` would return at once."""
        return True

    @abstractmethod
    def abandon(self) -> None:
        """Wait for the moment that was begun, if any; what is wrong with it concerns nobody."""

    def interrupt(self) -> None:  # noqa: B027 - what computes nothing has nothing to end
        """End what computes the moment that was begun, which fails."""

    def update(self, camera: Camera | None, values: Values, frame: int = 0) -> None:
        """Bring the Gaussians to a moment; see :meth:`start` and :meth:`finish`."""
        self.start(camera, values, frame)
        self.finish()

    def splats(
        self, sh_degree: int | None, antialias: Literal["classic", "mip"] | None
    ) -> SplatSet:
        """Return the Gaussians as they are drawn.

        Args:
            sh_degree: Use no harmonics above this; None for what the source says, or all.
            antialias: How the scene was trained; None for what the source says.
        """
        return SplatSet(
            self.data,
            degree=sh_degree,
            antialias=antialias or self.antialias,
            weighted=self.weighted,
        )

    @property
    def time(self) -> Input | None:
        """What the manifest says of the time, or None where nothing moves with it."""
        return next((spec for spec in self.inputs if spec.role == "time"), None)

    def named(self, word: str) -> list[Input]:
        """Return the inputs that a word means: a tensor of that name, or all of that role."""
        return named(self.inputs, word)

    @abstractmethod
    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an input."""

    def extent(self) -> tuple[Center, float]:
        """Return the middle of the Gaussians and half the diagonal of the box around most.

        They are those of the moments of :meth:`survey`, or of when this was first asked: cameras
        that are placed by them stand still while Gaussians move.
        """
        if self._extent is None:
            self._extent = _around([_centers(self.data)])
        return self._extent

    def survey(self, moments: Iterable[tuple[int, Values]]) -> None:
        """Bring the Gaussians to moments, one after the other; the extent becomes that of all.

        Args:
            moments: What an error calls the frame, and the values.
        """
        centers: dict[tuple[int, int], Float64[np.ndarray, "n 3"]] = {}
        for frame, values in moments:
            self.update(None, values, frame)
            state = (self.data.rows_version, self.data.count)
            if state not in centers:
                centers[state] = _centers(self.data)
        self._extent = _around(list(centers.values()))

    @abstractmethod
    def close(self) -> None:
        """Release what computes the frames."""


def named(inputs: Sequence[Input], word: str) -> list[Input]:
    """Return the inputs that a word means: a tensor of that name, or all of that role."""
    exact = [spec for spec in inputs if spec.name == word]
    return exact or [spec for spec in inputs if spec.role == word]


def _centers(data: SplatData) -> Float64[np.ndarray, "n 3"]:
    """Return the centres of what can be seen, or of all where nothing can."""
    rows = data.rows[: data.count]
    centers = rows[:, layout.POSITION].astype(np.float64)
    finite = np.isfinite(centers).all(axis=1)
    is_visible = finite & (rows[:, layout.OPACITY] > 0)
    return np.asarray(centers[is_visible if is_visible.any() else finite])


def _around(moments: Sequence[Float64[np.ndarray, "n 3"]]) -> tuple[Center, float]:
    """Return the middle and the reach of the boxes around most of the centres at each moment."""
    boxes = [
        np.percentile(centers, [_UNSEEN, 100 - _UNSEEN], axis=0)
        for centers in moments
        if len(centers)
    ]
    if not boxes:
        return np.zeros(3), 1.0
    low, high = np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]
    return (low + high) / 2, float(np.linalg.norm(high - low)) / 2 or 1.0


@final
class StillSource(Source):
    """A file of Gaussians.

    Args:
        path: PLY, NPZ or whatever ``open_splats`` reads.
    """

    def __init__(self, path: Path) -> None:
        self.name = str(path)
        try:
            content = open_splats(path, drop_invalid=True)
        except FormatError as error:
            raise SceneUnreadable(str(error)) from error
        self.data = _drawable(content)
        if isinstance(content, Splats):
            self.antialias = "mip" if content.antialiased else "classic"
            self.color_space = content.color_space

    def start(self, camera: Camera | None, values: Values, frame: int = 0) -> None:
        """Do nothing: a file stays as it is."""

    def finish(self) -> None:
        """Do nothing: a file stays as it is."""

    def abandon(self) -> None:
        """Do nothing: a file stays as it is."""

    def shape(self, name: str) -> tuple[int, ...]:
        """Raise: a file has no inputs."""
        raise KeyError(name)

    def close(self) -> None:
        """Do nothing: the file was closed when it was read."""


@final
class GeneratorSource(Source):
    """An ONNX model that makes Gaussians every frame; see :class:`Inference`.

    Args:
        path: The model.
        provider: What ONNX Runtime runs it on: cpu, webgpu, cuda or auto.
        sizes: Symbol → size of a dimension that the model leaves open.
    """

    def __init__(
        self, path: Path, provider: str = "cpu", sizes: Mapping[str, int] | None = None
    ) -> None:
        self.name = str(path)
        self._inference = Inference(path, provider, sizes)
        self.manifest = manifest = self._inference.manifest
        self.up = direction((manifest.space or Space()).up)
        self.antialias = manifest.antialias
        self.weighted = manifest.weighted_sum if manifest.blend == "wsr" else None
        self.inputs = manifest.inputs
        appearance = manifest.outputs.appearance
        assert appearance is not None  # an inference has both outputs
        self._space, self.color_space = appearance.space, appearance.color_space
        self._begun: tuple[int, Future[FrameDelta]] | None = None
        try:
            self.update(None, {})
        except BaseException:
            self.close()
            raise

    def start(self, camera: Camera | None, values: Values, frame: int = 0) -> None:
        """Begin to run the model."""
        self.abandon()
        self._begun = frame, self._inference.start(camera, values)

    @property
    def ready(self) -> bool:
        """Whether the model is done."""
        return self._begun is None or self._begun[1].done()

    def finish(self) -> None:
        """Wait for the model, and take over what it changed."""
        if self._begun is None:
            return
        (frame, future), self._begun = self._begun, None
        try:
            self._take(future.result())
        except GsgenError as error:
            raise placed(error, self.name, frame) from error
        except KeyboardInterrupt:
            self.interrupt()
            raise

    def interrupt(self) -> None:
        """End the run of the model."""
        self._inference.interrupt()

    def abandon(self) -> None:
        """Wait for the model. It makes a whole frame again after one that failed."""
        if self._begun is not None:
            (_, future), self._begun = self._begun, None
            if future.exception() is None:
                self._take(future.result())

    def _take(self, delta: FrameDelta) -> None:
        self.seconds = delta.seconds
        if hasattr(self, "data"):
            self.data.update(delta.rows, delta.appearance, delta.count, cells=delta.cells)
            return
        assert delta.rows is not None
        assert delta.appearance is not None
        cells = self.manifest.outputs.cells
        self.data = SplatData(
            delta.rows,
            delta.appearance,
            self._space,
            count=delta.count,
            cells=delta.cells,
            per_cell=cells.per_cell if cells else 1,
        )

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an input."""
        return self._inference.session.inputs[name].shape

    def close(self) -> None:
        """Release the session."""
        self._inference.close()


def open_source(
    path: Path, provider: str = "cpu", sizes: Mapping[str, int] | None = None
) -> Source:
    """Open a file of Gaussians or triangles, or a generator, which the suffix ``.onnx`` tells.

    Args:
        path: The file.
        provider: What ONNX Runtime runs a generator on.
        sizes: Symbol → size of a dimension that a generator leaves open.

    Raises:
        SceneUnreadable: The file holds nothing that can be read and drawn.
        ModelUnreadable: The file is no ONNX model.
        SceneInvalid: The model is no generator.
        SizeUnknown: A dimension has no size.
    """
    if path.suffix.lower() == ".onnx":
        return GeneratorSource(path, provider, sizes)
    from gsgen.runtime.sources.mesh_files import is_mesh

    if is_mesh(path):
        from gsgen.runtime.sources.mesh_source import MeshSource

        return MeshSource(path)
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
