"""Models that time, frames or a slider move wrongly, too little, or not at all."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from contract.adversarial.case import Draft, Sentence, fault
from contract.adversarial.drafts import declare, generator
from contract.adversarial.dynamic import packed_by_parts
from contract.adversarial.graph_builder import GraphBuilder
from contract.adversarial.scenes import rows, scene, sh_columns

FAMILY = "time and pose"

TIME: dict[str, Any] = {"name": "time", "role": "time", "range": [0, 1], "default": 0.0}
FRAME: dict[str, Any] = {"name": "frame", "role": "frame_index", "range": [0, 23], "default": 0}
AMPLITUDE = 0.15

NO_EFFECT = (
    r"(no|without|little|hardly any|below|nothing|not).{0,60}(effect|change|move|differ|visible|reach|depend)",
    r"(has|have) no effect|leads to no output|unused|ignored",
)
IDLE_TIME = (*NO_EFFECT, r"(time|frame|input).{0,80}(constant|frozen|same)")

Phase = Callable[[GraphBuilder, str], str]


def _moving(
    phase: Phase,
    entry: dict[str, Any],
    *,
    shape: tuple[int, ...] = (1,),
    dtype: str = "",
    amplitude: float = AMPLITUDE,
    declared: dict[str, Any] | None = None,
    kind: str = "surface",
    hidden: bool = False,
) -> Draft:
    """A scene that swings along y by the sine of a phase that a graph computes from its input.

    Args:
        phase: Adds the nodes from input to angle.
        entry: Of the manifest's inputs.
        shape: Of the graph's input.
        dtype: Of the graph's input; the role's where empty.
        amplitude: How far it swings.
        declared: Further fields of the manifest.
        kind: Of the scene.
        hidden: Whether only rows of opacity zero move.
    """
    source = scene(kind, seed=11)
    graph = GraphBuilder()
    dtype = dtype or ("int32" if entry["role"] == "frame_index" else "float32")
    angle = phase(graph, graph.input(entry["name"], shape, dtype))
    share = np.zeros((source.count, 3))
    share[:, 1] = amplitude * (1 - 0.5 * (np.arange(source.count) % 3))
    opacity = source.opacity[:, None].copy()
    if hidden:
        share[8:] = 0
        opacity[:8] = 0
    swing = graph.op("Mul", graph.op("Sin", angle), graph.constant(share))
    where = graph.op("Add", swing, graph.constant(source.position))
    upper = graph.constant(rows(source)[:, 4:])
    packed = packed_by_parts(graph, where, graph.constant(opacity), upper)
    reach_by = np.abs(share).max(0)
    manifest = declare(
        source.count,
        source.position.min(0) - reach_by,
        source.position.max(0) + reach_by,
        inputs=[entry],
        semantics="upper-bound" if hidden else "exact",
    )
    manifest.update(declared or {})
    return generator(graph, packed, graph.constant(sh_columns(source, 3)), manifest)


def _turns(factor: float) -> Phase:
    def phase(graph: GraphBuilder, value: str) -> str:
        return graph.op("Mul", value, graph.constant(factor))

    return phase


TAU = 2 * np.pi


def _only_at_start(graph: GraphBuilder, time: str) -> str:
    """The frame that a time in whole frames selects: floor(time) of [0, 1] is 0 until the end."""
    frame = graph.op("Floor", time)
    return graph.op("Mul", frame, graph.constant(TAU / 24))


def _unused(graph: GraphBuilder, time: str) -> str:
    graph.op("Mul", time, graph.constant(1.0))
    return graph.constant(0.3)


def _times_zero(graph: GraphBuilder, time: str) -> str:
    return graph.op("Mul", time, graph.constant(0.0))


def _quotient(graph: GraphBuilder, time: str) -> str:
    return graph.op("Div", graph.op("Sin", time), time)


def _exponential(graph: GraphBuilder, time: str) -> str:
    growth_factor = graph.op("Exp", graph.op("Mul", time, graph.constant(95.0)))
    return graph.op("Div", growth_factor, graph.op("Add", growth_factor, graph.constant(1.0)))


fault(
    "time_never_used",
    FAMILY,
    "Traced the model with the time as a Python number, so the input leads nowhere.",
    *IDLE_TIME,
    build=partial(_moving, _unused, TIME),
)
fault(
    "time_multiplied_by_zero",
    FAMILY,
    "Left a warm-up factor of zero before the deformation network.",
    *IDLE_TIME,
    build=partial(_moving, _times_zero, TIME),
)
fault(
    "time_moves_a_millionth",
    FAMILY,
    "Exported the deformation of an untrained network, far below what can be seen.",
    *IDLE_TIME,
    build=partial(_moving, _turns(TAU), TIME, amplitude=1e-6),
)
fault(
    "time_moves_hidden_rows_alone",
    FAMILY,
    "Deforms only Gaussians whose opacity is zero.",
    *IDLE_TIME,
    build=partial(_moving, _turns(TAU), TIME, hidden=True),
)
fault(
    "frames_fed_as_zero_to_one",
    FAMILY,
    "The model takes whole frames, and the manifest declares the range 0…1.",
    r"range",
    r"(only|just|single|few|last|end).{0,60}(change|move|frame|differ)",
    *IDLE_TIME,
    build=partial(_moving, _only_at_start, TIME),
)
fault(
    "time_in_degrees",
    FAMILY,
    "Fed degrees to a phase in radians, so the scene spins 57 times through its range.",
    r"degree|radian|fast|jump|alias|rapid|often|smooth",
    build=partial(_moving, _turns(360.0), TIME),
)
fault(
    "depends_on_time_denied",
    FAMILY,
    "Declares that nothing depends on time, a leftover of the static model.",
    r"depends_on|depend",
    build=partial(_moving, _turns(TAU), TIME, declared={"depends_on": {"time": False}}),
    sentence=Sentence(
        "manifest.md", "A key that maps to `false` promises that no output changes with that input"
    ),
)
fault(
    "loop_does_not_close",
    FAMILY,
    "Declares a loop, but the motion ends at its farthest point.",
    r"loop|start.{0,40}end|end.{0,40}start",
    build=partial(_moving, _turns(TAU / 4), {**TIME, "loop": True}),
    sentence=Sentence("manifest.md", "the end of the range is the same moment as its start."),
)
fault(
    "nan_at_time_zero",
    FAMILY,
    "Computes sin(t) / t, which is NaN at the start.",
    r"\bnan\b|finite|divi",
    build=partial(_moving, _quotient, TIME),
    sentence=Sentence(
        "roles.md", "A generator must give finite outputs when all its inputs are zero"
    ),
)
fault(
    "overflow_at_the_end_of_time",
    FAMILY,
    "An exponential overflows near the end of the range, and inf / inf is NaN.",
    r"\bnan\b|finite|overflow",
    build=partial(_moving, _exponential, TIME),
    sentence=Sentence("conventions.md", "A row whose values are not finite should be skipped."),
)
fault(
    "default_time_outside_range",
    FAMILY,
    "The default time lies behind the end of the range.",
    r"default",
    build=partial(_moving, _turns(TAU), {**TIME, "default": 4.0}),
    sentence=Sentence("manifest.md", "A runtime must not feed values outside of it."),
)
fault(
    "time_range_reversed",
    FAMILY,
    "Wrote the range of time as [high, low].",
    r"range",
    build=partial(_moving, _turns(TAU), {**TIME, "range": [1, 0]}),
    sentence=Sentence(
        "manifest.md", "`range` is [low, high] with low ≤ high, in numbers of the input's type"
    ),
)
fault(
    "time_is_a_scalar",
    FAMILY,
    "Exported the time as a tensor without axes.",
    r"shape|rank|axes|scalar|\[1\]",
    build=partial(_moving, _turns(TAU), TIME, shape=()),
    sentence=Sentence("roles.md", "| `time` | float32 | [1] |"),
)
fault(
    "time_has_a_batch_axis",
    FAMILY,
    "Exported the time as [1, 1], as the training loop feeds it.",
    r"shape|rank|axes|batch|\[1\]",
    build=partial(_moving, _turns(TAU), TIME, shape=(1, 1)),
    sentence=Sentence("roles.md", "| `time` | float32 | [1] |"),
)
fault(
    "time_per_gaussian",
    FAMILY,
    "Exported the time repeated for every Gaussian, [N, 1], as deformation networks take it.",
    r"shape|\[64, ?1\]|\[1\]",
    build=partial(_moving, _turns(TAU), TIME, shape=(64, 1)),
    sentence=Sentence("roles.md", "| `time` | float32 | [1] |"),
)


def _frame_phase(graph: GraphBuilder, frame: str) -> str:
    return graph.op("Mul", graph.cast(frame, "float32"), graph.constant(TAU / 24))


def _double_phase(graph: GraphBuilder, time: str) -> str:
    return graph.cast(graph.op("Mul", time, graph.constant(TAU, "float64")), "float32")


def _whole_seconds(graph: GraphBuilder, frame: str) -> str:
    second = graph.op("Div", frame, graph.constant(12, "int32"))
    return graph.op("Mul", graph.cast(second, "float32"), graph.constant(TAU / 5))


def _hole(graph: GraphBuilder, frame: str) -> str:
    table = np.linspace(0, 1, 24)
    table[13] = np.nan
    return graph.op("Gather", graph.constant(table), frame, axis=0)


def _short_table(graph: GraphBuilder, frame: str) -> str:
    return graph.op("Gather", graph.constant(np.linspace(0, 1, 24)), frame, axis=0)


fault(
    "frame_index_is_int64",
    FAMILY,
    "torch.long became int64 for the frame index.",
    r"int64|int32|dtype",
    build=partial(_moving, _frame_phase, FRAME, dtype="int64"),
    sentence=Sentence("roles.md", "| `frame_index` | int32 | [1] |"),
)
fault(
    "frame_index_is_float",
    FAMILY,
    "Declared the float time of the graph as a frame index.",
    r"float32|int32|dtype",
    build=partial(_moving, _frame_phase, FRAME, dtype="float32"),
    sentence=Sentence("roles.md", "| `frame_index` | int32 | [1] |"),
)
fault(
    "time_is_double",
    FAMILY,
    "numpy's float64 went into the graph as the time.",
    r"float64|double|float32|dtype",
    build=partial(_moving, _double_phase, TIME, dtype="float64"),
    sentence=Sentence("roles.md", "| `time` | float32 | [1] |"),
)
fault(
    "nan_in_one_frame",
    FAMILY,
    "One frame of the recording is missing and was stored as NaN.",
    r"\bnan\b|finite",
    build=partial(_moving, _hole, FRAME),
    sentence=Sentence("conventions.md", "A row whose values are not finite should be skipped."),
)
fault(
    "range_one_frame_too_long",
    FAMILY,
    "Declared the range [0, frames] in place of [0, frames − 1], so the last frame fails.",
    r"out of (range|bounds)|indices|gather|range|frame",
    build=partial(_moving, _short_table, {**FRAME, "range": [0, 24]}),
    sentence=Sentence("roles.md", "**frame_index**: a whole number within its range."),
)
fault(
    "frames_and_range_disagree",
    FAMILY,
    "Declares 24 frames and the range [0, 1] of the normalised time.",
    r"frames?\b.{0,60}range|range.{0,60}frames?|distinct",
    build=partial(_moving, _frame_phase, {**FRAME, "range": [0, 1], "frames": 24}),
    sentence=Sentence("manifest.md", "Time: how many distinct frames there are."),
)
fault(
    "frames_divided_as_integers",
    FAMILY,
    "Divided frame by rate in integers, so two of 24 frames differ.",
    r"distinct|frames?\b.{0,60}(equal|same|differ|change)|[^\d]2 (of|frames)",
    build=partial(_moving, _whole_seconds, {**FRAME, "frames": 24, "fps": 12}),
    sentence=Sentence("manifest.md", "Time: how many distinct frames there are."),
)
fault(
    "frame_rate_of_zero",
    FAMILY,
    "Left the frame rate at zero.",
    r"\bfps\b",
    build=partial(_moving, _frame_phase, {**FRAME, "frames": 24, "fps": 0}),
    sentence=Sentence("manifest.md", "in `frames / fps` seconds"),
)
fault(
    "frame_range_missing",
    FAMILY,
    "Declared no range of the frame index.",
    r"range",
    build=partial(_moving, _frame_phase, {"name": "frame", "role": "frame_index", "default": 0}),
    sentence=Sentence("manifest.md", "Roles marked *required* in"),
)
fault(
    "loop_on_a_slider",
    FAMILY,
    "Declared frames and a loop on a slider.",
    r"loop|frames|belong|time",
    build=partial(
        _moving,
        _turns(TAU),
        {
            "name": "wind",
            "role": "control",
            "shape": [1],
            "range": [0, 1],
            "default": 0.0,
            "loop": True,
            "frames": 24,
        },
    ),
    sentence=Sentence(
        "manifest.md", "`loop`, `frames` and `fps` belong to `time` and `frame_index`."
    ),
)
fault(
    "slider_without_effect",
    FAMILY,
    "Kept a slider in the interface that the exported branch does not use.",
    *NO_EFFECT,
    build=partial(
        _moving,
        _times_zero,
        {"name": "wind", "role": "control", "shape": [1], "range": [0, 1], "default": 0.0},
    ),
)
fault(
    "epoch_seconds_as_time",
    FAMILY,
    "Used seconds since 1970 as the time, whose float32 steps are 128 seconds.",
    r"float32|precision|step|resol|distinct|round",
    *IDLE_TIME,
    build=partial(_moving, _turns(TAU), {**TIME, "range": [1.7e9, 1.7e9 + 10], "default": 1.7e9}),
)
