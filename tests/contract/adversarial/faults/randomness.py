"""Models that give something else in every run, or that were left in training mode."""

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

RANDOM: list[tuple[str, str, str, dict[str, object]]] = [
    ("random_normal_jitter", "Left the noise that densification adds.", "RandomNormal", {}),
    (
        "seeded_random_normal_jitter",
        "Seeded the noise and took it for a constant.",
        "RandomNormal",
        {"seed": 7.0},
    ),
    ("random_uniform_jitter", "Left stratified sampling switched on.", "RandomUniform", {}),
]
NONDETERMINISM = (
    r"random|determinis|run.to.run|training|\beval\b|noise|two runs|differ.{0,40}(run|time)",
)
AGREE = Sentence("manifest.md", "Two executions of the same model")


def _jittered(kind: str, options: dict[str, object]) -> Draft:
    source = scene("surface", seed=13)
    graph = GraphBuilder()
    noise = graph.op(kind, shape=[source.count, 3], **options)
    small = graph.op("Mul", noise, graph.constant(0.01))
    where = graph.op("Add", graph.constant(source.position), small)
    parts = rows(source)
    packed = packed_by_parts(
        graph, where, graph.constant(parts[:, 3:4]), graph.constant(parts[:, 4:])
    )
    low, high = source.position.min(0) - 0.1, source.position.max(0) + 0.1
    manifest = declare(source.count, low, high)
    return generator(graph, packed, graph.constant(sh_columns(source, 3)), manifest)


for name, mistake, kind, options in RANDOM:
    fault(
        name,
        FAMILY,
        mistake,
        *NONDETERMINISM,
        build=partial(_jittered, kind, options),
        sentence=AGREE,
    )


def _dropped(kind: str) -> Draft:
    """Harmonics behind a dropout that is still in training mode, or opacities that are drawn."""
    source = scene("surface", seed=13)
    graph = GraphBuilder()
    packed = rows(source)
    color = graph.constant(sh_columns(source, 3))
    opacity = graph.constant(packed[:, 3:4])
    if kind == "Dropout":
        color = graph.op("Dropout", color, graph.constant(0.3), graph.constant(True, "bool"))
    elif kind == "Dropout of opacity":
        dropout_output = graph.op(
            "Dropout", opacity, graph.constant(0.5), graph.constant(True, "bool")
        )
        opacity = graph.op("Mul", dropout_output, graph.constant(1.0))
    else:
        opacity = graph.op("Bernoulli", opacity)
    where, upper = graph.constant(packed[:, :3]), graph.constant(packed[:, 4:])
    manifest = declare(source.count, source.position.min(0), source.position.max(0))
    return generator(graph, packed_by_parts(graph, where, opacity, upper), color, manifest)


for kind in ("Dropout", "Dropout of opacity", "Bernoulli"):
    fault(
        f"training_mode_{kind.lower().replace(' ', '_')}",
        FAMILY,
        f"Exported without model.eval(): {kind} still drops things.",
        r"training|\beval\b|dropout|bernoulli",
        build=partial(_dropped, kind),
        sentence=AGREE,
    )


def _batch_normalised() -> Draft:
    source = scene("surface", seed=13)
    graph = GraphBuilder()
    time = graph.input("time", [1])
    features = graph.op("Mul", graph.constant(sh_columns(source, 1)), time)
    moments = [graph.constant(np.full(12, value)) for value in (1.0, 0.0, 0.0, 1.0)]
    graph.node(
        "BatchNormalization",
        [features, *moments],
        ["normal", "running_mean", "running_var"],
        training_mode=1,
    )
    color = graph.op("Mul", "normal", graph.constant(0.3))
    manifest = declare(
        source.count, source.position.min(0), source.position.max(0), degree=1, inputs=[TIME]
    )
    return generator(graph, graph.constant(rows(source)), color, manifest)


fault(
    "training_mode_batch_normalisation",
    FAMILY,
    "Exported without model.eval(): batch normalisation uses the statistics of the frame.",
    r"training|\beval\b|batch.?norm",
    build=_batch_normalised,
)
