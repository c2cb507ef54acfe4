"""Sources of Gaussians: files, and ONNX generators, which compute them in every frame."""

__all__ = [
    "GeneratorSource",
    "Source",
    "SourceShortfall",
    "StaticSource",
    "StillFrameSource",
    "Values",
    "axis_direction",
    "named",
]

import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, final

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.fields.roles import CAMERA_ROLES
from gsgen.contract.spec.manifest import Input, Space, WeightedSum
from gsgen.formats import FormatError, FormatWarning, PackedRows, PointCloud, Splats, open_splats
from gsgen.formats.shared.notices import MeshWarning
from gsgen.formats.shared.origins import Origin
from gsgen.runtime.errors import SceneUnreadable, locate_in_frame
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.mesh import Mesh
from gsgen.runtime.scene.scene import SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.scene.splat_pool import PooledSplatSet
from gsgen.runtime.sources.framing import Box, box_around, union_of_boxes
from gsgen.runtime.sources.generator_worker import FrameDelta, GeneratorWorker
from gsgen.runtime.sources.key_frames import Animation
from gsgen.runtime.sources.mesh_files import read_mesh

if TYPE_CHECKING:
    from gsgen.sdk.binding.confined.models import ConfinedModels

Center = Float[np.ndarray, "3"]

Values = Mapping[str, object]
"""Tensor name or role → value."""


@final
@dataclass(frozen=True, slots=True)
class SourceShortfall:
    """Parts of a source that the frames drawn so far lack.

    Attributes:
        name: Of the source.
        tiles: Number of tiles that are missing, or drawn coarser than the frames need.
        cause: Why the first one is, in one line.
    """

    name: str
    tiles: int
    cause: str


class Source(ABC):
    """Base of all sources of Gaussians and meshes: files, generators and scenes in memory.

    Attributes:
        name: Path or name of the source, for messages.
        data: The current Gaussians.
        up: The upward direction, a unit vector.
        space: What an ONNX generator declares of its local space; None for others.
        antialias: Antialiasing of the training.
        color_space: Colour space of the Gaussians.
        weighted: Weights of Gaussians that are blended by weighted sums; None for sorted blending.
        meshes: Triangles that are drawn with the Gaussians.
        inputs: The inputs that a caller may set.
        pools: Pools whose tiles are drawn with the Gaussians.
        seconds: Seconds that the current frame took to compute.
        files: The files of a sequence, one per frame; empty for other sources.
        animation: The timeline of a scene file, with key frames of inputs; None without.
    """

    name: str
    data: SplatData
    up: tuple[float, float, float] = (0.0, -1.0, 0.0)
    space: Space | None = None
    antialias: Literal["classic", "mip"] = "classic"
    color_space: Literal["srgb", "linear"] = "srgb"
    weighted: WeightedSum | None = None
    meshes: tuple[Mesh, ...] = ()
    inputs: tuple[Input, ...] = ()
    pools: tuple[PooledSplatSet, ...] = ()
    seconds: float = 0.0
    files: Sequence[Path] = ()
    animation: Animation | None = None
    _extent: tuple[Center, float] | None = None

    @abstractmethod
    def start(self, camera: Camera | None, values: Values, frame: int = 0) -> None:
        """Begin to compute a frame; the Gaussians change in :meth:`finish`.

        Args:
            camera: The camera of the frame; None if it is not known.
            values: Tensor name or role → value; absent inputs keep their value.
            frame: Frame number in error messages.
        """

    @abstractmethod
    def finish(self) -> None:
        """Wait for the frame that :meth:`start` requested; its Gaussians replace the last ones.

        Raises:
            GsgenError: A value does not fit, or the model fails; the error names model, input, frame.
        """

    @property
    def ready(self) -> bool:
        """Whether the frame of :meth:`start` is computed, so that :meth:`finish` returns at once."""
        return True

    @abstractmethod
    def abandon(self) -> None:
        """Wait for the frame that :meth:`start` requested, and discard its result or error."""

    def expect(self, cameras: Sequence[Camera]) -> None:  # noqa: B027 - a file has all
        """Prepare for the cameras of all frames to come, in their order."""

    def interrupt(self) -> None:  # noqa: B027 - a file computes nothing
        """Stop computing the frame that :meth:`start` requested, which then fails."""

    def hold_frames(self, frames: int) -> bool:
        """Keep the arrays of earlier frames unchanged; return whether the source can.

        A player that draws frames late may draw them again. A source that writes into the arrays
        of its last frame, or that uploads by itself, cannot hold any.

        Args:
            frames: Number of frames before the one of the last :meth:`finish`.
        """
        return frames == 0

    def update(self, camera: Camera | None, values: Values, frame: int = 0) -> None:
        """Compute a frame and update the Gaussians, by :meth:`start` and :meth:`finish`."""
        self.start(camera, values, frame)
        self.finish()

    def splats(
        self, sh_degree: int | None, antialias: Literal["classic", "mip"] | None
    ) -> SplatSet:
        """Return the current Gaussians of a file or model as a splat set with drawing settings."""
        return SplatSet(
            self.data,
            degree=sh_degree,
            antialias=antialias or self.antialias,
            weighted=self.weighted,
        )

    @property
    def count(self) -> int:
        """The number of Gaussians of a file or model that the current frame may draw."""
        return self.data.count

    @property
    def state(self) -> tuple[int, ...]:
        """Version numbers of a file's or model's data, which change when its Gaussians change."""
        data = self.data
        versions = (data.rows_version, data.appearance_version, data.cells_version)
        return (id(data), *versions, data.count)

    @property
    def metres_per_unit(self) -> float | None:
        """Metres of a unit of length, as a generator declares them; None if it does not."""
        space = self.space
        is_metric = space is not None and space.unit == "metre"
        return (space and space.metres_per_unit) or (1.0 if is_metric else None)

    @property
    def follows_camera(self) -> bool:
        """Whether the source of Gaussians must compute a new frame when the camera moves."""
        return any(spec.role in CAMERA_ROLES for spec in self.inputs)

    @property
    def is_streaming(self) -> bool:
        """Whether Gaussians of a source may change although the camera and the inputs stay."""
        return False

    @property
    def shortfall(self) -> SourceShortfall | None:
        """The parts that the drawn frames lack; None if all is there, as with files and models."""
        return None

    @property
    def statistics(self) -> tuple[tuple[str, str], ...]:
        """Statistics of a source of Gaussians for display in a viewer, as names and values."""
        return ()

    @property
    def time(self) -> Input | None:
        """The time input of the ONNX generator; None if the source has no time input."""
        return next((spec for spec in self.inputs if spec.role == "time"), None)

    def named(self, word: str) -> list[Input]:
        """Return the model inputs with this tensor name, or else with this input role."""
        return named(self.inputs, word)

    @abstractmethod
    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an input tensor of the ONNX generator."""

    def extent(self) -> tuple[Center, float]:
        """Return the centre of a box around the Gaussians but floaters, and half its diagonal.

        The box spans the frames of :meth:`survey`, or else the Gaussians at the first call: cameras
        that are placed by it stand still while Gaussians move. See :mod:`.framing`.
        """
        if self._extent is None:
            self._extent = _box_extent(_box_in_file(self.data))
        return self._extent

    def survey(self, frames: Iterable[tuple[int, Values]]) -> None:
        """Compute some frames, and set the scene extent to a box around all their Gaussians."""
        boxes: dict[tuple[int, int], Box | None] = {}
        for frame, values in frames:
            self.update(None, values, frame)
            state = (self.data.rows_version, self.data.count)
            if state not in boxes:
                boxes[state] = _box_in_file(self.data)
        self._extent = _box_extent(union_of_boxes(list(boxes.values())))

    @abstractmethod
    def close(self) -> None:
        """Release the ONNX model that computes the Gaussians."""


def named(inputs: Sequence[Input], word: str) -> list[Input]:
    """Return the model inputs with this tensor name, or else with this input role."""
    exact_matches = [spec for spec in inputs if spec.name == word]
    return exact_matches or [spec for spec in inputs if spec.role == word]


def _box_in_file(data: SplatData) -> Box | None:
    """Return the box around the Gaussians but floaters, in the coordinates of their file."""
    box = box_around(data)
    return None if box is None else (box[0] + data.origin, box[1] + data.origin)


def _box_extent(box: Box | None) -> tuple[Center, float]:
    """Return the centre of a box and half its diagonal; 1 around the origin without a box."""
    if box is None:
        return np.zeros(3), 1.0
    low, high = box
    return (low + high) / 2, float(np.linalg.norm(high - low)) / 2 or 1.0


class StaticSource(Source):
    """Base of scene sources that compute nothing: splat files, meshes and scenes in memory."""

    def start(self, camera: Camera | None, values: Values, frame: int = 0) -> None:
        """Ignore camera and inputs, because the Gaussians are the same in every frame."""

    def finish(self) -> None:
        """Return at once: splat files and meshes need no computation to wait for."""

    def abandon(self) -> None:
        """Return at once: splat files and meshes have no computation to discard."""

    def hold_frames(self, frames: int) -> bool:
        """Return True: the arrays of splat files and meshes stay the same."""
        return True

    def shape(self, name: str) -> tuple[int, ...]:
        """Raise KeyError: a splat file or mesh has no inputs."""
        raise KeyError(name)

    def close(self) -> None:
        """Release nothing, because a static source keeps no file or model open."""


@final
class StillFrameSource(StaticSource):
    """The Gaussians of a splat file, the same in every frame, as a source for the renderer.

    Args:
        path: The file.
        origin: The point of the file that float32 positions are relative to; see ``open_splats``.
    """

    def __init__(self, path: Path, origin: Origin | None = None) -> None:
        self.name = str(path)
        try:
            with warnings.catch_warnings(record=True) as caught_warnings:
                warnings.simplefilter("always", FormatWarning)
                content = open_splats(path, drop_invalid=True, origin=origin)
        except FormatError as error:
            raise SceneUnreadable(str(error)) from error
        self.data = _splat_data(content)
        if isinstance(content, Splats):
            self.antialias = "mip" if content.antialiased else "classic"
            self.color_space = content.color_space
            self.up = content.up
        for warning in caught_warnings:
            if issubclass(warning.category, MeshWarning):
                self.meshes = read_mesh(path)  # drawn among the splats
            else:
                warnings.warn(warning.message, warning.category, stacklevel=2)


@final
class GeneratorSource(Source):
    """A source of Gaussians that an ONNX model computes; see :class:`GeneratorWorker`."""

    def __init__(
        self,
        path: Path,
        provider: str = "cpu",
        sizes: Mapping[str, int] | None = None,
        confined: "ConfinedModels | None" = None,
    ) -> None:
        self.name = str(path)
        self._worker = GeneratorWorker(path, provider, sizes, confined)
        self.manifest = manifest = self._worker.manifest
        self.space = manifest.space
        self.up = axis_direction((manifest.space or Space()).up)
        self.antialias = manifest.antialias
        self.weighted = manifest.weighted_sum if manifest.blend == "wsr" else None
        self.inputs = manifest.inputs
        appearance = manifest.outputs.appearance
        assert appearance is not None  # the worker requires both outputs
        self._appearance_space, self.color_space = appearance.space, appearance.color_space
        self._pending_frame: tuple[int, Future[FrameDelta]] | None = None
        try:
            self.update(None, {})
        except BaseException:
            self.close()
            raise

    def start(self, camera: Camera | None, values: Values, frame: int = 0) -> None:
        """Begin to run the ONNX generator for a frame."""
        self.abandon()
        self._pending_frame = frame, self._worker.start(camera, values)

    @property
    def ready(self) -> bool:
        """Whether the ONNX generator has computed the frame that :meth:`start` requested."""
        return self._pending_frame is None or self._pending_frame[1].done()

    def finish(self) -> None:
        """Wait for the ONNX generator, and copy its changed outputs."""
        if self._pending_frame is None:
            return
        (frame, future), self._pending_frame = self._pending_frame, None
        try:
            self._apply_delta(future.result())
        except GsgenError as error:
            raise locate_in_frame(error, self.name, frame) from error
        except KeyboardInterrupt:
            self.interrupt()
            raise

    def interrupt(self) -> None:
        """Stop the pending run of the ONNX generator."""
        self._worker.interrupt()

    def abandon(self) -> None:
        """Wait for the pending run of the ONNX generator, and discard its result or error."""
        if self._pending_frame is not None:
            (_, future), self._pending_frame = self._pending_frame, None
            if future.exception() is None:
                self._apply_delta(future.result())

    def hold_frames(self, frames: int) -> bool:
        """Keep the ONNX generator's outputs of some frames before the present one."""
        self._worker.hold_frames(frames)
        return True

    def _apply_delta(self, delta: FrameDelta) -> None:
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
            self._appearance_space,
            count=delta.count,
            cells=delta.cells,
            per_cell=cells.per_cell if cells else 1,
        )

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an input tensor of the ONNX generator."""
        return self._worker.session.inputs[name].shape

    def close(self) -> None:
        """Release the session of the ONNX generator."""
        self._worker.close()


def _splat_data(content: Splats | PointCloud | PackedRows) -> SplatData:
    if isinstance(content, Splats):
        return SplatData.from_splats(content)
    if isinstance(content, PointCloud):
        return SplatData.from_points(content)
    return SplatData.from_packed(content)


def axis_direction(axis: str) -> tuple[float, float, float]:
    """Return the unit vector of an axis such as ``-y``."""
    sign = -1.0 if axis[0] == "-" else 1.0
    x, y, z = (sign * (name == axis[1]) for name in "xyz")
    return x, y, z
