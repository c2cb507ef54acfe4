"""Validation rules of files beside a model: inputs of test vectors, digests of weights."""

import hashlib
from collections.abc import Iterator
from pathlib import Path

from gsgen.contract.model.files_beside import FileRefused, find_contained_file
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.run_comparison import ProbeRuns
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation, remove_hint
from gsgen.contract.validation.gates import MANIFEST_PARSED
from gsgen.contract.validation.rule import rule

_CHUNK_BYTES = 1 << 20
_RECORD_AGAIN = "write all again with `gsgen vectors MODEL --into FOLDER -o COPY`, and ship FOLDER with the copy"


def _digest(path: Path) -> str:
    hasher = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK_BYTES):
            hasher.update(chunk)
    return hasher.hexdigest()


def _side_file_fault(model: Path, location: str, sha256: str) -> tuple[str, str] | None:
    """Return the fault of a file beside the model, and the expected value; None if valid."""
    try:
        actual = _digest(find_contained_file(model, location))
    except FileRefused as error:
        return error.actual, error.expected
    return None if actual == sha256 else (f"sha256 {actual[:12]}…", f"{sha256[:12]}…, as declared")


@rule("GM033", Severity.WARNING, kinds=MANIFEST_KINDS, needs=("GM004",))
def vector_files_whole(subject: InspectedModel) -> Iterator[Violation]:
    """The files of a test vector hold all model inputs, lie beside the model, and match digests.

    Why:
        A reader in another language feeds these files: with a missing or another one it computes
        other outputs, and blames its own code.

    Hint:
        Remove the vector, or write all again with `gsgen vectors MODEL --into FOLDER -o COPY`, and
        ship the folder with the model.
    """
    manifest, model = subject.manifest, subject.file.path
    names = sorted(entry.name for entry in manifest.inputs) if manifest else []
    for number, vector in enumerate(manifest.test_vectors if manifest else ()):
        where = f"manifest test_vectors.{number}"
        hint = remove_hint(f"test_vectors.{number}", _RECORD_AGAIN)
        if vector.files and sorted(file.input for file in vector.files) != names:
            input_names = ", ".join(file.input for file in vector.files)
            expected = f"one for each of {', '.join(names)}"
            yield Violation.at(where, f"files for {input_names}", expected, hint=hint)
        for file in vector.files:
            fault = _side_file_fault(model, file.path, file.sha256)
            if fault is not None:
                yield Violation.at(where, f"{file.path!r}: {fault[0]}", fault[1], hint=hint)


@rule("GS005", Severity.ERROR, kinds=MANIFEST_KINDS, needs=(*MANIFEST_PARSED, "GS001"))
def external_data_unchanged(probe_runs: ProbeRuns) -> Iterator[Violation]:
    """External data files have the digests that the manifest declares, and the model uses them.

    Why:
        A model and its weights travel as two files. With the weights of another export the model
        runs, and draws something else.

    Hint:
        Ship the weights that were exported with the model; after a change, write the digests again.
    """
    subject = probe_runs.subject
    used_locations = {ref.location for ref in subject.file.external}
    for index, entry in enumerate(subject.manifest.external_data if subject.manifest else ()):
        where = f"external data {entry.path!r}"
        if entry.path not in used_locations:
            hint = remove_hint(f"external_data.{index}", "name the file that the weights lie in")
            yield Violation.at(
                where, "no weight lies there", "a file that the model uses", hint=hint
            )
            continue
        fault = _side_file_fault(subject.file.loading_path, entry.path, entry.sha256)
        if fault is not None:
            yield Violation.at(where, *fault)
