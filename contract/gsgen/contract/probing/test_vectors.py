"""Test vectors: test inputs for which a manifest declares the digest of the outputs."""

__all__ = ["MOST_SEEDS", "probed_seeds", "vector_label", "vector_probes"]

from collections.abc import Iterator
from dataclasses import replace

from gsgen.contract.probing.probes import Probe, default_probes
from gsgen.contract.spec.manifest import Manifest

# Vectors of so many seeds, besides the one that is probed anyway, are run.
MOST_SEEDS = 4


def vector_label(label: str, seed: int) -> str:
    """Return the label of test inputs that are generated from a non-default seed."""
    return f"{label}, seed {seed}"


def probed_seeds(manifest: Manifest, seed: int) -> tuple[int, ...]:
    """Return the random seeds of declared test vectors that differ from the validation's seed."""
    seeds = dict.fromkeys(vector.seed for vector in manifest.test_vectors if vector.seed != seed)
    return tuple(seeds)[:MOST_SEEDS]


def vector_probes(
    manifest: Manifest,
    shapes: dict[str, tuple[int, ...]],
    dtypes: dict[str, str],
    seed: int,
    count: int,
) -> Iterator[tuple[str, tuple[Probe, ...]]]:
    """Yield the test inputs of test vectors that were recorded with another seed than ``seed``.

    Args:
        manifest: Holds the test vectors.
        shapes: Input name → static shape.
        dtypes: Input name → dtype in the graph.
        seed: Seed of the probes that are run in any case.
        count: How many probes a set has.
    """
    probes = []
    for vector_seed in probed_seeds(manifest, seed):
        labels = {vector.inputs for vector in manifest.test_vectors if vector.seed == vector_seed}
        for probe in default_probes(manifest, shapes, dtypes, vector_seed, count):
            if probe.label in labels:
                label = vector_label(probe.label, vector_seed)
                probes.append(replace(probe, label=label, extra=True))
    if probes:
        yield "vectors", tuple(probes)
