"""Records output rows of the torch module in an exported model's manifest, as test vectors.

After each edit of the file, a validator compares the model with the module that it came from,
without torch and without further files (rule GM037).
"""

__all__ = ["RowRecorder", "add_source_vectors"]

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from gsgen.contract.model.inspected_model import InspectedModel, inspect_model
from gsgen.contract.model.model_file import open_model, write_manifest_text
from gsgen.contract.probing.sandbox_worker import digest_outputs, subsample_rows, subsample_step
from gsgen.contract.probing.test_vectors import record_input, record_rows
from gsgen.contract.process.limits import Limits
from gsgen.contract.rules.behaviour.recorded_vectors import vector_faults
from gsgen.contract.spec.fields.json_schema import to_json
from gsgen.contract.spec.layout import CULL_OPACITY, OPACITY, VISIBILITY
from gsgen.contract.spec.manifest import TestVector, Tolerances
from gsgen.contract.spec.targets import load_target
from gsgen.contract.tools.recording import evenly_spaced
from gsgen.sdk.exporting.eager_reference import EagerRuns, packed_outputs

# Enough for changes that touch the whole scene; more would make the file larger than a graph needs.
_ROWS_PER_VECTOR = 2
# Inputs of more numbers, such as images, would make the manifest larger than it is worth.
_MAX_NUMBERS = 4096


class RowRecorder:
    """Samples output rows of the torch module, as test vectors for the ONNX model's manifest.

    Args:
        references: The compared test inputs.
        candidates: Indices of those that may be recorded.
        count: How many of them are.
    """

    def __init__(self, references: EagerRuns, candidates: Sequence[int], count: int) -> None:
        usable_probes = [
            index
            for index in candidates
            if not references.probes[index].zeros
            and sum(array.size for array in references.probes[index].inputs.values())
            <= _MAX_NUMBERS
        ]
        self.references = references
        self.indices = set(
            evenly_spaced(usable_probes, min(count, len(usable_probes))) if count else ()
        )
        self.outputs: dict[int, dict[str, np.ndarray]] = {}
        self.digests: dict[int, str] = {}

    def add_run(self, index: int, outputs: Mapping[str, np.ndarray]) -> None:
        """Record a sample of one run's output rows and a digest of all rows, for a test vector."""
        if index in self.indices:
            self.outputs[index] = {
                name: np.array(subsample_rows(array)) for name, array in outputs.items()
            }
            self.digests[index] = digest_outputs(dict(outputs))


def add_source_vectors(
    draft: Path, recorder: RowRecorder, tolerances: Tolerances | None
) -> tuple[TestVector, ...]:
    """Record output rows of the torch module in the manifest of an exported model.

    Test inputs at which the model agrees only after an allowance, such as for rows at a threshold,
    are left out: another machine would see them as a difference.

    Args:
        draft: The exported model, whose manifest is changed.
        recorder: Outputs of the model and of the module.
        tolerances: For the comparison with the module; the manifest's if None.

    Returns:
        The test vectors.
    """
    subject = inspect_model(open_model(draft), load_target("core"), Limits())
    vectors = tuple(
        vector
        for index in sorted(recorder.outputs)
        if (vector := _recorded_vector(subject, recorder, index, tolerances)) is not None
    )
    if vectors:
        document = json.loads(subject.file.manifest_text or "{}")
        updated_document = document | {"test_vectors": to_json(vectors)}
        write_manifest_text(draft, json.dumps(updated_document, ensure_ascii=False), draft)
    return vectors


def _recorded_vector(
    subject: InspectedModel, recorder: RowRecorder, index: int, tolerances: Tolerances | None
) -> TestVector | None:
    """Return a test vector; None if no row is visible or the ONNX model differs from torch."""
    manifest, reference = subject.generator, recorder.references[index]
    assert manifest is not None
    assert manifest.outputs.gaussians is not None
    source = packed_outputs(reference, manifest)
    capacity = manifest.outputs.gaussians.capacity
    rows = _drawn_rows(
        source[manifest.outputs.gaussians.name][: reference.count], OPACITY, capacity
    )
    if not rows:
        return None
    numbers = dict.fromkeys(source, rows)
    steps = dict.fromkeys(source, subsample_step(capacity))
    if manifest.outputs.count is not None:
        numbers[manifest.outputs.count.name], steps[manifest.outputs.count.name] = [0], 1
    if manifest.outputs.cells is not None:
        name = manifest.outputs.cells.name
        count = capacity // manifest.outputs.cells.per_cell
        numbers[name], steps[name] = (
            _drawn_rows(source[name], VISIBILITY, count),
            subsample_step(count),
        )
    outputs = tuple(
        record_rows(name, source[name], numbers[name]) for name in source if numbers[name]
    )
    probe = reference.probe
    vector = TestVector(
        inputs=probe.label,
        expected_sha256=recorder.digests[index],
        values=tuple(record_input(name, array) for name, array in probe.inputs.items()),
        outputs=outputs,
        tolerances=tolerances,
    )
    is_vector_different = any(vector_faults(subject, vector, recorder.outputs[index], steps))
    return None if is_vector_different else vector


def _drawn_rows(packed: np.ndarray, opacity: int, capacity: int) -> list[int]:
    """Return indices of a few finite, visible rows, chosen from the rows that validators sample."""
    step = subsample_step(capacity)
    sample = packed[::step]
    is_drawn = (sample[:, opacity] >= CULL_OPACITY) & np.isfinite(sample).all(axis=1)
    rows = [int(row) * step for row in np.flatnonzero(is_drawn)]
    return evenly_spaced(rows, min(_ROWS_PER_VECTOR, len(rows))) if rows else []
