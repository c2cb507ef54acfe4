"""Test vectors: test inputs for which a manifest declares the digest of the outputs."""

__all__ = [
    "MAX_RECORDED_VECTORS",
    "MAX_VECTOR_SEEDS",
    "probed_seeds",
    "record_input",
    "record_rows",
    "recorded_inputs",
    "recorded_label",
    "vector_label",
    "vector_probes",
]

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from gsgen.contract.probing.probes import Probe, default_probes
from gsgen.contract.spec.manifest import Manifest, TestVector, VectorInput, VectorRows

# Vectors of so many seeds, besides the one that is probed anyway, are run.
MAX_VECTOR_SEEDS = 4
# Vectors with rows of the source's outputs, which bring their own inputs, are run up to so many.
MAX_RECORDED_VECTORS = 4


def vector_label(label: str, seed: int) -> str:
    """Return the label of test inputs that are generated from a non-default seed."""
    return f"{label}, seed {seed}"


def probed_seeds(manifest: Manifest, seed: int) -> tuple[int, ...]:
    """Return the random seeds of declared test vectors that differ from the validation's seed."""
    seeds = dict.fromkeys(
        vector.seed
        for vector in manifest.test_vectors
        if vector.seed != seed and not vector.outputs
    )
    return tuple(seeds)[:MAX_VECTOR_SEEDS]


def record_input(name: str, array: np.ndarray) -> VectorInput:
    """Return the values of one model input as a record for a test vector in a manifest."""
    return VectorInput(name, array.shape, _shortest_decimals(array.reshape(-1)))


def record_rows(name: str, array: np.ndarray, rows: Sequence[int]) -> VectorRows:
    """Return chosen rows of a model output as a record for a test vector in a manifest."""
    values = array[list(rows)].reshape(len(rows), -1)
    return VectorRows(name, tuple(rows), tuple(_shortest_decimals(row) for row in values))


def _shortest_decimals(values: np.ndarray) -> tuple[float, ...]:
    """Return numbers in the shortest decimal form that float32 reads back unchanged."""
    return tuple(float(str(value)) for value in values.astype(np.float32))


def recorded_label(vector: TestVector, index: int) -> str:
    """Return the label of test inputs that a manifest's test vector itself contains."""
    return f"{vector.inputs} of test vector {index}"


def recorded_inputs(
    vector: TestVector, shapes: Mapping[str, tuple[int, ...]], dtypes: Mapping[str, str]
) -> dict[str, np.ndarray] | None:
    """Return the test inputs that a test vector contains; None if they do not fit the model.

    Args:
        vector: Holds the numbers of each input.
        shapes: Input name → the shape to feed.
        dtypes: Input name → dtype in the graph.
    """
    names = [entry.input for entry in vector.values]
    if sorted(names) != sorted(shapes):
        return None
    for entry in vector.values:
        if entry.shape != shapes[entry.input] or math.prod(entry.shape) != len(entry.values):
            return None
    return {
        entry.input: np.array(entry.values, dtypes[entry.input]).reshape(entry.shape)
        for entry in vector.values
    }


def _recorded_probes(
    manifest: Manifest, shapes: Mapping[str, tuple[int, ...]], dtypes: Mapping[str, str]
) -> Iterator[Probe]:
    recorded = [pair for pair in enumerate(manifest.test_vectors) if pair[1].outputs]
    for index, vector in recorded[:MAX_RECORDED_VECTORS]:
        inputs = recorded_inputs(vector, shapes, dtypes)
        if inputs is not None:
            yield Probe(label=recorded_label(vector, index), inputs=inputs, extra=True)


def vector_probes(
    manifest: Manifest,
    shapes: dict[str, tuple[int, ...]],
    dtypes: dict[str, str],
    seed: int,
    count: int,
) -> Iterator[tuple[str, tuple[Probe, ...]]]:
    """Yield the test inputs of a manifest's test vectors, as stored or generated from seeds.

    Args:
        manifest: Holds the test vectors.
        shapes: Input name → static shape.
        dtypes: Input name → dtype in the graph.
        seed: Seed of the probes that are run in any case.
        count: How many probes a set has.
    """
    probes = list(_recorded_probes(manifest, shapes, dtypes))
    for vector_seed in probed_seeds(manifest, seed):
        labels = {
            vector.inputs
            for vector in manifest.test_vectors
            if vector.seed == vector_seed and not vector.outputs
        }
        for probe in default_probes(manifest, shapes, dtypes, vector_seed, count):
            if probe.label in labels:
                label = vector_label(probe.label, vector_seed)
                probes.append(replace(probe, label=label, extra=True))
    if probes:
        yield "vectors", tuple(probes)
