"""Static scenes: a splat file or a coloured point cloud as a generator without inputs.

Splats are activated as in Kerbl et al. 2023, "3D Gaussian Splatting for Real-Time Radiance Field
Rendering": opacity by the sigmoid, scale by the exponential, covariance by equation 6. Bare
points get the initialisation of its published code: isotropic Gaussians whose variance is the
mean squared distance to the three nearest neighbours, at opacity 0.1.
"""

__all__ = [
    "INITIAL_OPACITY",
    "StaticScene",
    "from_content",
    "neighbour_scale",
    "write_scene",
]

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec import layout
from gsgen.contract.spec.geometry import covariance_upper
from gsgen.contract.spec.manifest import (
    AppearanceOutput,
    Bounds,
    CountOutput,
    GaussiansOutput,
    GeneratorManifest,
    GeneratorOutputs,
    Producer,
    Space,
    Tolerances,
)
from gsgen.contract.spec.spherical_harmonics import (
    COEFFICIENTS,
    MAX_DEGREE,
    basis,
    coefficients,
    degree_of,
)
from gsgen.formats import PackedRows, PointCloud, Splats
from gsgen.sdk.exporting.constant_generator import write_constant
from gsgen.sdk.exporting.sh_degrees import taken_degree
from gsgen.sdk.rewriting.atomic_model_files import atomic_write

INITIAL_OPACITY = 0.1

# The published initialisation clamps squared distances here, so that duplicates have a size.
_SMALLEST_SQUARE = 1e-7
_NEIGHBOURS = 3
_UP = np.array([[0.0, -1.0, 0.0]])
_BOUNDS_MARGIN = 1e-3

Dtype = Literal["float32", "float16"]


@dataclass(frozen=True, slots=True)
class StaticScene:
    """Packed rows, ready to be written.

    Attributes:
        rows: Packed Gaussians, [N, 10].
        appearance: SH or RGB, [N, C].
        space: What ``appearance`` holds.
        source: What the rows were made of, in words.
        notes: What the user should know of the conversion.
    """

    rows: Float[np.ndarray, "n 10"]
    appearance: Float[np.ndarray, "n c"]
    space: Literal["sh", "rgb"]
    source: str
    notes: tuple[str, ...] = ()

    @property
    def degree(self) -> int | None:
        """The SH degree, or None for RGB."""
        return degree_of(self.appearance.shape[1] // 3) if self.space == "sh" else None


def from_content(
    content: Splats | PointCloud | PackedRows,
    *,
    dtype: Dtype | None = None,
    opacity: float = INITIAL_OPACITY,
    appearance: Literal["sh", "rgb"] | None = None,
    sh_degree: int | None = None,
) -> StaticScene:
    """Turn what a file holds into packed rows.

    Args:
        content: Splats, points, or rows that are packed already and pass through unchanged.
        dtype: Of the rows; float32, or that of packed rows, where absent.
        opacity: Of bare points, in (0, 1].
        appearance: What packed rows with three channels hold, RGB where absent.
        sh_degree: Cut SH to this degree, or fill up to it with zeros; points become SH with it,
            and raw RGB without. Packed rows stay as they are. In float16 a degree of 0 or 2 is
            filled up to the next.

    Raises:
        GsgenError: Packed rows have a number of channels that means nothing.
    """
    if isinstance(content, PackedRows):
        return _from_rows(content, dtype, appearance)
    if isinstance(content, Splats):
        return _from_splats(content, dtype or "float32", sh_degree)
    return _from_points(content, dtype or "float32", opacity, sh_degree)


def _from_splats(splats: Splats, dtype: Dtype, sh_degree: int | None) -> StaticScene:
    degree = min(splats.degree, MAX_DEGREE) if sh_degree is None else sh_degree
    notes: tuple[str, ...] = ()
    if splats.degree > degree:
        notes = (f"SH degree {splats.degree} is cut to {degree}",)
    degree, more = _taken(degree, dtype)
    notes += more
    with np.errstate(
        over="ignore"
    ):  # exp(-(-inf)) is inf, and 1 / (1 + inf) is the 0 it means
        opacity = 1 / (1 + np.exp(-splats.logit_opacity.astype(np.float64)))
    gaussians = layout.DecodedGaussians(
        position=splats.position,
        opacity=opacity,
        covariance=covariance_upper(
            np.exp(splats.log_scale.astype(np.float64)), splats.rotation
        ),
        sh=_of_degree(splats.sh, degree),
    )
    source = f"{len(splats):,} splats of SH degree {splats.degree}"
    return StaticScene(*layout.encode(gaussians, _type(dtype)), "sh", source, notes)


def _taken(degree: int, dtype: Dtype) -> tuple[int, tuple[str, ...]]:
    """Return a degree that rows of ``dtype`` can have, and what was done."""
    taken, why = taken_degree(degree, half=dtype == "float16")
    return taken, (why,) if why else ()


def _of_degree(sh: Float[np.ndarray, "n k 3"], degree: int) -> Float[np.ndarray, "n l 3"]:
    """Cut SH to a degree, or fill it up with zeros."""
    made = np.zeros((len(sh), coefficients(degree), 3), sh.dtype)
    shared = min(made.shape[1], sh.shape[1])
    made[:, :shared] = sh[:, :shared]
    return made


def _from_points(
    points: PointCloud, dtype: Dtype, opacity: float, sh_degree: int | None
) -> StaticScene:
    scale = neighbour_scale(points.position)
    n = len(points)
    notes: tuple[str, ...] = ()
    if sh_degree is not None:
        sh_degree, notes = _taken(sh_degree, dtype)
    covariance = np.zeros((n, 6))
    covariance[:, [0, 3, 5]] = (scale**2)[:, None]
    gaussians = layout.DecodedGaussians(
        position=points.position,
        opacity=np.full(n, opacity),
        covariance=covariance,
        rgb=points.color if sh_degree is None else None,
        sh=None
        if sh_degree is None
        else _of_degree(_constant_term(points.color), sh_degree),
    )
    space: Literal["sh", "rgb"] = "rgb" if sh_degree is None else "sh"
    source = f"{n:,} coloured points"
    return StaticScene(*layout.encode(gaussians, _type(dtype)), space, source, notes)


def _constant_term(color: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 1 3"]:
    """Return the SH of degree 0 that shows ``color`` from everywhere: 0.5 + Y₀ c₀ = colour."""
    return np.asarray((np.asarray(color, np.float64)[:, None] - 0.5) / basis(_UP, 0)[0, 0])


def _from_rows(
    rows: PackedRows, dtype: Dtype | None, appearance: Literal["sh", "rgb"] | None
) -> StaticScene:
    channels = rows.appearance.shape[1]
    sh = [3 * count for count in COEFFICIENTS]
    space: Literal["sh", "rgb"] = "rgb" if channels in (3, 4) else "sh"
    space = appearance or space
    if channels not in (sh if space == "sh" else (3, 4)):
        wanted = f"{sh} for SH or 3 or 4 for RGB"
        raise GsgenError(f"{channels} channels, wanted {wanted}", where="appearance")
    packed, color = rows.gaussians, rows.appearance
    if dtype is not None:
        packed, color = packed.astype(_type(dtype)), color.astype(_type(dtype))
    return StaticScene(packed, color, space, f"{len(rows):,} packed rows")


def _type(dtype: Dtype) -> type[np.float32] | type[np.float16]:
    return np.float16 if dtype == "float16" else np.float32


def neighbour_scale(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Return the root mean square distance of each point to its three nearest neighbours.

    Raises:
        GsgenError: SciPy, whose search tree is used, is not installed.
    """
    try:
        from scipy.spatial import KDTree
    except ImportError as error:
        raise GsgenError(
            "sizes of bare points need scipy, which is not installed",
            hint="pip install 'gsgen[sdk]'",
        ) from error
    wide = np.asarray(points, np.float64)
    k = min(_NEIGHBOURS, len(wide) - 1)
    if k < 1:
        return np.full(len(wide), np.sqrt(_SMALLEST_SQUARE))
    distances, _ = KDTree(wide).query(wide, k=k + 1, workers=-1)
    squares = np.square(distances[:, 1:]).mean(axis=1)
    return np.asarray(np.sqrt(np.maximum(squares, _SMALLEST_SQUARE)))


def write_scene(
    scene: StaticScene,
    path: Path,
    *,
    name: str | None = None,
    capacity: int | None = None,
    color_space: Literal["srgb", "linear"] = "srgb",
    antialias: Literal["classic", "mip"] = "classic",
    opset: int = 18,
    accept: Callable[[Path], None] | None = None,
) -> GeneratorManifest:
    """Write ``scene`` as a generator, and return the manifest that it carries.

    Args:
        scene: The rows.
        path: Where the model goes.
        name: What people call it; the file's stem where absent.
        capacity: Rows of the outputs; the rows behind the scene are zero.
        color_space: Of the colours.
        antialias: How the scene was trained.
        opset: ONNX operator set.
        accept: Called with the finished draft; what it raises keeps the draft from its place.

    Raises:
        GsgenError: The capacity is less than the scene has rows.
    """
    count = len(scene.rows)
    total = count if capacity is None else capacity
    if total < count:
        hint = f"Give {count} or more, or leave it out."
        raise GsgenError(
            f"{total} is less than the {count} rows", where="--capacity", hint=hint
        )
    names = {"sh": "color_sh", "rgb": "color_rgb"}
    dtype: Dtype = "float16" if scene.rows.dtype == np.float16 else "float32"
    manifest = GeneratorManifest(
        name=name or path.stem,
        family="static",
        producer=Producer(f"gsgen {version('gsgen')}"),
        outputs=GeneratorOutputs(
            GaussiansOutput("gaussians", total, dtype),
            AppearanceOutput(names[scene.space], scene.space, scene.degree, color_space),
            CountOutput("num_points"),
        ),
        space=Space(),
        bounds=Bounds.around(scene.rows[:, layout.POSITION], _BOUNDS_MARGIN),
        antialias=antialias,
        tolerances=Tolerances(),
    )
    rows, color = _padded(scene.rows, total), _padded(scene.appearance, total)
    with atomic_write(path) as draft:
        write_constant(rows, color, manifest, draft, count=count, opset=opset)
        if accept is not None:
            accept(draft)
    return manifest


def _padded(rows: np.ndarray, total: int) -> np.ndarray:
    missing = np.zeros((total - len(rows), rows.shape[1]), rows.dtype)
    return np.concatenate([rows, missing]) if len(missing) else rows
