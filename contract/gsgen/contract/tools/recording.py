"""Copies a model and records computed data, such as test vectors, in the copy's manifest."""

__all__ = [
    "RecordingRefused",
    "current_document",
    "evenly_spaced",
    "inspect_recordable",
    "refuse_existing",
    "run_at_probes",
    "write_recorded_copy",
]

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from gsgen.contract._safe_text import for_shell
from gsgen.contract.errors import ConfigInvalid, GsgenError
from gsgen.contract.model.files_beside import find_contained_file
from gsgen.contract.model.inspected_model import InspectedModel, inspect_model
from gsgen.contract.model.model_file import ModelFile, open_model, write_manifest_text
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.sandbox import Execution, execute
from gsgen.contract.process.atomic_files import atomic_write
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.spec.upgrades import upgrade
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate

_ItemType = TypeVar("_ItemType")


class RecordingRefused(GsgenError):
    """Raised if outputs cannot be recorded in a manifest: no manifest, or an invalid model."""


def refuse_existing(existing_files: Sequence[Path], folder: Path, alternative: str) -> None:
    """Raise if an earlier recording in the model's manifest would be overwritten.

    Args:
        existing_files: Files of the earlier recording.
        folder: Their folder.
        alternative: The option to change instead of using --force, for the hint.
    """
    if existing_files:
        message = f"the folder already holds {existing_files[0].name}"
        hint = f"Name another {alternative}, or replace them with --force."
        raise ConfigInvalid(message, where=str(folder), hint=hint)


def evenly_spaced(items: Sequence[_ItemType], count: int) -> list[_ItemType]:
    """Return ``count`` evenly spaced items of a sequence; for two or more, with both ends."""
    picked_indices = np.rint(np.linspace(0, len(items) - 1, count)).astype(int)
    return [items[index] for index in picked_indices]


def inspect_recordable(source: Path, settings: Settings) -> InspectedModel:
    """Inspect a model, and raise if its outputs cannot be recorded in a manifest.

    Raises:
        ModelUnreadable: ``source`` is not an ONNX model.
        RecordingRefused: The model has no manifest, or breaks a static rule.
    """
    file = open_model(source)
    subject = inspect_model(file, settings.target, settings.limits)
    where, quoted_path = str(source), for_shell(str(source))
    if subject.parsed is None:
        hint = (
            f"`gsgen inspect {quoted_path} --emit-manifest` derives one; correct it, and embed it "
            f"with `gsgen fix {quoted_path} --manifest FILE -o OUT.onnx`."
        )
        raise RecordingRefused(
            "the model has no manifest to record outputs in", where=where, hint=hint
        )
    report = validate(source, replace(settings, level=Level.STATIC))
    failed_findings = [finding for finding in report.findings if finding.severity >= Severity.ERROR]
    if failed_findings:
        message = f"the model breaks {failed_findings[0].rule} at {failed_findings[0].where}: {failed_findings[0].message}"
        hint = f"Repair the model first; `gsgen validate {quoted_path}` lists its faults."
        raise RecordingRefused(message, where=where, hint=hint)
    return subject


def current_document(subject: InspectedModel) -> dict[str, Any]:
    """Return the JSON of a model's manifest, upgraded to the current contract version."""
    document: dict[str, Any] = json.loads(subject.file.manifest_text or "{}")
    version = subject.parsed.version if subject.parsed else None
    return upgrade(document, version) if version is not None else document


@contextmanager
def run_at_probes(
    subject: InspectedModel, outputs: Sequence[str], probes: Sequence[Probe]
) -> Iterator[Execution]:
    """Run a model with the given test inputs; results exist until the ``with`` block ends.

    Raises:
        RecordingRefused: The model does not run.
    """
    path = subject.file.path
    with execute(path, outputs, probes, subject.sandbox_limits) as execution:
        if execution.fault is not None:
            message = f"the model does not run: {execution.fault.message}"
            raise RecordingRefused(message, where=str(path))
        yield execution


@contextmanager
def write_recorded_copy(
    file: ModelFile, changed_fields: Mapping[str, Any], model: Path
) -> Iterator[Path]:
    """Write a copy of a model with changed manifest fields; unknown fields are kept.

    Args:
        file: The model; it is not changed, unless ``model`` is the same file.
        changed_fields: Field of the manifest → its JSON value.
        model: The copy; external weight files are copied too.

    Yields:
        A temporary folder; its files are moved next to the copy if the block succeeds.
    """
    document = json.loads(file.manifest_text or "{}") | dict(changed_fields)
    try:
        with atomic_write(model) as draft:
            for location in dict.fromkeys(ref.location for ref in file.external):
                weights = find_contained_file(file.path, location)
                if (model.parent / location).resolve() != weights.resolve():
                    copy = draft.parent / location
                    copy.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(weights, copy)
            write_manifest_text(file.path, json.dumps(document, ensure_ascii=False), draft)
            yield draft.parent
    except OSError as error:
        raise ConfigInvalid(
            f"the model cannot be written: {error.strerror}", where=str(model)
        ) from error
