"""Opacities, scales and rotations before their activation, or after it twice."""

from collections.abc import Callable
from functools import partial

import numpy as np

from contract.adversarial.case import Draft, Sentence, fault
from contract.adversarial.drafts import static
from contract.adversarial.scenes import Array, Scene, rows, scene, upper_triangle

FAMILY = "activations"

OPACITY = Sentence("layout.md", "**opacity**: after its activation, in [0, 1].")
SEMI_DEFINITE = Sentence("layout.md", "Σ is symmetric and positive semi-definite.")

TOO_LARGE = (
    r"(large|big|wide|overlap|exceed|size|spread|extent|standard deviation|scale|σ).{0,80}"
    r"(neighbou?r|spacing|apart|scene|bounds|diagonal)"
)
TOO_SMALL = (
    r"(small|tiny|thin|gap|hole|size|spread|extent|standard deviation|scale|σ).{0,80}"
    r"(neighbou?r|spacing|apart|scene|bounds|diagonal)"
)
ORIENTATION = (
    r"(thin|flat|normal|orient|turned|rotation|quaternion).{0,80}"
    r"(surface|plane|neighbou?r|order|wxyz|xyzw|normal)"
)


def _sigmoid(values: Array) -> Array:
    return 1 / (1 + np.exp(-values))


def _logit(values: Array) -> Array:
    return np.log(values / (1 - values))


def _build(kind: str, edit: Callable[[Array, Scene], None], statistics: str = "trained") -> Draft:
    """A static model whose rows were edited in place."""
    source = scene(kind, statistics, seed=1)
    packed = rows(source)
    edit(packed, source)
    return static(source, packed=packed)


def _opacity(change: Callable[[Array], Array], packed: Array, source: Scene) -> None:
    packed[:, 3] = change(packed[:, 3])


def _scale(change: Callable[[Array], Array], packed: Array, source: Scene) -> None:
    packed[:, 4:] = upper_triangle(change(source.scale), source.rotation)


def _rotation(change: Callable[[Array], Array], packed: Array, source: Scene) -> None:
    packed[:, 4:] = upper_triangle(source.scale, change(source.rotation))


def _diagonal(change: Callable[[Array], Array], packed: Array, source: Scene) -> None:
    packed[:, 4:] = 0
    packed[:, [4, 7, 9]] = change(source.scale)


def _one_nan(column: int, packed: Array, source: Scene) -> None:
    packed[7, column] = np.nan


def _infinite(packed: Array, source: Scene) -> None:
    packed[3, 4] = np.inf


def _unnormalised(packed: Array, source: Scene) -> None:
    """R from a quaternion of length three by the formula for unit ones."""
    w, x, y, z = (3.0 * source.rotation).T
    turn = np.stack(
        [
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ],
        axis=1,
    ).reshape(-1, 3, 3)
    sigma = np.einsum("nij,nj,nkj->nik", turn, source.scale**2, turn).reshape(-1, 9)
    packed[:, 4:] = sigma[:, [0, 1, 2, 4, 5, 8]]


def _unsquared(packed: Array, source: Scene) -> None:
    _scale(np.sqrt, packed, source)


DECIDABLE_OPACITIES = [
    (
        "logit",
        "Exported the optimiser's opacities, before the sigmoid.",
        _logit,
        r"sigmoid|logit|activation",
    ),
    (
        "bytes",
        "Left opacity in 0…255, as splat files have it.",
        lambda o: np.round(o * 255),
        r"255|byte|8.?bit",
    ),
    (
        "percent",
        "Left opacity in percent.",
        lambda o: np.round(o * 100),
        r"percent|0 ?(…|to|\.\.) ?100|divide",
    ),
    (
        "tanh",
        "Used tanh in place of the sigmoid, so that opacity lies in [−1, 1].",
        lambda o: np.tanh(_logit(o)),
        r"tanh|\[?[-−]1|negative",
    ),
    (
        "unclamped",
        "Let opacity grow above 1 without a clamp.",
        lambda o: o * 1.4,
        r"clamp|clip|above 1",
    ),
    (
        "density",
        "Exported a volume density in place of an opacity.",
        lambda o: 20 * o / (1.001 - o),
        r"densit|activation",
    ),
]
for name, mistake, change, *cause in DECIDABLE_OPACITIES:
    fault(
        f"opacity_{name}",
        FAMILY,
        mistake,
        *cause,
        build=partial(_build, "surface", partial(_opacity, change)),
        sentence=OPACITY,
    )
fault(
    "opacity_logit_hair_half",
    FAMILY,
    "Exported logits of hair that happens to be mostly transparent.",
    r"sigmoid|logit|activation",
    build=partial(_build, "hair", partial(_opacity, lambda o: _logit(o) - 1.0)),
    sentence=OPACITY,
)

for kind in ("surface", "cloud", "hair"):
    fault(
        f"opacity_sigmoid_twice_{kind}",
        FAMILY,
        "Applied the sigmoid twice, once in the model and once at export.",
        r"sigmoid|twice|\.731|0\.5 ?(…|to|\.\.|and) ?0?\.73",
        build=partial(_build, kind, partial(_opacity, _sigmoid)),
    )

for kind in ("surface", "hair", "room"):
    fault(
        f"scale_exp_missing_{kind}",
        FAMILY,
        "Squared the log scales: exp is missing.",
        r"\bexp\b|log",
        TOO_LARGE,
        build=partial(_build, kind, partial(_scale, np.log)),
    )
    fault(
        f"scale_exp_twice_{kind}",
        FAMILY,
        "Applied exp twice, so that every Gaussian is about one unit large.",
        r"\bexp\b",
        TOO_LARGE,
        build=partial(_build, kind, partial(_scale, np.exp)),
    )
for kind in ("surface", "hair"):
    fault(
        f"scale_not_squared_{kind}",
        FAMILY,
        "Built Σ as R S Rᵀ: standard deviations stand where variances belong.",
        r"squar|variance|standard deviation",
        TOO_LARGE,
        build=partial(_build, kind, _unsquared),
    )
for kind in ("surface", "cloud"):
    fault(
        f"scale_squared_twice_{kind}",
        FAMILY,
        "Squared scales that were variances already.",
        r"squar|variance",
        TOO_SMALL,
        build=partial(_build, kind, partial(_scale, np.square)),
    )
    fault(
        f"standard_deviations_on_the_diagonal_{kind}",
        FAMILY,
        "Wrote the standard deviations on the diagonal and left out the rotation.",
        r"off.?diagonal|rotation|axis.?aligned|squar|variance",
        TOO_LARGE,
        build=partial(_build, kind, partial(_diagonal, lambda s: s)),
    )
for kind in ("surface", "room", "hair"):
    fault(
        f"rotation_left_out_{kind}",
        FAMILY,
        "Wrote the squared scales on the diagonal and left out the rotation.",
        r"off.?diagonal|rotation|axis.?aligned",
        ORIENTATION,
        build=partial(_build, kind, partial(_diagonal, np.square)),
    )
fault(
    "log_scales_on_the_diagonal",
    FAMILY,
    "Wrote log scales on the diagonal, so variances are negative.",
    r"\blog|\bexp\b",
    build=partial(_build, "surface", partial(_diagonal, np.log)),
    sentence=SEMI_DEFINITE,
)

TURNS: list[tuple[str, str, Callable[[Array], Array], str]] = [
    (
        "quaternion_xyzw",
        "Read scipy's quaternions (x, y, z, w) as (w, x, y, z).",
        lambda q: q[:, [1, 2, 3, 0]],
        r"quaternion|xyzw|wxyz",
    ),
    (
        "rotation_transposed",
        "Used the transposed rotation matrix, Σ = Rᵀ S Sᵀ R.",
        lambda q: q * [1, -1, -1, -1],
        r"transpos|conjugate|quaternion",
    ),
    (
        "rotations_shuffled",
        "Sorted scales and positions and left the quaternions as they were.",
        lambda q: np.roll(q, 7, axis=0),
        r"quaternion|row",
    ),
]
for name, mistake, change, cause_words in TURNS:
    for kind in ("surface", "room", "avatar") if name == "quaternion_xyzw" else ("surface", "room"):
        fault(
            f"{name}_{kind}",
            FAMILY,
            mistake,
            cause_words,
            ORIENTATION,
            build=partial(_build, kind, partial(_rotation, change)),
        )
fault(
    "quaternion_not_normalised",
    FAMILY,
    "Built R from raw quaternions without normalising them.",
    r"normalis|normaliz|unit quaternion",
    TOO_LARGE,
    build=partial(_build, "surface", _unnormalised),
)
fault(
    "one_covariance_is_nan",
    FAMILY,
    "Took the logarithm of a scale of zero, which leaves NaN in one row.",
    r"\bnan\b|finite",
    build=partial(_build, "surface", partial(_one_nan, 5)),
    sentence=SEMI_DEFINITE,
)
fault(
    "one_opacity_is_nan",
    FAMILY,
    "Divided zero by zero in the opacity network.",
    r"\bnan\b|finite",
    build=partial(_build, "cloud", partial(_one_nan, 3)),
    sentence=OPACITY,
)
fault(
    "one_variance_is_infinite",
    FAMILY,
    "Let exp overflow for a Gaussian that training had given up.",
    r"\binf|finite|overflow",
    build=partial(_build, "surface", _infinite),
    sentence=Sentence(
        "roles.md", "A generator must give finite outputs when all its inputs are zero"
    ),
)
