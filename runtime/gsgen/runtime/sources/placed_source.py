"""Placed sources: a source with its place in the world, and how it is to be drawn."""

__all__ = ["Look", "PlacedSource"]

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Literal, final

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import UnknownName
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Box, SplatSet
from gsgen.runtime.sources.source import Source, Values


@final
@dataclass(frozen=True, slots=True)
class Look:
    """How the Gaussians of a source are drawn; see :class:`gsgen.runtime.scene.scene.SplatSet`.

    Attributes:
        opacity_scale: Factor of all opacities.
        sh_degree: Use no harmonics above this; None for all.
        antialias: How the scene was trained; None for what the source says.
        clip: In the source's own space.
        sorted: Blend sorted what the source would have summed cell by cell.
    """

    opacity_scale: float = 1.0
    sh_degree: int | None = None
    antialias: Literal["classic", "mip"] | None = None
    clip: Box | None = None
    sorted: bool = False


@final
class PlacedSource(Source):
    """Another source, moved.

    A generator is asked for what a camera in its own space sees: it makes Gaussians there.

    Args:
        inner: The source; it is closed with this one.
        transform: Its space → world, [4, 4].
        look: How it is drawn.
        values: Inputs that stay as they are: tensor name or role → value.
        where: What an error calls the place of ``values``.

    Raises:
        UnknownName: The source has no such input.
        SceneInvalid: The transform or the look cannot be used.
    """

    def __init__(
        self,
        inner: Source,
        transform: Float[np.ndarray, "4 4"],
        look: Look | None = None,
        values: Values | None = None,
        where: str = "values",
    ) -> None:
        self._inner, self._look = inner, look or Look()
        self._transform = np.array(transform, np.float64)
        self._fixed = _by_name(inner, values or {}, where)
        self.name, self.data, self.color_space = inner.name, inner.data, inner.color_space
        self.antialias = self._look.antialias or inner.antialias
        self.weighted = None if self._look.sorted else inner.weighted
        self.inputs = tuple(spec for spec in inner.inputs if spec.name not in self._fixed)
        self.splats(None, None)  # what cannot be drawn says so now
        self.meshes = tuple(mesh.placed(self._transform) for mesh in inner.meshes)
        up = _rotation(self._transform) @ np.array(inner.up)
        self.up = (float(up[0]), float(up[1]), float(up[2]))
        if self._fixed:
            self.update(None, {})

    def splats(
        self, sh_degree: int | None, antialias: Literal["classic", "mip"] | None
    ) -> SplatSet:
        """Return the Gaussians as they are drawn."""
        degree = self._look.sh_degree if sh_degree is None else sh_degree
        return SplatSet(
            self.data,
            self._transform,
            opacity_scale=self._look.opacity_scale,
            degree=degree,
            antialias=antialias or self.antialias,
            clip=self._look.clip,
            weighted=self.weighted,
        )

    def start(self, camera: Camera | None, values: Values, frame: int = 0) -> None:
        """Begin to compute what a camera sees, from where it is in the source's space."""
        local = None if camera is None else local_camera(camera, self._transform)
        self._inner.start(local, {**values, **self._fixed}, frame)

    @property
    def ready(self) -> bool:
        """Whether the source is done."""
        return self._inner.ready

    def finish(self) -> None:
        """Wait for the source."""
        self._inner.finish()
        self.data, self.seconds = self._inner.data, self._inner.seconds

    def abandon(self) -> None:
        """Wait for the source; what is wrong concerns nobody."""
        self._inner.abandon()

    def survey(self, moments: Iterable[tuple[int, Values]]) -> None:
        """Bring the source to moments, whose extent becomes that of all."""
        self._inner.survey((frame, {**values, **self._fixed}) for frame, values in moments)
        self.data, self.seconds = self._inner.data, self._inner.seconds

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an input."""
        return self._inner.shape(name)

    def extent(self) -> tuple[Float[np.ndarray, "3"], float]:
        """Return the middle in the world and half the diagonal of a box around most of it."""
        center, reach = self._inner.extent()
        linear, offset = self._transform[:3, :3], self._transform[:3, 3]
        return linear @ center + offset, reach * _scale(linear)

    def close(self) -> None:
        """Release the source."""
        self._inner.close()


def _by_name(source: Source, values: Values, where: str) -> Mapping[str, object]:
    """Return the values by tensor name."""
    known = {word for spec in source.inputs for word in (spec.name, spec.role)}
    by_name: dict[str, object] = {}
    for word, value in values.items():
        matches = source.named(word)
        if not matches:
            raise UnknownName.among("input", word, known, where)
        by_name |= {spec.name: value for spec in matches}
    return by_name


def _scale(linear: Float[np.ndarray, "3 3"]) -> float:
    """Return the mean of the scales along the axes."""
    return float(np.cbrt(abs(np.linalg.det(linear))))


def _rotation(transform: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3 3"]:
    """Return the orthogonal factor of the polar decomposition; a reflection stays one."""
    left, _, right = np.linalg.svd(transform[:3, :3])
    return np.asarray(left @ right)


def local_camera(camera: Camera, transform: Float[np.ndarray, "4 4"]) -> Camera:
    """Return where a camera is, and which way it looks, in a space that is placed in its world.

    A camera has neither a shear nor a mirror: of these the nearest rotation is left.

    Args:
        camera: In the world.
        transform: The space → world, [4, 4].
    """
    linear, offset = transform[:3, :3], transform[:3, 3]
    left, _, right = np.linalg.svd(linear)
    turn = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    view = np.eye(4)
    view[:3, :3] = camera.view[:3, :3] @ turn
    view[:3, 3] = -view[:3, :3] @ np.linalg.solve(linear, camera.eye - offset)
    scale = _scale(linear)
    flat = scale if camera.kind == "orthographic" else 1.0  # pixels for each unit
    return replace(
        camera,
        view=view,
        near=camera.near / scale,
        fx=camera.fx * flat,
        fy=camera.fy * flat,
    )
