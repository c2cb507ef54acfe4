"""Colours that are not the ones the picture should have."""

from collections.abc import Callable
from functools import partial

import numpy as np

from contract.adversarial.case import Draft, Sentence, fault
from contract.adversarial.drafts import static
from contract.adversarial.scenes import C0, Array, Scene, scene

FAMILY = "appearance"

RGB_RANGE = Sentence("layout.md", "**`rgb`.** Red, green, blue in [0, 1], ready to be shown.")
CHANNEL_ORDER = (
    r"channel.?major|coefficient.?major|planar|ply|f_rest|order of the (coefficients|harmonics)|interleav",
)
DC = r"\bDC\b|f_dc|degree.?0|offset|0\.5|raw rgb|contrast|0\.282"


def _harmonics(kind: str, degree: int, order: Callable[[Array], Array]) -> Draft:
    """A static model whose coefficients [N, K, 3] became rows by ``order``."""
    source = scene(kind, seed=2)
    color = order(source.sh[:, : (degree + 1) ** 2])
    return static(source, color=color.reshape(source.count, -1), degree=degree)


def _colored(kind: str, space: str, recolor: Callable[[Scene], Array], degree: int = 0) -> Draft:
    source = scene(kind, seed=2)
    return static(source, color=recolor(source), space=space, degree=degree)


def _ply(sh: Array) -> Array:
    dc, sh_rest = sh[:, 0], sh[:, 1:].transpose(0, 2, 1).reshape(len(sh), -1)
    return np.concatenate([dc, sh_rest], axis=1)


def _planar(sh: Array) -> Array:
    return sh.transpose(0, 2, 1)


def _rest_first(sh: Array) -> Array:
    return np.concatenate([sh[:, 1:].reshape(len(sh), -1), sh[:, 0]], axis=1)


for degree in (1, 2, 3):
    for kind in ("surface", "room", "cloud") if degree == 3 else ("surface", "hair"):
        fault(
            f"harmonics_in_ply_order_degree_{degree}_{kind}",
            FAMILY,
            "Concatenated f_dc and f_rest of a 3DGS PLY, whose rest is channel-major.",
            *CHANNEL_ORDER,
            build=partial(_harmonics, kind, degree, _ply),
        )
for degree, kind in ((3, "surface"), (3, "avatar"), (1, "room")):
    fault(
        f"harmonics_channel_major_degree_{degree}_{kind}",
        FAMILY,
        "Exported [N, 3, K] flattened: all red coefficients first, DC included.",
        *CHANNEL_ORDER,
        build=partial(_harmonics, kind, degree, _planar),
    )
fault(
    "harmonics_rest_before_dc",
    FAMILY,
    "Concatenated f_rest and f_dc in this order.",
    r"\bDC\b|f_dc|first coefficient|degree.?0|" + CHANNEL_ORDER[0],
    build=partial(_harmonics, "surface", 3, _rest_first),
)

DECIDABLE = [
    ("rgb_bytes", "Left colours in 0…255.", lambda s: np.round(s.rgb * 255), r"255|byte|8.?bit"),
    (
        "rgb_signed",
        "Left colours in [−1, 1], as diffusion models have them.",
        lambda s: s.rgb * 2 - 1,
        r"[-−]1 ?(…|to|\.\.|,) ?1|signed|tanh|\(x \+ 1\)",
    ),
    (
        "rgb_is_dc",
        "Declared DC coefficients as RGB.",
        lambda s: s.sh[:, 0] * 1.3,
        r"\bDC\b|\bsh\b|harmonic|coefficient",
    ),
    (
        "rgb_unclamped",
        "Did not clamp the colours of the network, some of which exceed 1.",
        lambda s: s.rgb * 1.5,
        r"clamp|clip|above 1",
    ),
    (
        "rgb_logits",
        "Forgot the sigmoid behind the colour network.",
        lambda s: np.log((s.rgb + 0.01) / (1.01 - s.rgb)),
        r"sigmoid|activation|logit",
    ),
]
for name, mistake, recolor, *cause in DECIDABLE:
    fault(
        name,
        FAMILY,
        mistake,
        *cause,
        build=partial(_colored, "surface", "rgb", recolor),
        sentence=RGB_RANGE,
    )

HEURISTIC: list[tuple[str, str, Callable[[Scene], Array], str]] = [
    (
        "rgb_stored_as_dc",
        "Stored RGB as the DC coefficient, so that nothing is darker than grey.",
        lambda s: s.rgb,
        DC,
    ),
    (
        "dc_without_offset",
        "Divided RGB by C0 and did not subtract 0.5 before: the offset is there twice.",
        lambda s: s.rgb / C0,
        DC,
    ),
    (
        "dc_multiplied_by_c0",
        "Stored C0 · f_dc, which the viewer multiplies by C0 again: a grey picture.",
        lambda s: s.sh[:, 0] * C0,
        DC,
    ),
    (
        "dc_divided_twice",
        "Divided by C0 twice, so that most colours are clipped.",
        lambda s: s.sh[:, 0] / C0,
        DC + "|clip|saturat|clamp",
    ),
    (
        "dc_bytes",
        "Stored bytes 0…255 as the DC coefficient.",
        lambda s: np.round(s.rgb * 255),
        DC + "|255|byte|bright|large",
    ),
    (
        "colors_forgotten",
        "Forgot to load the colours, so that all coefficients are zero.",
        lambda s: 0 * s.sh[:, 0],
        r"(same|one|single|equal|no) colou?r|grey|gray|all.{0,20}zero|constant",
    ),
]
for name, mistake, recolor, cause_words in HEURISTIC:
    for kind in ("surface", "room"):
        fault(
            f"{name}_{kind}",
            FAMILY,
            mistake,
            cause_words,
            build=partial(_colored, kind, "sh", recolor),
        )


def _quantised(source: Scene) -> Array:
    sh = source.sh.copy()
    sh[:, 1:] = np.round(sh[:, 1:] * 128 + 128)
    return sh.reshape(source.count, -1)


def _nan_harmonic(source: Scene) -> Array:
    sh = source.sh.copy()
    sh[11, 9, 1] = np.nan
    return sh.reshape(source.count, -1)


def _shuffled(source: Scene) -> Array:
    order = np.argsort(-source.opacity)
    return source.sh[order].reshape(source.count, -1)


def _premultiplied(source: Scene) -> Array:
    return source.rgb * source.opacity[:, None] ** 2


fault(
    "quantised_harmonics_not_decoded",
    FAMILY,
    "Stored the 8-bit coefficients of an SPZ file without decoding them.",
    r"255|byte|8.?bit|quantis|quantiz|decod|magnitude|large|bright|(harmonic|coefficient|sh).{0,60}(range|large|than)",
    build=partial(_colored, "surface", "sh", _quantised, 3),
)
fault(
    "one_harmonic_is_nan",
    FAMILY,
    "Averaged an empty set of observations, which leaves NaN in one coefficient.",
    r"\bnan\b|finite",
    build=partial(_colored, "surface", "sh", _nan_harmonic, 3),
    sentence=Sentence(
        "roles.md", "A generator must give finite outputs when all its inputs are zero"
    ),
)
fault(
    "colors_sorted_by_opacity",
    FAMILY,
    "Sorted the colours by opacity and left the Gaussians as they were.",
    r"(colou?r|appearance|row).{0,80}(neighbou?r|order|row|noise|nois)",
    build=partial(_colored, "surface", "sh", _shuffled, 3),
)
fault(
    "rgb_premultiplied",
    FAMILY,
    "Stored colours that were multiplied by opacity.",
    r"multipl|opacity",
    build=partial(_colored, "surface", "rgb", _premultiplied),
)
