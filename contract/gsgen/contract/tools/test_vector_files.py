"""Records test vectors of a model: inputs and outputs as files, digests in the manifest.

The layout is that of the ONNX model zoo: a folder with ``model.onnx`` and, for each vector,
``test_data_set_0/input_0.pb …, output_0.pb …``, TensorProto messages in the order of the graph's
inputs and outputs.
"""

__all__ = ["RecordedVectors", "record_vectors"]

import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

import numpy as np
from onnx import numpy_helper

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.probe_plan import fetched_outputs, make_plan
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.sandbox import Execution
from gsgen.contract.probing.sandbox_worker import digest_outputs
from gsgen.contract.process.drafts import temporary_folder
from gsgen.contract.spec.fields.json_schema import to_json
from gsgen.contract.spec.manifest import TestVector, VectorFile
from gsgen.contract.spec.severity import Level
from gsgen.contract.tools.recording import (
    RecordingRefused,
    current_document,
    evenly_spaced,
    inspect_recordable,
    refuse_existing,
    run_at_probes,
    write_recorded_copy,
)
from gsgen.contract.validation.settings import Settings

MODEL_FILE_NAME = "model.onnx"
_VECTOR_COUNT = 3
_DATA_SET_FOLDER_PATTERN = re.compile(r"^test_data_set_[0-9]+$")


@dataclass(frozen=True, slots=True)
class _RecordOptions:
    """The settings of a recording of test vectors: random seed, model copy, and output folder."""

    seed: int
    model: Path
    folder: Path

    def location(self, name: str) -> str | None:
        """Return the path of a test vector's file relative to the model, as the manifest holds it.

        None if the folder is neither the model's nor below it: the manifest cannot name it.
        """
        root, path = self.model.resolve().parent, self.folder.resolve() / name
        return path.relative_to(root).as_posix() if path.is_relative_to(root) else None


@dataclass(frozen=True, slots=True)
class RecordedVectors:
    """The files and manifest entries of recorded test vectors.

    Attributes:
        model: The copy whose manifest has the digests.
        folder: The parent folder of inputs and outputs.
        vectors: The vectors in the manifest, in the order of the folders.
    """

    model: Path
    folder: Path
    vectors: tuple[TestVector, ...]


def record_vectors(
    source: Path,
    folder: Path,
    model: Path | None = None,
    *,
    count: int | None = None,
    seed: int = 0,
    settings: Settings | None = None,
    force: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> RecordedVectors:
    """Run a model with ``count`` sets of test inputs; write inputs, outputs and digests.

    Test vectors with rows of the model's source stay; those with digests alone are replaced.

    Args:
        source: A model with a manifest; it is not changed, unless ``model`` is the same file.
        folder: The parent of the folders ``test_data_set_k``, one per vector.
        model: The copy with the digests; by default ``folder/model.onnx``.
        count: Number of probes, evenly spread over those of a validation, all zeros first;
            by default three, or all if there are fewer.
        seed: Seed of the probe set.
        settings: Limits for running the model.
        force: Replace existing vectors in ``folder``.
        progress: Called with a short text at the start of each stage.

    Raises:
        ModelUnreadable: ``source`` is not an ONNX model.
        RecordingRefused: The model has no manifest, breaks a static rule, fails, or gives other
            outputs in a second run.
        ConfigInvalid: ``count`` exceeds the number of probes, or the folder holds vectors or
            cannot be written.
    """
    settings = settings or Settings()
    model = model or folder / MODEL_FILE_NAME
    existing_vector_files = [
        path for path in _list_folder(folder) if _DATA_SET_FOLDER_PATTERN.match(path.name)
    ]
    if not force:
        refuse_existing(existing_vector_files, folder, "folder")
    progress(f"reading {source.name}")
    subject = _model_without_vectors(source, settings)
    probes = _selected_probes(make_plan(subject, Level.VALUES, seed).probes, count)
    progress(f"running {len(probes)} probes twice in ONNX Runtime")
    with _staging_folder(folder) as stage:
        names = [tensor.name for tensor in subject.graph.outputs]
        record = _RecordOptions(seed, model, folder)
        repeated_probes = [probe for probe in probes for _ in range(2)]
        with run_at_probes(subject, names, repeated_probes) as execution:
            vectors = tuple(
                _write(stage / f"test_data_set_{index}", subject, probe, outputs, record)
                for index, (probe, outputs) in enumerate(_outputs(source, probes, execution))
            )
        progress(f"writing {model.name}")
        declared = subject.manifest.test_vectors if subject.manifest else ()
        source_rows = [vector for vector in declared if vector.outputs]
        changed_document = current_document(subject) | {
            "test_vectors": to_json([*source_rows, *vectors])
        }
        with write_recorded_copy(subject.file, changed_document, model):
            pass
        for path in existing_vector_files:
            _remove_path(path)
        for staged_path in sorted(stage.iterdir()):
            staged_path.replace(folder / staged_path.name)
    return RecordedVectors(model, folder, vectors)


def _list_folder(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []


def _remove_path(path: Path) -> None:
    if path.is_symlink() or not path.is_dir():
        path.unlink()  # the target of a link belongs to the user
    else:
        shutil.rmtree(path)


def _model_without_vectors(source: Path, settings: Settings) -> InspectedModel:
    subject = inspect_recordable(source, settings)
    # Without a manifest, every output that NumPy can hold is fetched.
    fetched_names = fetched_outputs(replace(subject, parsed=None, candidate=None))
    unreadable_names = [
        tensor.name for tensor in subject.graph.outputs if tensor.name not in fetched_names
    ]
    if unreadable_names:
        message = f"output {unreadable_names[0]!r} has a dtype that NumPy cannot hold"
        raise RecordingRefused(message, where=str(source))
    return subject


def _selected_probes(probes: tuple[Probe, ...], count: int | None) -> list[Probe]:
    if count is None:
        count = min(_VECTOR_COUNT, len(probes))
    if count > len(probes):
        probe_count_text = "1 probe" if len(probes) == 1 else f"{len(probes)} probes"
        message = f"{count} test vectors, but the model has only {probe_count_text}"
        raise ConfigInvalid(message, where="--count", hint=f"--count {len(probes)} takes all.")
    if count < 1:
        raise ConfigInvalid(
            f"the number of test vectors is {count}, expected 1 or more", where="--count"
        )
    return evenly_spaced(probes, count)


@contextmanager
def _staging_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder inside ``folder`` for files that are not yet complete."""
    is_new_folder = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with temporary_folder(folder) as stage:
            yield stage
    except BaseException as error:
        if is_new_folder:
            shutil.rmtree(folder, ignore_errors=True)
        if isinstance(error, OSError):
            message = f"cannot be written: {error.strerror}"
            raise ConfigInvalid(message, where=str(folder)) from error
        raise


def _outputs(
    source: Path, probes: list[Probe], execution: Execution
) -> Iterator[tuple[Probe, dict[str, np.ndarray]]]:
    runs = execution.runs
    for probe, first, second in zip(probes, runs[::2], runs[1::2], strict=True):
        if first.sample != second.sample:
            message = f"the model gives other outputs in a second run of probe {probe.label!r}"
            hint = "Remove random operators and state that persists between runs."
            raise RecordingRefused(message, where=str(source), hint=hint)
        yield probe, execution.samples[first.sample].outputs


def _write(
    folder: Path,
    subject: InspectedModel,
    probe: Probe,
    outputs: dict[str, np.ndarray],
    record: "_RecordOptions",
) -> TestVector:
    folder.mkdir()
    files = []
    input_names = [tensor.name for tensor in subject.graph.inputs]
    for number, name in enumerate(input_names):
        path = folder / f"input_{number}.pb"
        _write_tensor(path, name, probe.inputs[name])
        location = record.location(f"{folder.name}/{path.name}")
        if location is not None:
            files.append(VectorFile(name, location, sha256(path.read_bytes()).hexdigest()))
    for number, (name, value) in enumerate(outputs.items()):
        _write_tensor(folder / f"output_{number}.pb", name, value)
    declared = {name: outputs[name] for name in fetched_outputs(subject)}
    return TestVector(
        inputs=probe.label,
        expected_sha256=digest_outputs(declared),
        seed=record.seed,
        files=tuple(files),
    )


def _write_tensor(path: Path, name: str, value: np.ndarray) -> None:
    tensor = numpy_helper.from_array(np.array(value, order="C"), name)
    path.write_bytes(tensor.SerializeToString())
