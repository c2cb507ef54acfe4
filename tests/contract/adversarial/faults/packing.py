"""Rows whose columns are not where the layout has them."""

from collections.abc import Callable
from functools import partial

import numpy as np

from contract.adversarial.case import Draft, Sentence, fault
from contract.adversarial.drafts import static
from contract.adversarial.scenes import Array, Scene, rows, scene, sh_columns

FAMILY = "packing"

COVARIANCE_ORDER = Sentence(
    "layout.md", "**xx xy xz yy yz zz**: the upper triangle of the 3×3 covariance Σ, row by row"
)
SEMI_DEFINITE = Sentence("layout.md", "Σ is symmetric and positive semi-definite.")
OPACITY = Sentence("layout.md", "**opacity**: after its activation, in [0, 1].")
GAUSSIANS_SHAPE = Sentence("layout.md", "| `gaussians` | float32 or float16 | [N, 10] |")
APPEARANCE_SHAPE = Sentence("layout.md", "| `appearance` | float32 or float16 | [N, C] |")
CHANNELS = Sentence("layout.md", "C follows from `space` and `degree`.")
NO_BATCH = Sentence("layout.md", "There is no batch axis.")
INERT = Sentence("layout.md", "Rows **at and behind** the count are **inert**: opacity exactly 0")

ANOTHER_LAYOUT = (
    r"another layout|if read as|fields? (are )?(not )?in order|column order|reorder the columns"
)
SCALE_ROTATION = (
    r"scales?\b.{0,40}(quaternion|rotation)",
    r"quaternion.{0,40}scales?\b",
    ANOTHER_LAYOUT,
)


def _parts(source: Scene) -> dict[str, Array]:
    packed = rows(source)
    return {
        "position": packed[:, :3],
        "opacity": packed[:, 3:4],
        "covariance": packed[:, 4:],
        "scale": source.scale,
        "rotation": source.rotation,
        "rgb": source.rgb,
        "log_scale": np.log(source.scale),
        "logit": np.log(packed[:, 3:4] / (1 - packed[:, 3:4])),
    }


def _joined(kind: str, *columns: str) -> Draft:
    """A static model whose rows are these parts side by side."""
    source = scene(kind)
    parts = _parts(source)
    packed = np.concatenate([parts[name] for name in columns], axis=1)
    return static(source, packed=packed)


def _reordered(kind: str, order: list[int]) -> Draft:
    """A static model whose covariance columns are in another order."""
    source = scene(kind)
    packed = rows(source)
    packed[:, 4:] = packed[:, 4:][:, order]
    return static(source, packed=packed)


def _edited(kind: str, edit: Callable[[Array, Scene], Array], **options: object) -> Draft:
    """A static model whose packed rows went through ``edit``."""
    source = scene(kind)
    packed = edit(rows(source), source)
    if packed[0, 2] in source.position:  # still positions: where they are now
        bounds = (np.nanmin(packed[:, :3], 0), np.nanmax(packed[:, :3], 0))
    else:
        bounds = (source.position.min(0), source.position.max(0))
    return static(source, packed=packed, bounds=bounds, **options)  # type: ignore[arg-type]


LAYOUTS = [
    (
        "scale_quaternion_without_opacity",
        "Packed position, scale and quaternion, ten columns that look like a packed row.",
        ("position", "scale", "rotation"),
        SEMI_DEFINITE,
        SCALE_ROTATION,
    ),
    (
        "opacity_scale_quaternion_eleven",
        "Packed position, opacity, scale and quaternion, eleven columns.",
        ("position", "opacity", "scale", "rotation"),
        GAUSSIANS_SHAPE,
        SCALE_ROTATION,
    ),
    (
        "raw_ply_fourteen",
        "Concatenated the PLY's own fields: position, colour, logit, log scale, quaternion.",
        ("position", "rgb", "logit", "log_scale", "rotation"),
        GAUSSIANS_SHAPE,
        SCALE_ROTATION,
    ),
    (
        "log_scale_quaternion_ten",
        "Packed position, log scale and quaternion, as the optimiser holds them.",
        ("position", "log_scale", "rotation"),
        SEMI_DEFINITE,
        SCALE_ROTATION,
    ),
    (
        "quaternion_scale_ten",
        "Packed position, quaternion and scale.",
        ("position", "rotation", "scale"),
        OPACITY,
        SCALE_ROTATION,
    ),
    (
        "opacity_first",
        "Put opacity into the first column, before the position.",
        ("opacity", "position", "covariance"),
        OPACITY,
        (r"opacity (is |stands |lies )?(in the )?(first|column 0)", ANOTHER_LAYOUT),
    ),
    (
        "opacity_last",
        "Put opacity into the last column, behind the covariance.",
        ("position", "covariance", "opacity"),
        OPACITY,
        (r"opacity (is |stands |lies )?(in the )?(last|column 9)", ANOTHER_LAYOUT),
    ),
    (
        "covariance_before_position",
        "Packed covariance first, then position and opacity.",
        ("covariance", "position", "opacity"),
        OPACITY,
        (ANOTHER_LAYOUT,),
    ),
]
for name, mistake, columns, sentence, cause in LAYOUTS:
    for kind in ("surface", "hair") if name in ("opacity_last", "opacity_first") else ("room",):
        fault(
            f"{name}_{kind}",
            FAMILY,
            mistake,
            *cause,
            build=partial(_joined, kind, *columns),
            sentence=sentence,
        )

ORDERS = [
    ("diagonal_first", "Wrote the diagonal first: xx yy zz xy xz yz.", [0, 3, 5, 1, 2, 4]),
    ("voigt", "Wrote Voigt's order of mechanics: xx yy zz yz xz xy.", [0, 3, 5, 4, 2, 1]),
    (
        "lower_triangle",
        "Wrote the lower triangle row by row: xx xy yy xz yz zz.",
        [0, 1, 3, 2, 4, 5],
    ),
    (
        "reversed_triangle",
        "Wrote the triangle from its end: zz yz yy xz xy xx.",
        [5, 4, 3, 2, 1, 0],
    ),
]
for name, mistake, order in ORDERS:
    for kind in ("surface", "cloud"):
        fault(
            f"covariance_{name}_{kind}",
            FAMILY,
            mistake,
            r"diagonal.first|lower.triangle|voigt|upper.triangle.{0,40}order|triangle, row by row",
            ANOTHER_LAYOUT,
            build=partial(_reordered, kind, order),
            sentence=COVARIANCE_ORDER,
        )


def _transposed() -> Draft:
    source = scene("surface", n=40)
    return static(source, packed=rows(source).T)


def _batched() -> Draft:
    source = scene("surface")
    return static(source, packed=rows(source)[None], color=sh_columns(source, 3)[None])


def _flat() -> Draft:
    source = scene("hair")
    return static(source, packed=rows(source).reshape(-1))


def _reshaped(packed: Array, source: Scene) -> Array:
    return packed.T.reshape(packed.shape)


def _full_matrix() -> Draft:
    source = scene("cloud")
    packed = rows(source)
    full = packed[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]]
    return static(source, packed=np.concatenate([packed[:, :4], full], axis=1))


def _cholesky(packed: Array, source: Scene) -> Array:
    upper = packed[:, 4:]
    sigma = upper[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    factor = np.linalg.cholesky(sigma + 1e-12 * np.eye(3))
    packed[:, 4:] = factor[:, [0, 1, 1, 2, 2, 2], [0, 0, 1, 0, 1, 2]]
    return packed


def _inverse(packed: Array, source: Scene) -> Array:
    upper = packed[:, 4:]
    inverse = np.linalg.inv(upper[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3))
    packed[:, 4:] = inverse.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]]
    return packed


def _doubled_off_diagonal(packed: Array, source: Scene) -> Array:
    packed[:, [5, 6, 8]] *= 2
    return packed


def _swapped_position_axes(packed: Array, source: Scene) -> Array:
    packed[:, [1, 2]] = packed[:, [2, 1]]
    return packed


def _sorted_positions(packed: Array, source: Scene) -> Array:
    packed[:, :3] = packed[np.argsort(packed[:, 2]), :3]
    return packed


def _live_padding(packed: Array, source: Scene) -> Array:
    packed[40:, 3] = 1.0
    return packed


def _repeated_padding(packed: Array, source: Scene) -> Array:
    packed[40:] = packed[39]
    return packed


def _nan_padding(packed: Array, source: Scene) -> Array:
    packed[40:] = np.nan
    packed[40:, 3] = 0
    return packed


fault(
    "rows_transposed",
    FAMILY,
    "Exported channels first, [10, N], as image networks do.",
    r"transpos|channels first",
    build=_transposed,
    sentence=GAUSSIANS_SHAPE,
)
fault(
    "batch_axis",
    FAMILY,
    "Kept the batch axis of the training code, [1, N, 10].",
    r"batch|\[1, ?64, ?10\]|rank|axes",
    build=_batched,
    sentence=NO_BATCH,
)
fault(
    "rows_flattened",
    FAMILY,
    "Flattened the rows into one vector.",
    r"flat|one axis|reshape",
    build=_flat,
    sentence=GAUSSIANS_SHAPE,
)
for kind in ("surface", "avatar"):
    fault(
        f"planes_reshaped_to_rows_{kind}",
        FAMILY,
        "Had ten planes of N values and called reshape(N, 10) where a transpose was meant.",
        r"transpos|struct.{0,12}of.{0,3}arrays|planar|" + ANOTHER_LAYOUT,
        build=partial(_edited, kind, _reshaped),
        sentence=OPACITY,
    )
fault(
    "full_covariance_matrix",
    FAMILY,
    "Packed all nine numbers of Σ, thirteen columns.",
    r"\b13\b|nine|full (matrix|covariance)",
    build=_full_matrix,
    sentence=GAUSSIANS_SHAPE,
)
fault(
    "cholesky_factor",
    FAMILY,
    "Stored the Cholesky factor L in place of Σ = L Lᵀ.",
    r"cholesky|factor|" + ANOTHER_LAYOUT,
    build=partial(_edited, "surface", _cholesky),
    sentence=SEMI_DEFINITE,
)
fault(
    "inverse_covariance",
    FAMILY,
    "Stored the inverse covariance, the conic that the CUDA kernel keeps.",
    r"inverse|conic|precision|(large|big|wide|size|spread|extent).{0,60}(neighbou?r|spacing|scene|bounds)",
    build=partial(_edited, "cloud", _inverse),
)
fault(
    "engineering_off_diagonals",
    FAMILY,
    "Doubled the off-diagonal entries, as engineering strain does.",
    r"off.?diagonal|doubl|twice|semi.?definite|psd|eigenvalue",
    build=partial(_edited, "surface", _doubled_off_diagonal),
    sentence=SEMI_DEFINITE,
)
fault(
    "position_axes_swapped",
    FAMILY,
    "Swapped y and z of the positions and not of the covariances.",
    r"(ax[ei]s|covarianc|Σ|thin|flat|orient|normal).{0,80}(position|neighbou?r|surface|plane|centre)",
    build=partial(_edited, "surface", _swapped_position_axes),
)
fault(
    "positions_sorted_alone",
    FAMILY,
    "Sorted the positions and forgot to sort the other columns.",
    r"(ax[ei]s|covarianc|Σ|thin|flat|orient|normal|colou?r|appearance|row).{0,80}(position|neighbou?r|surface|plane|centre|order|row)",
    build=partial(_edited, "surface", _sorted_positions),
)
fault(
    "padding_is_opaque",
    FAMILY,
    "Padded to a multiple of the workgroup and left the opacities as they were.",
    r"padding|behind the count|beyond the count|inert|at and behind",
    build=partial(_edited, "surface", _live_padding, count=40),
    sentence=INERT,
)
fault(
    "padding_repeats_the_last_row",
    FAMILY,
    "Padded with mode=edge, so the last Gaussian repeats.",
    r"padding|behind the count|beyond the count|inert|at and behind",
    build=partial(_edited, "room", _repeated_padding, count=40),
    sentence=INERT,
)
fault(
    "padding_is_nan",
    FAMILY,
    "Padded with NaN, as pandas does.",
    r"padding|behind the count|beyond the count|inert|at and behind",
    build=partial(_edited, "room", _nan_padding, count=40),
    sentence=INERT,
)


def _sh(shape: tuple[int, ...], degree: int = 3, drop: int = 0) -> Draft:
    source = scene("surface")
    color = source.sh[:, drop:].reshape(shape)
    return static(source, color=color, degree=degree)


fault(
    "harmonics_rank_three",
    FAMILY,
    "Exported the coefficients as [N, 16, 3], as the renderer of the training code takes them.",
    r"rank|two axes|reshape|flatten",
    build=partial(_sh, (64, 16, 3)),
    sentence=APPEARANCE_SHAPE,
)
fault(
    "harmonics_without_dc",
    FAMILY,
    "Exported f_rest alone and forgot f_dc: 45 channels.",
    r"\bDC\b|f_dc|f_rest|constant term|degree.?0",
    build=partial(_sh, (64, 45), 3, 1),
    sentence=CHANNELS,
)


def _half_rgb_three() -> Draft:
    source = scene("surface")
    return static(source, color=source.rgb, space="rgb", dtype="float16")


def _half_degree(degree: int) -> Draft:
    source = scene("surface")
    return static(source, degree=degree, dtype="float16")


WORDS = Sentence("layout.md", "A row of every output is a whole number of 4-byte words")
fault(
    "half_rgb_of_three_channels",
    FAMILY,
    "Converted RGB to float16 without a fourth channel.",
    r"word|4.?byte|four bytes|fourth|multiple of",
    build=_half_rgb_three,
    sentence=WORDS,
)
fault(
    "half_harmonics_of_degree_0",
    FAMILY,
    "Converted degree 0 to float16, six bytes a row.",
    r"word|4.?byte|four bytes|fill|multiple of",
    build=partial(_half_degree, 0),
    sentence=WORDS,
)
fault(
    "half_harmonics_of_degree_2",
    FAMILY,
    "Converted degree 2 to float16, 54 bytes a row.",
    r"word|4.?byte|four bytes|fill|multiple of",
    build=partial(_half_degree, 2),
    sentence=WORDS,
)
