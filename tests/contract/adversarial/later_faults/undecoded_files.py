"""Numbers of compressed splat files that were stored without decoding them."""

from collections.abc import Callable
from functools import partial

import numpy as np

from contract.adversarial.case import Draft, Sentence, fault
from contract.adversarial.drafts import static
from contract.adversarial.scenes import Array, Scene, rows, scene, sh_columns, upper_triangle

FAMILY = "undecoded files"
# Neighbours of hair lie on its strand only where strands are far apart.
N = {"hair": 64}

SIZES = (
    r"(small|tiny|thin|large|big|wide|overlap|size|spread|extent|standard deviation|scale|σ).{0,80}"
    r"(neighbou?r|spacing|apart|scene|bounds|diagonal)"
)
ORIENTATION = (
    r"(thin|flat|normal|orient|turned|rotation|quaternion).{0,80}"
    r"(surface|plane|neighbou?r|order|wxyz|xyzw|normal|strand)"
)
HARMONICS = r"harmonic|\bSH\b|coefficient|colou?r"

Edit = Callable[[Array, Array, Scene], None]


def _file(kind: str, edit: Edit) -> Draft:
    """A static model whose rows and harmonics of degree 3 were edited in place."""
    source = scene(kind, seed=31, n=N.get(kind, 400))
    packed, color = rows(source), sh_columns(source, 3)
    edit(packed, color, source)
    bounds = (packed[:, :3].min(0), packed[:, :3].max(0))
    return static(source, packed=packed, color=color, bounds=bounds)


def _fixed_point(packed: Array, color: Array, source: Scene) -> None:
    packed[:, :3] = np.round(packed[:, :3] * 4096)


def _sizes(change: Callable[[Array], Array]) -> Edit:
    def edit(packed: Array, color: Array, source: Scene) -> None:
        packed[:, 4:] = upper_triangle(change(source.scale), source.rotation)

    return edit


def _turns(change: Callable[[Array], Array]) -> Edit:
    def edit(packed: Array, color: Array, source: Scene) -> None:
        rotation = change(source.rotation)
        rotation = rotation / np.linalg.norm(rotation, axis=1, keepdims=True)
        packed[:, 4:] = upper_triangle(source.scale, rotation)

    return edit


def _largest_first(quaternions: Array) -> Array:
    """The three smallest of each, behind the largest, whichever that was."""
    order = np.argsort(-np.abs(quaternions), axis=1, kind="stable")
    order[:, 1:] = np.sort(order[:, 1:], axis=1)
    return np.take_along_axis(quaternions, order, axis=1)


def _opacity_divided_twice(packed: Array, color: Array, source: Scene) -> None:
    packed[:, 3] /= 255


def _buckets(packed: Array, color: Array, source: Scene) -> None:
    order = np.argsort(packed[:, 0])
    for bucket in np.array_split(order, 8):
        packed[bucket, :3] -= packed[bucket, :3].mean(0)


def _chunks(packed: Array, color: Array, source: Scene) -> None:
    low, high = packed[:, :3].min(0), packed[:, :3].max(0)
    packed[:, :3] = (packed[:, :3] - low) / (high - low)


def _logarithms(packed: Array, color: Array, source: Scene) -> None:
    packed[:, :3] *= 40
    packed[:, 4:] *= 1600
    packed[:, :3] = np.sign(packed[:, :3]) * np.log1p(np.abs(packed[:, :3]))


def _normals_counted(packed: Array, color: Array, source: Scene) -> None:
    """Fields are read from three columns before: zeros of the normals, then the DC."""
    color[:, 3:] = color[:, :-3].copy()
    color[:, :3] = 0


def _harmonic_bytes(packed: Array, color: Array, source: Scene) -> None:
    color[:, 3:] = np.clip(np.round(color[:, 3:] * 128 + 128), 0, 255)


def _big_endian(packed: Array, color: Array, source: Scene) -> None:
    with np.errstate(all="ignore"):
        packed[:] = packed.astype(">f4").view("<f4").reshape(packed.shape)
    packed[:, :3] = np.nan_to_num(packed[:, :3], posinf=0, neginf=0)


HEURISTIC: list[tuple[str, str, tuple[str, ...], Edit, tuple[str, ...]]] = [
    (
        "spz_positions",
        "Left positions as the 24-bit fixed-point numbers of an SPZ file.",
        ("surface", "room"),
        _fixed_point,
        (SIZES, r"positions are multiples|integers"),
    ),
    (
        "spz_scale_offset",
        "Divided the scale bytes of an SPZ file by 16 and forgot to subtract 10.",
        ("surface", "hair"),
        _sizes(lambda s: s * np.exp(10)),
        (SIZES, r"\bexp\b|log"),
    ),
    (
        "spz_scale_bytes",
        "Used the scale bytes of an SPZ file as scales.",
        ("cloud",),
        _sizes(lambda s: np.round(16 * (np.log(s) + 10))),
        (SIZES, r"\bexp\b|log"),
    ),
    (
        "splat_rotation_bytes",
        "Normalised the rotation bytes of a .splat file and forgot to subtract 128.",
        ("surface", "room", "hair"),
        _turns(lambda q: np.round(q * 128 + 128)),
        (ORIENTATION,),
    ),
    (
        "largest_component_first",
        "Put the largest component of a packed quaternion first, whichever it was.",
        ("surface", "hair"),
        _turns(_largest_first),
        (ORIENTATION,),
    ),
    (
        "opacity_divided_twice",
        "Divided the opacity by 255 in the reader and once more in the exporter.",
        ("surface", "cloud"),
        _opacity_divided_twice,
        (r"opacit|transparent|visible|255",),
    ),
    (
        "bucket_centres_left_out",
        "Left out the bucket centres of a ksplat file, so that buckets lie on each other.",
        ("room", "surface"),
        _buckets,
        (SIZES, ORIENTATION),
    ),
    (
        "chunk_bounds_left_out",
        "Left positions of a compressed PLY between 0 and 1, relative to their chunk.",
        ("room", "avatar"),
        _chunks,
        (SIZES, ORIENTATION),
    ),
    (
        "logarithmic_positions",
        "Left out the inverse of the logarithm that an SOG file applies to positions.",
        ("surface", "room"),
        _logarithms,
        (SIZES, ORIENTATION),
    ),
    (
        "codebook_indices_as_scales",
        "Used the indices into the codebook of an SOG file as scales.",
        ("hair",),
        _sizes(lambda s: np.round(255 * (s - s.min()) / np.ptp(s))),
        (SIZES,),
    ),
    (
        "normals_counted_as_colors",
        "Read the colours of a PLY three fields too early, where the normals are.",
        ("surface", "cloud"),
        _normals_counted,
        (HARMONICS,),
    ),
    (
        "harmonic_bytes",
        "Left the view-dependent coefficients of a compressed file as bytes.",
        ("room",),
        _harmonic_bytes,
        (HARMONICS,),
    ),
]
for name, mistake, kinds, edit, cause in HEURISTIC:
    for kind in kinds:
        fault(f"{name}_{kind}", FAMILY, mistake, *cause, build=partial(_file, kind, edit))
fault(
    "big_endian_ply",
    FAMILY,
    "Read a big-endian PLY as little-endian, so that every number is noise.",
    r"finite|\bnan\b|\binf|byte order|endian|garbage|\[0, 1\]|<= 1",
    build=partial(_file, "surface", _big_endian),
    sentence=Sentence("layout.md", "**opacity**: after its activation, in [0, 1]."),
)
