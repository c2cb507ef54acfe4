"""Record what a model gives in the manifest of a copy: vectors, pictures, whatever it promises."""

__all__ = [
    "RecordingRefused",
    "executed",
    "recordable",
    "recorded_copy",
    "refuse_standing",
    "spread",
]

import json
import shlex
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from gsgen.contract.errors import ConfigInvalid, GsgenError
from gsgen.contract.model.inspected_model import InspectedModel, inspect_model
from gsgen.contract.model.model_file import ModelFile, open_model, write_manifest_text
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.sandbox import Execution, execute
from gsgen.contract.process.atomic_files import atomic_write
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate

_Thing = TypeVar("_Thing")


class RecordingRefused(GsgenError):
    """The model is not one whose outputs can be promised."""


def refuse_standing(standing: Sequence[Path], folder: Path, other: str) -> None:
    """Refuse to replace what an earlier recording wrote.

    Args:
        standing: What of it is there.
        folder: Where.
        other: What can be named in its place, for the error.

    Raises:
        ConfigInvalid: There is some.
    """
    if standing:
        what = f"holds {standing[0].name} already"
        hint = f"Name another {other}, or replace them with --force."
        raise ConfigInvalid(what, where=str(folder), hint=hint)


def spread(things: Sequence[_Thing], count: int) -> list[_Thing]:
    """Return ``count`` of the things, evenly spread; first and last are among several."""
    picked = np.rint(np.linspace(0, len(things) - 1, count)).astype(int)
    return [things[index] for index in picked]


def recordable(source: Path, settings: Settings) -> InspectedModel:
    """Return what is known of a model that can promise something.

    Raises:
        ModelUnreadable: ``source`` is not an ONNX model.
        RecordingRefused: It has no manifest, or breaks a static rule.
    """
    file = open_model(source)
    subject = inspect_model(file, settings.target, settings.limits)
    where, typed = str(source), shlex.quote(str(source))
    if subject.parsed is None:
        hint = (
            f"`gsgen inspect {typed} --emit-manifest` derives one; correct it, and embed it "
            f"with `gsgen fix {typed} --manifest FILE -o OUT.onnx`."
        )
        raise RecordingRefused(
            "has no manifest that could hold them", where=where, hint=hint
        )
    report = validate(source, replace(settings, level=Level.STATIC))
    broken = [one for one in report.findings if one.severity >= Severity.ERROR]
    if broken:
        what = f"breaks {broken[0].rule} at {broken[0].where}: {broken[0].message}"
        hint = (
            f"What a broken model gives is no promise; `gsgen validate {typed}` says more."
        )
        raise RecordingRefused(what, where=where, hint=hint)
    return subject


@contextmanager
def executed(
    subject: InspectedModel, outputs: Sequence[str], probes: Sequence[Probe]
) -> Iterator[Execution]:
    """Run a model at probes; results live as long as the block.

    Raises:
        RecordingRefused: It does not run.
    """
    path = subject.file.path
    with execute(path, outputs, probes, subject.granted) as execution:
        if execution.fault is not None:
            what = f"does not run: {execution.fault.message}"
            raise RecordingRefused(what, where=str(path))
        yield execution


@contextmanager
def recorded_copy(
    file: ModelFile, changed: Mapping[str, Any], model: Path
) -> Iterator[Path]:
    """Write a copy whose manifest says something else; fields that we do not know stay.

    Args:
        file: The model; it stays as it is, unless ``model`` is the same file.
        changed: Field of the manifest → what it says, as JSON has it.
        model: The copy; weights in other files are copied along.

    Yields:
        A folder: what is written into it goes beside the copy, if the block ends well.

    Raises:
        ConfigInvalid: The copy cannot be written.
    """
    document = json.loads(file.manifest_text or "{}") | dict(changed)
    try:
        with atomic_write(model) as draft:
            for location in dict.fromkeys(ref.location for ref in file.external):
                weights = file.path.parent / location
                if (model.parent / location).resolve() != weights.resolve():
                    copy = draft.parent / location
                    copy.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(weights, copy)
            write_manifest_text(file.path, json.dumps(document, ensure_ascii=False), draft)
            yield draft.parent
    except OSError as error:
        raise ConfigInvalid(
            f"cannot be written: {error.strerror}", where=str(model)
        ) from error
