"""Numbers that their type cannot hold."""

from collections.abc import Callable
from functools import partial

import ml_dtypes
import numpy as np

from contract.adversarial.case import Draft, Sentence, fault
from contract.adversarial.drafts import declare, generator, static
from contract.adversarial.dynamic import packed_by_parts
from contract.adversarial.graph_builder import GraphBuilder
from contract.adversarial.scenes import Array, Scene, rows, scene, sh_columns

FAMILY = "precision"

STEPS = (
    r"precision|round|resol|step|ulp|far from (the )?origin|bfloat16|quantis|quantiz|grid|lattice",
)
HALF = Sentence("layout.md", "nor positions beyond 65504")
SEMI_DEFINITE = Sentence("layout.md", "Σ is symmetric and positive semi-definite.")


def _rounded(change: Callable[[Array, Scene], Array], kind: str, dtype: str = "float32") -> Draft:
    source = scene(kind, seed=40)
    packed = change(rows(source), source)
    with np.errstate(over="ignore"):
        stored = packed[:, :3].astype(dtype).astype(float)
    stored = np.where(np.isfinite(stored), stored, packed[:, :3])
    bounds = (stored.min(0), stored.max(0))
    with np.errstate(over="ignore"):
        return static(source, packed=packed, bounds=bounds, dtype=dtype)


def _moved(offset: float) -> Callable[[Array, Scene], Array]:
    def change(packed: Array, source: Scene) -> Array:
        packed[:, :3] += offset * np.array([1.0, 0.3, -0.6])
        return packed

    return change


def _scaled(factor: float) -> Callable[[Array, Scene], Array]:
    def change(packed: Array, source: Scene) -> Array:
        packed[:, :3] *= factor
        packed[:, 4:] *= factor**2
        return packed

    return change


def _bfloat16(packed: Array, source: Scene) -> Array:
    packed[:, :3] += 12.0
    packed[:, :3] = packed[:, :3].astype(ml_dtypes.bfloat16).astype(float)
    return packed


def _eight_bits(packed: Array, source: Scene) -> Array:
    low, span = packed[:, :3].min(), np.ptp(packed[:, :3])
    packed[:, :3] = np.round((packed[:, :3] - low) / span * 15) / 15 * span + low
    return packed


def _whole_units(packed: Array, source: Scene) -> Array:
    packed[:, :3] = np.trunc(packed[:, :3] * 2) / 2
    return packed


def _by_moments(packed: Array, source: Scene) -> Array:
    """Σ = E[x xᵀ] − E[x] E[x]ᵀ in float32, far from the origin."""
    random = np.random.default_rng(0)
    packed[:, :3] += 900.0
    for row in range(len(packed)):
        full = packed[row, 4:][[0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3)
        samples = random.multivariate_normal(packed[row, :3], full, 64).astype(np.float32)
        mean = samples.mean(0, dtype=np.float32)
        moment = (samples.T @ samples) / np.float32(64)
        packed[row, 4:] = (moment - np.outer(mean, mean)).reshape(-1)[[0, 1, 2, 4, 5, 8]]
    return packed


def _three_decimals(packed: Array, source: Scene) -> Array:
    packed[:, 4:] = np.round(packed[:, 4:], 3)
    return packed


CASES: list[
    tuple[str, str, Callable[[Array, Scene], Array], str, Sentence | None, tuple[str, ...]]
] = [
    (
        "utm_coordinates",
        "Left UTM coordinates in, where float32 has steps of half a metre.",
        _moved(5e6),
        "float32",
        None,
        STEPS,
    ),
    (
        "earth_centred_coordinates",
        "Left earth-centred coordinates in.",
        _moved(6.4e6),
        "float32",
        None,
        STEPS,
    ),
    (
        "half_far_from_the_origin",
        "Converted a scene a kilometre from the origin to float16.",
        _moved(1000.0),
        "float16",
        None,
        STEPS,
    ),
    (
        "half_in_millimetres",
        "Converted a scene in millimetres to float16.",
        _scaled(120000.0),
        "float16",
        HALF,
        (r"65504|float16|overflow",),
    ),
    (
        "half_of_a_tiny_scene",
        "Converted a scene of a few centimetres to float16, so variances vanish.",
        _scaled(0.005),
        "float16",
        None,
        (r"underflow|float16|zero|subnormal|vanish|small",),
    ),
    (
        "bfloat16_checkpoint",
        "Trained in bfloat16, so positions lie on a coarse grid.",
        _bfloat16,
        "float32",
        None,
        STEPS,
    ),
    (
        "four_bit_positions",
        "Quantised positions to 16 steps per axis.",
        _eight_bits,
        "float32",
        None,
        STEPS,
    ),
    (
        "positions_cast_to_integers",
        "An integer cast in the export left positions on a grid.",
        _whole_units,
        "float32",
        None,
        (*STEPS, r"same (place|position|centre)|duplicate|coincid|equal"),
    ),
    (
        "covariance_by_moments",
        "Computed Σ as E[x xᵀ] − E[x] E[x]ᵀ in float32 far from the origin.",
        _by_moments,
        "float32",
        SEMI_DEFINITE,
        (r"semi.?definite|psd|eigenvalue|cancel|negative",),
    ),
    (
        "covariance_with_three_decimals",
        "Wrote the covariances as text with three decimals.",
        _three_decimals,
        "float32",
        SEMI_DEFINITE,
        (r"semi.?definite|psd|eigenvalue|negative|round|decimal|zero",),
    ),
]
for name, mistake, change, dtype, sentence, cause in CASES:
    kinds = (
        ("surface", "room")
        if name in ("utm_coordinates", "half_far_from_the_origin", "bfloat16_checkpoint")
        else ("surface",)
    )
    for kind in kinds:
        fault(
            f"{name}_{kind}",
            FAMILY,
            mistake,
            *cause,
            build=partial(_rounded, change, kind, dtype),
            sentence=sentence,
        )


def _time_in_half() -> Draft:
    """The time, up to an hour in seconds, goes through float16: steps of two seconds."""
    source = scene("surface", seed=41)
    graph = GraphBuilder()
    seconds = graph.cast(graph.cast(graph.input("time", [1]), "float16"), "float32")
    swing = graph.op("Sin", graph.op("Mul", seconds, graph.constant(2 * np.pi)))
    share = np.tile([0, 0.1, 0], (source.count, 1))
    where = graph.op(
        "Add", graph.op("Mul", swing, graph.constant(share)), graph.constant(source.position)
    )
    parts = rows(source)
    packed = packed_by_parts(
        graph, where, graph.constant(parts[:, 3:4]), graph.constant(parts[:, 4:])
    )
    low, high = (
        source.position.min(0) - [0, 0.1, 0],
        source.position.max(0) + np.array([0, 0.1, 0]),
    )
    entry = {"name": "time", "role": "time", "range": [0, 3600], "default": 0.0}
    manifest = declare(64, low, high, inputs=[entry])
    return generator(graph, packed, graph.constant(sh_columns(source, 3)), manifest)


fault(
    "hour_of_seconds_in_half",
    FAMILY,
    "The time goes through float16, so an hour of seconds has steps of two seconds.",
    r"float16|precision|step|resol|round",
    build=_time_in_half,
)
