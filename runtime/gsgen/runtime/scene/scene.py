"""Scenes of splat sets and meshes, each with a transform and its drawing settings."""

__all__ = ["Box", "Scene", "SplatSet"]

from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass, field
from typing import Literal, final

import numpy as np
from jaxtyping import Float

from gsgen.contract._notebook import preview_png, summary_html
from gsgen.contract.spec.manifest import WeightedSum
from gsgen.contract.spec.spherical_harmonics import MAX_DEGREE
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.scene.mesh import Mesh, MeshData
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.scene.splat_pool import PooledSplatSet, SplatPool
from gsgen.runtime.scene.transforms import identity, moved, require_affine


@final
@dataclass(frozen=True, slots=True)
class Box:
    """An axis-aligned box in a splat set's local space, from ``low`` to ``high`` inclusive."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]


@final
@dataclass(frozen=True, slots=True, eq=False)
class SplatSet:
    """A splat set: Gaussians with a transform to the world and drawing settings.

    Attributes:
        data: The Gaussians, which several sets may share; they are on the GPU once.
        transform: Local → world, [4, 4], affine and invertible. Covariances follow it;
            harmonics follow its rotation (the orthogonal factor of its polar decomposition).
        opacity_scale: Factor of all opacities, ≥ 0; results above 1 are clamped to 1.
        degree: Highest SH degree that is used; None for all.
        antialias: Compensation of the 0.3 pixels² of dilation: none in ``classic``, less
            opacity in ``mip`` (Yu et al. 2023, "Mip-Splatting"); that of ``data`` by default.
        clip: Gaussians with centres outside this box are not drawn; None for no box.
        weighted: Weights of the Gaussians if they are summed cell by cell; None if they are
            sorted and blended. The depth range, a length, follows the scale of the transform.

    Raises:
        SceneInvalid: The transform or a number cannot be used.
    """

    data: SplatData
    transform: Float[np.ndarray, "4 4"] = field(default_factory=identity)
    _: KW_ONLY
    opacity_scale: float = 1.0
    degree: int | None = None
    antialias: Literal["classic", "mip"] | None = None
    clip: Box | None = None
    weighted: WeightedSum | None = None

    def __post_init__(self) -> None:
        matrix = np.array(self.transform, np.float64)
        object.__setattr__(self, "transform", matrix)
        require_affine(matrix)
        if not (np.isfinite(self.opacity_scale) and self.opacity_scale >= 0):
            raise SceneInvalid(
                f"is {self.opacity_scale}, expected a finite number ≥ 0", where="opacity_scale"
            )
        if self.degree is not None and not 0 <= self.degree <= MAX_DEGREE:
            raise SceneInvalid(f"is {self.degree}, expected 0 to {MAX_DEGREE}", where="degree")
        if self.antialias is None:
            object.__setattr__(self, "antialias", self.data.antialias)
        if self.antialias not in ("classic", "mip"):
            raise SceneInvalid(f"is {self.antialias!r}, expected classic or mip", where="antialias")
        if self.weighted is not None:
            _require_weights(self.weighted, self.data)

    @property
    def rows_to_world(self) -> Float[np.ndarray, "4 4"]:
        """The transform of the rows, which are relative to the origin of ``data``, to the world."""
        return moved(self.transform, self.data.origin)

    @property
    def rows_clip(self) -> Box | None:
        """The clip box, relative to the origin of ``data`` as the rows are; None without one."""
        if self.clip is None or not any(self.data.origin):
            return self.clip
        low, high = (
            np.subtract(corner, self.data.origin) for corner in (self.clip.low, self.clip.high)
        )
        return Box(tuple(low.tolist()), tuple(high.tolist()))

    @property
    def depth_range(self) -> float | None:
        """The depth at which weights of weighted-sum rendering reach 0, in world units, or None."""
        if self.weighted is None or self.weighted.depth_range is None:
            return None
        volume = abs(float(np.linalg.det(self.transform[:3, :3])))
        return self.weighted.depth_range * float(np.cbrt(volume))


def _require_weights(weighted: WeightedSum, data: SplatData) -> None:
    if data.cells is None:
        raise SceneInvalid(
            "needs cells to sum Gaussians over, but the splat data has none",
            where="weighted",
            hint="Pass cells to SplatData, or leave `weighted` out to sort and blend.",
        )
    sizes = [weighted.opacity_divisor]
    sizes += [] if weighted.depth_range is None else [weighted.depth_range]
    if not all(np.isfinite(size) and size > 0 for size in sizes):
        raise SceneInvalid(
            f"has the opacity divisor {weighted.opacity_divisor} and the depth range "
            f"{weighted.depth_range}, expected numbers above 0",
            where="weighted",
        )
    if not (np.isfinite(weighted.background) and weighted.background >= 0):
        raise SceneInvalid(
            f"has the background weight {weighted.background}, expected a number >= 0",
            where="weighted",
        )


@final
@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A scene: splat sets and meshes that are drawn together.

    Attributes:
        sets: Splat sets; of Gaussians at the same depth, those of the earlier set are in front.
        color_space: Colour space of all sets, in which they are blended; that of their data by
            default.
        meshes: Opaque surfaces, whose colours are converted to this space; of two at the same
            depth, the earlier is in front.
        pools: Pools, whose tiles may change between frames; they count as sets after ``sets``.

    Raises:
        SceneInvalid: The sets have different colour spaces, and ``color_space`` is None; or one of
            ``sets`` is of another type.
    """

    sets: tuple[SplatSet, ...]
    color_space: Literal["srgb", "linear"] = "srgb"
    meshes: tuple[Mesh, ...] = ()
    pools: tuple[PooledSplatSet, ...] = ()

    def __init__(
        self,
        sets: Iterable[SplatSet | SplatData],
        color_space: Literal["srgb", "linear"] | None = None,
        meshes: Iterable[Mesh | MeshData] = (),
        pools: Iterable[PooledSplatSet | SplatPool] = (),
    ) -> None:
        splat_sets = tuple(map(_as_splat_set, sets))
        object.__setattr__(self, "sets", splat_sets)
        object.__setattr__(self, "color_space", color_space or _common_space(splat_sets))
        placed_meshes = tuple(mesh if isinstance(mesh, Mesh) else Mesh(mesh) for mesh in meshes)
        object.__setattr__(self, "meshes", placed_meshes)
        pooled_sets = tuple(
            pooled_set if isinstance(pooled_set, PooledSplatSet) else PooledSplatSet(pooled_set)
            for pooled_set in pools
        )
        object.__setattr__(self, "pools", pooled_sets)

    def _repr_html_(self) -> str:
        """Return a picture and the contents of the scene as HTML, for notebooks."""
        gaussians = sum(splat_set.data.count for splat_set in self.sets)
        rows = [
            ("Gaussians", f"{gaussians:,} in {len(self.sets)} sets"),
            ("meshes", str(len(self.meshes))),
            ("colour space", self.color_space),
        ]
        return summary_html("scene", rows, preview_png(self))

    def locate(self, index: int) -> tuple[int, int]:
        """Return the splat set's index, and the row in the set, of a Gaussian id in a frame's ids.

        Raises:
            IndexError: The scene has fewer Gaussians.
        """
        remaining = index
        for number, splat_set in enumerate(self.sets):
            if 0 <= remaining < len(splat_set.data):
                return number, remaining
            remaining -= len(splat_set.data)
        for number, pooled_set in enumerate(self.pools, start=len(self.sets)):
            if 0 <= remaining < len(pooled_set.pool):
                return number, remaining
            remaining -= len(pooled_set.pool)
        raise IndexError(f"Gaussian {index} is not in the scene: expected 0 to {len(self) - 1}")

    def __len__(self) -> int:
        own_count = sum(len(splat_set.data) for splat_set in self.sets)
        return own_count + sum(len(pooled_set.pool) for pooled_set in self.pools)


def _as_splat_set(entry: SplatSet | SplatData) -> SplatSet:
    if isinstance(entry, SplatSet):
        return entry
    if isinstance(entry, SplatData):
        return SplatSet(entry)
    raise SceneInvalid(
        f"one is of type {type(entry).__name__}, expected SplatData or SplatSet",
        where="sets",
        hint="A file is read by SplatData.from_splats(gsgen.formats.open_splats(file)).",
    )


def _common_space(sets: Iterable[SplatSet]) -> Literal["srgb", "linear"]:
    color_spaces = {splat_set.data.color_space for splat_set in sets}
    if len(color_spaces) > 1:
        raise SceneInvalid(
            "one set has linear colours, another sRGB: they cannot be blended",
            where="sets",
            hint="Draw them as two scenes, or pass color_space.",
        )
    return color_spaces.pop() if color_spaces else "srgb"
