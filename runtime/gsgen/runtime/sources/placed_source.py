"""Places a source of Gaussians or meshes in the world, with its own drawing settings."""

__all__ = ["DrawSettings", "PlacedSource", "fixed_and_keyed", "local_camera"]

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol, TypeVar, final

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import UnknownName
from gsgen.contract.spec.manifest import Input
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Box, SplatSet
from gsgen.runtime.scene.splat_pool import PooledSplatSet
from gsgen.runtime.sources.key_frames import Animation
from gsgen.runtime.sources.source import Source, SourceShortfall, Values, named

Value = TypeVar("Value")


class ModelInputs(Protocol):
    """A model with inputs: a source of Gaussians, or a post-process model."""

    @property
    def inputs(self) -> Sequence[Input]:
        """The model inputs that a caller may set."""

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an input tensor."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class DrawSettings:
    """Drawing settings of a file's or model's Gaussians: opacity, SH degree, antialiasing, clip.

    Attributes:
        opacity_scale: Factor of all opacities.
        sh_degree: Highest degree of spherical harmonics; None for all.
        antialias: How the scene was trained; None for the source's own setting.
        clip: A box in the source's own space, outside which no Gaussian is drawn.
        sorted: Blend in depth order, even if the source declares weighted sums.
    """

    opacity_scale: float = 1.0
    sh_degree: int | None = None
    antialias: Literal["classic", "mip"] | None = None
    clip: Box | None = None
    sorted: bool = False


@final
class PlacedSource(Source):
    """A source of Gaussians or meshes with a transform to the world and drawing settings.

    A generator computes Gaussians in its own space, for a camera in that space.

    Args:
        inner: The source; it is closed with this one.
        transform: Its space → world, [4, 4].
        settings: Drawing settings.
        values: Inputs with a fixed value: tensor name or role → value.
        where: Location of ``values`` in error messages.
        animation: The timeline of its scene, with key frames of inputs: tensor name or role → keys.
    """

    def __init__(
        self,
        inner: Source,
        transform: Float[np.ndarray, "4 4"],
        settings: DrawSettings | None = None,
        values: Values | None = None,
        where: str = "values",
        animation: Animation | None = None,
    ) -> None:
        self._wrapped_source, self._settings = inner, settings or DrawSettings()
        self._placement_transform = np.array(transform, np.float64)
        self._fixed_values, own_animation = fixed_and_keyed(inner, values, animation, where)
        self.animation = own_animation or inner.animation
        self.name, self.data, self.color_space = inner.name, inner.data, inner.color_space
        self.antialias = self._settings.antialias or inner.antialias
        self.weighted = None if self._settings.sorted else inner.weighted
        self.inputs = tuple(spec for spec in inner.inputs if spec.name not in self._fixed_values)
        self.splats(None, None)  # invalid settings raise here
        self.meshes = tuple(mesh.placed(self._placement_transform) for mesh in inner.meshes)
        self.pools = tuple(self._place_pool(pooled_set) for pooled_set in inner.pools)
        up = _rotation(self._placement_transform) @ np.array(inner.up)
        self.up = (float(up[0]), float(up[1]), float(up[2]))
        if self._fixed_values:
            self.update(None, {})

    def _place_pool(self, pooled_set: PooledSplatSet) -> PooledSplatSet:
        """Return a splat pool (streamed tiles) with this source's transform and drawing settings.

        Raises:
            SceneInvalid: The settings have a clip box, which pools do not support.
        """
        if self._settings.clip is not None:
            raise SceneInvalid("a tileset cannot be clipped", where="clip")
        return replace(
            pooled_set,
            transform=self._placement_transform @ pooled_set.transform,
            opacity_scale=self._settings.opacity_scale,
            degree=self._settings.sh_degree,
            antialias=self.antialias,
        )

    def expect(self, cameras: Sequence[Camera]) -> None:
        """Prepare the placed source for the cameras of all frames to come."""
        transform = self._placement_transform
        self._wrapped_source.expect([local_camera(camera, transform) for camera in cameras])

    @property
    def count(self) -> int:
        """The number of Gaussians that the current frame of the file or model may draw."""
        return self._wrapped_source.count

    @property
    def state(self) -> tuple[int, ...]:
        """Version numbers of a file's or model's data, which change when its Gaussians change."""
        return self._wrapped_source.state

    @property
    def metres_per_unit(self) -> float | None:
        """Metres of a unit of the world: the transform makes units of the source as long as that."""
        metres = self._wrapped_source.metres_per_unit
        return metres and metres / _uniform_scale(self._placement_transform[:3, :3])

    @property
    def follows_camera(self) -> bool:
        """Whether the source of Gaussians computes a new frame when the camera moves."""
        return self._wrapped_source.follows_camera

    @property
    def is_streaming(self) -> bool:
        """Whether Gaussians of a source may change although the camera stays, as in streaming."""
        return self._wrapped_source.is_streaming

    @property
    def shortfall(self) -> SourceShortfall | None:
        """The parts of the placed source that the drawn frames lack; None if all is there."""
        return self._wrapped_source.shortfall

    @property
    def statistics(self) -> tuple[tuple[str, str], ...]:
        """Statistics of a source of Gaussians for display in a viewer, as names and values."""
        return self._wrapped_source.statistics

    def splats(
        self, sh_degree: int | None, antialias: Literal["classic", "mip"] | None
    ) -> SplatSet:
        """Return the Gaussians of a file or model with the transform and the drawing settings."""
        degree = self._settings.sh_degree if sh_degree is None else sh_degree
        return SplatSet(
            self.data,
            self._placement_transform,
            opacity_scale=self._settings.opacity_scale,
            degree=degree,
            antialias=antialias or self.antialias,
            clip=self._settings.clip,
            weighted=self.weighted,
        )

    def start(self, camera: Camera | None, values: Values, frame: int = 0) -> None:
        """Begin to compute a frame; the camera is converted to the local space of the Gaussians."""
        local = None if camera is None else local_camera(camera, self._placement_transform)
        self._wrapped_source.start(local, {**values, **self._fixed_values}, frame)

    @property
    def ready(self) -> bool:
        """Whether the file or model has computed the frame that :meth:`start` requested."""
        return self._wrapped_source.ready

    def finish(self) -> None:
        """Wait for the frame that :meth:`start` requested; its Gaussians replace the last ones."""
        self._wrapped_source.finish()
        self.data, self.seconds = self._wrapped_source.data, self._wrapped_source.seconds

    def abandon(self) -> None:
        """Wait for the frame that :meth:`start` requested, and discard its result or error."""
        self._wrapped_source.abandon()

    def hold_frames(self, frames: int) -> bool:
        """Keep the arrays of earlier frames unchanged; return whether the file or model can."""
        return self._wrapped_source.hold_frames(frames)

    def survey(self, frames: Iterable[tuple[int, Values]]) -> None:
        """Compute some frames, and set the scene extent to a box around all their Gaussians."""
        self._wrapped_source.survey(
            (frame, {**values, **self._fixed_values}) for frame, values in frames
        )
        self.data, self.seconds = self._wrapped_source.data, self._wrapped_source.seconds

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an input tensor of the model that computes the Gaussians."""
        return self._wrapped_source.shape(name)

    def extent(self) -> tuple[Float[np.ndarray, "3"], float]:
        """Return the world-space centre of a box around most Gaussians, and half the diagonal."""
        center, reach = self._wrapped_source.extent()
        linear, offset = self._placement_transform[:3, :3], self._placement_transform[:3, 3]
        return linear @ center + offset, reach * _uniform_scale(linear)

    def close(self) -> None:
        """Release the file or model that supplies the Gaussians."""
        self._wrapped_source.close()


def fixed_and_keyed(
    model: ModelInputs, values: Values | None, animation: Animation | None, where: str
) -> tuple[dict[str, object], Animation | None]:
    """Return a scene file's values and key frames of a model's inputs, by tensor name.

    Raises:
        UnknownName: The model has no such input.
        SceneInvalid: Key frames have more or fewer numbers than their input.
    """
    fixed_values = _by_tensor_name(model, values or {}, where)
    if animation is None:
        return fixed_values, None
    keys = _by_tensor_name(model, animation.keys, where)
    for name, key_frames in keys.items():
        expected, count = math.prod(model.shape(name)), key_frames.values.shape[1]
        if count != expected:
            raise SceneInvalid(f"has {count} numbers, expected {expected}", where=f"{where}.{name}")
    return fixed_values, replace(animation, keys=keys)


def _by_tensor_name(
    model: ModelInputs, values: Mapping[str, Value], where: str
) -> dict[str, Value]:
    """Convert names and input roles of model inputs to tensor names, the keys of input values."""
    known_names = {input_name for spec in model.inputs for input_name in (spec.name, spec.role)}
    by_name: dict[str, Value] = {}
    for input_name, value in values.items():
        matches = named(model.inputs, input_name)
        if not matches:
            raise UnknownName.among("input", input_name, known_names, where)
        by_name |= {spec.name: value for spec in matches}
    return by_name


def _uniform_scale(linear: Float[np.ndarray, "3 3"]) -> float:
    """Return the geometric mean of a matrix's scales along the axes."""
    return float(np.cbrt(abs(np.linalg.det(linear))))


def _rotation(transform: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation or reflection nearest to a transform, by polar decomposition."""
    left, _, right = np.linalg.svd(transform[:3, :3])
    return np.asarray(left @ right)


def local_camera(camera: Camera, transform: Float[np.ndarray, "4 4"]) -> Camera:
    """Convert a camera from world space to the local space of a placed file or model.

    A camera can neither shear nor mirror: the nearest rotation is used.
    """
    linear, offset = transform[:3, :3], transform[:3, 3]
    left, _, right = np.linalg.svd(linear)
    rotation = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    view = np.eye(4)
    view[:3, :3] = camera.view[:3, :3] @ rotation
    view[:3, 3] = -view[:3, :3] @ np.linalg.solve(linear, camera.eye - offset)
    scale = _uniform_scale(linear)
    zoom_factor = (
        scale if camera.kind == "orthographic" else 1.0
    )  # its focal length is pixels per unit
    return replace(
        camera,
        view=view,
        near=camera.near / scale,
        fx=camera.fx * zoom_factor,
        fy=camera.fy * zoom_factor,
    )
