"""Rotations, scales and opacities that were computed by a wrong formula."""

from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from contract.adversarial.case import Draft, Sentence, fault
from contract.adversarial.drafts import static
from contract.adversarial.scenes import Array, Scene, rows, scene, sh_columns, upper_triangle

FAMILY = "activations"
# Neighbours of hair lie on its strand only where strands are far apart.
N = {"hair": 64}
UPPER = [0, 1, 2, 4, 5, 8]

ORIENTATION = (
    r"(thin|flat|normal|orient|turned|rotation|quaternion|align).{0,80}"
    r"(surface|plane|neighbou?r|order|wxyz|xyzw|normal|strand)"
)
SIZES = (
    r"(small|tiny|thin|large|big|wide|overlap|size|spread|extent|standard deviation|scale|σ).{0,80}"
    r"(neighbou?r|spacing|apart|scene|bounds|diagonal)"
)
SYMMETRY = (r"symmetr|semi-definite|covarian",)
OPAQUE = (r"opacit|transparent|visible",)

Edit = Callable[[Array, Scene], None]


def _edited(kind: str, edit: Edit) -> Draft:
    source = scene(kind, seed=32, n=N.get(kind, 400))
    packed = rows(source)
    edit(packed, source)
    return static(source, packed=packed)


def _quaternions(change: Callable[[Array], Array]) -> Edit:
    def edit(packed: Array, source: Scene) -> None:
        packed[:, 4:] = upper_triangle(source.scale, change(source.rotation))

    return edit


def _scales(change: Callable[[Array], Array]) -> Edit:
    def edit(packed: Array, source: Scene) -> None:
        packed[:, 4:] = upper_triangle(change(source.scale), source.rotation)

    return edit


def _opacities(change: Callable[[Array], Array]) -> Edit:
    def edit(packed: Array, source: Scene) -> None:
        packed[:, 3] = change(packed[:, 3])

    return edit


def _xyzw(quaternions: Array) -> Array:
    return quaternions[:, [1, 2, 3, 0]]


def _wxyz(rotation: Rotation) -> Array:
    return np.asarray(rotation.as_quat()[:, [3, 0, 1, 2]])


def _degrees_as_radians(quaternions: Array) -> Array:
    angles = Rotation.from_quat(_xyzw(quaternions)).as_euler("xyz", degrees=True)
    return _wxyz(Rotation.from_euler("xyz", angles))


def _reversed_euler(quaternions: Array) -> Array:
    angles = Rotation.from_quat(_xyzw(quaternions)).as_euler("XYZ")
    return _wxyz(Rotation.from_euler("xyz", angles))


def _half_angle(quaternions: Array) -> Array:
    vectors = Rotation.from_quat(_xyzw(quaternions)).as_rotvec()
    return _wxyz(Rotation.from_rotvec(vectors / 2))


def _first_for_all(quaternions: Array) -> Array:
    return np.broadcast_to(quaternions[5], quaternions.shape).copy()


def _one_side(packed: Array, source: Scene) -> None:
    """The upper triangle of R S², which is not symmetric."""
    turn = Rotation.from_quat(_xyzw(source.rotation)).as_matrix()
    packed[:, 4:] = (turn * source.scale[:, None] ** 2).reshape(-1, 9)[:, UPPER]


def _root_of_the_covariance(packed: Array, source: Scene) -> None:
    """The upper triangle of R S, the factor that 3DGS calls L."""
    turn = Rotation.from_quat(_xyzw(source.rotation)).as_matrix()
    packed[:, 4:] = (turn * source.scale[:, None]).reshape(-1, 9)[:, UPPER]


def _third_scale_of_a_disc(scale: Array) -> Array:
    return np.where(scale == scale.min(1, keepdims=True), 1.0, scale)


HEURISTIC: list[tuple[str, str, tuple[str, ...], Edit, tuple[str, ...]]] = [
    (
        "quaternion_axes_swapped",
        "Swapped y and z of the quaternions, for a viewer that is z-up.",
        ("surface", "room"),
        _quaternions(lambda q: q[:, [0, 1, 3, 2]]),
        (ORIENTATION,),
    ),
    (
        "quaternion_one_sign",
        "Negated one component of the quaternions, for a left-handed engine.",
        ("surface", "hair"),
        _quaternions(lambda q: q * [1, -1, 1, 1]),
        (ORIENTATION,),
    ),
    (
        "euler_degrees",
        "Took Euler angles in degrees for radians.",
        ("surface", "room"),
        _quaternions(_degrees_as_radians),
        (ORIENTATION,),
    ),
    (
        "euler_order_reversed",
        "Composed Euler angles in the reverse order.",
        ("surface", "hair"),
        _quaternions(_reversed_euler),
        (ORIENTATION,),
    ),
    (
        "half_of_the_angle",
        "Halved the angle of the rotation twice on the way to the quaternion.",
        ("surface", "room"),
        _quaternions(_half_angle),
        (ORIENTATION,),
    ),
    (
        "one_rotation_for_all",
        "Broadcast one quaternion over all Gaussians.",
        ("surface", "hair"),
        _quaternions(_first_for_all),
        (ORIENTATION,),
    ),
    (
        "scales_permuted",
        "Stored the scales as z x y.",
        ("surface", "room"),
        _scales(lambda s: s[:, [2, 0, 1]]),
        (ORIENTATION,),
    ),
    (
        "third_scale_of_a_disc",
        "Gave the discs of 2DGS a third scale of exp(0) = 1.",
        ("surface", "avatar"),
        _scales(_third_scale_of_a_disc),
        (SIZES, ORIENTATION),
    ),
    (
        "scales_to_the_power_of_ten",
        "Raised 10 to the natural logarithm of the scales.",
        ("surface", "room"),
        _scales(lambda s: 10 ** np.log(s)),
        (SIZES,),
    ),
    (
        "scale_modifier_left_in",
        "Left the scale modifier of the viewer at a hundredth.",
        ("surface", "cloud"),
        _scales(lambda s: s / 100),
        (SIZES,),
    ),
    (
        "opacity_is_transmittance",
        "Stored what light passes through, 1 minus opacity.",
        ("surface", "room"),
        _opacities(lambda o: 1 - np.minimum(o + 0.08, 1.0)),
        OPAQUE,
    ),
    (
        "clamped_logits",
        "Clamped the logits to [0, 1] so that the range rule is satisfied.",
        ("surface", "cloud"),
        _opacities(lambda o: np.clip(np.log(o / (1 - o)), 0, 1)),
        (r"clamp|clip|logit|sigmoid",),
    ),
]
for name, mistake, kinds, edit, cause in HEURISTIC:
    for kind in kinds:
        fault(f"{name}_{kind}", FAMILY, mistake, *cause, build=partial(_edited, kind, edit))
for name, mistake, edit in (
    ("covariance_is_one_sided", "Wrote the upper triangle of R S², without Rᵀ.", _one_side),
    ("covariance_is_its_factor", "Wrote the factor R S in place of Σ.", _root_of_the_covariance),
):
    fault(
        name,
        FAMILY,
        mistake,
        *SYMMETRY,
        build=partial(_edited, "surface", edit),
        sentence=Sentence("layout.md", "Σ is symmetric and positive semi-definite."),
    )


def _colored(kind: str, edit: Callable[[Array], Array]) -> Draft:
    source = scene(kind, seed=33, n=N.get(kind, 400))
    return static(source, color=edit(sh_columns(source, 3)))


def _interleaved(color: Array) -> Array:
    """Degree by degree, each channel-major."""
    parts = np.split(color.reshape(len(color), 16, 3), [1, 4, 9], axis=1)
    return np.concatenate([p.transpose(0, 2, 1).reshape(len(color), -1) for p in parts], axis=1)


def _blocked(color: Array) -> Array:
    """The rest as three blocks of 16 with a zero at the end of each."""
    sh_rest = color.reshape(len(color), 16, 3)[:, 1:].transpose(0, 2, 1)
    padded = np.pad(sh_rest, ((0, 0), (0, 0), (0, 1))).reshape(len(color), -1)
    return np.concatenate([color[:, :3], padded[:, :45]], axis=1)


COLORS: list[tuple[str, str, tuple[str, ...], Callable[[Array], Array], str]] = [
    (
        "harmonics_reversed",
        "Stored the coefficients from the highest to the lowest.",
        ("surface", "room"),
        lambda c: c.reshape(len(c), 16, 3)[:, ::-1].reshape(len(c), -1),
        r"order|coefficient|harmonic",
    ),
    (
        "harmonics_channel_major_by_degree",
        "Stored the coefficients of each degree channel by channel.",
        ("surface", "room"),
        _interleaved,
        r"order|coefficient|adjacent|channel|red",
    ),
    (
        "harmonics_in_padded_blocks",
        "Read the rest in blocks of 16 coefficients, where 15 were stored.",
        ("surface", "cloud"),
        _blocked,
        r"order|coefficient|adjacent|channel|red",
    ),
    (
        "harmonics_moved_by_one_column",
        "Started one column too late, so that red lies where green belongs.",
        ("surface",),
        lambda c: np.roll(c, 1, axis=1),
        r"order|coefficient|adjacent|channel|red",
    ),
    (
        "colors_of_the_next_row",
        "Dropped the first row of the colours and repeated the last one.",
        ("avatar",),
        lambda c: np.roll(c, -7, axis=0),
        r"row|order",
    ),
    (
        "harmonics_scaled_by_255",
        "Scaled all coefficients to bytes.",
        ("surface",),
        lambda c: c * 255,
        r"large|255|byte|converted|magnitude|beyond",
    ),
]
for name, mistake, kinds, change, words in COLORS:
    for kind in kinds:
        fault(f"{name}_{kind}", "appearance", mistake, words, build=partial(_colored, kind, change))
