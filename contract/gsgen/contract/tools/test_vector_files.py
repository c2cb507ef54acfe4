"""Record test vectors: files that ONNX's backend runner reads, and digests in the manifest.

The layout is that of the ONNX model zoo: a folder with ``model.onnx`` and, for each vector,
``test_data_set_0/input_0.pb …, output_0.pb …``, TensorProto messages in the order of the graph's
inputs and outputs.
"""

__all__ = ["Recorded", "record_vectors"]

import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from onnx import numpy_helper

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.probe_plan import fetched_outputs, make_plan
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.sandbox import Execution
from gsgen.contract.probing.sandbox_worker import digest_of
from gsgen.contract.spec.json_schema import to_json
from gsgen.contract.spec.manifest import TestVector
from gsgen.contract.spec.severity import Level
from gsgen.contract.tools.recording import (
    RecordingRefused,
    executed,
    recordable,
    recorded_copy,
    refuse_standing,
    spread,
)
from gsgen.contract.validation.settings import Settings

MODEL = "model.onnx"
_COUNT = 3
_SET = re.compile(r"^test_data_set_[0-9]+$")


@dataclass(frozen=True, slots=True)
class Recorded:
    """What was written.

    Attributes:
        model: The copy whose manifest has the digests.
        folder: Where the folders of inputs and outputs are.
        vectors: What the manifest says now, in the order of the folders.
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
) -> Recorded:
    """Run ``source`` at ``count`` of its probes, and keep inputs, outputs and their digests.

    Args:
        source: A model with a manifest; it stays as it is, unless ``model`` is the same file.
        folder: Gets a folder ``test_data_set_k`` for each vector.
        model: The copy with the digests; ``folder/model.onnx`` where absent.
        count: How many probes, spread over the set that validation runs, all zeros first;
            three where absent, or all where there are fewer.
        seed: Seed of that set.
        settings: Limits of running it.
        force: Replace vectors that stand in ``folder`` already.
        progress: Called with a few words whenever a new stage begins.

    Raises:
        ModelUnreadable: ``source`` is not an ONNX model.
        RecordingRefused: It has no manifest, breaks a static rule, fails, or gives other outputs
            when it is run again.
        ConfigInvalid: There are fewer probes, the folder holds vectors, or cannot be written.
    """
    settings = settings or Settings()
    model = model or folder / MODEL
    standing = [path for path in _listed(folder) if _SET.match(path.name)]
    if not force:
        refuse_standing(standing, folder, "folder")
    progress(f"reading {source.name}")
    subject = _subject(source, settings)
    probes = _chosen(make_plan(subject, Level.VALUES, seed).probes, count)
    progress(f"running {len(probes)} probes twice in ONNX Runtime")
    with _staged(folder) as stage:
        names = [tensor.name for tensor in subject.graph.outputs]
        twice = [probe for probe in probes for _ in range(2)]
        with executed(subject, names, twice) as execution:
            vectors = tuple(
                _write(stage / f"test_data_set_{index}", subject, probe, outputs, seed)
                for index, (probe, outputs) in enumerate(
                    _outputs(source, probes, execution)
                )
            )
        progress(f"writing {model.name}")
        with recorded_copy(subject.file, {"test_vectors": to_json(vectors)}, model):
            pass
        for path in standing:
            _remove(path)
        for made in sorted(stage.iterdir()):
            made.replace(folder / made.name)
    return Recorded(model, folder, vectors)


def _listed(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []


def _remove(path: Path) -> None:
    if path.is_symlink() or not path.is_dir():
        path.unlink()  # of what a link points to nothing is ours
    else:
        shutil.rmtree(path)


def _subject(source: Path, settings: Settings) -> InspectedModel:
    subject = recordable(source, settings)
    # Without a manifest, all outputs that numpy can hold are fetched.
    fetched = fetched_outputs(replace(subject, parsed=None, candidate=None))
    unread = [one.name for one in subject.graph.outputs if one.name not in fetched]
    if unread:
        what = f"output {unread[0]!r} has a dtype that numpy cannot hold"
        raise RecordingRefused(what, where=str(source))
    return subject


def _chosen(probes: tuple[Probe, ...], count: int | None) -> list[Probe]:
    if count is None:
        count = min(_COUNT, len(probes))
    if count > len(probes):
        have = "1 probe" if len(probes) == 1 else f"{len(probes)} probes"
        what = f"{count} vectors, and the model has {have}"
        raise ConfigInvalid(what, where="--count", hint=f"--count {len(probes)} takes all.")
    if count < 1:
        raise ConfigInvalid(f"{count} vectors, wanted 1 or more", where="--count")
    return spread(probes, count)


@contextmanager
def _staged(folder: Path) -> Iterator[Path]:
    """Yield a folder inside ``folder`` for what is not whole yet; nothing of it stays."""
    fresh = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        stage = tempfile.TemporaryDirectory(dir=folder, prefix=".vectors.")
    except OSError as error:
        raise ConfigInvalid(
            f"cannot be written: {error.strerror}", where=str(folder)
        ) from error
    try:
        with stage as name:
            yield Path(name)
    except BaseException:
        if fresh:
            shutil.rmtree(folder, ignore_errors=True)
        raise


def _outputs(
    source: Path, probes: list[Probe], execution: Execution
) -> Iterator[tuple[Probe, dict[str, np.ndarray]]]:
    runs = execution.runs
    for probe, first, second in zip(probes, runs[::2], runs[1::2], strict=True):
        if first.sample != second.sample:
            what = f"gives other outputs when it is run again, at {probe.label!r}"
            hint = "Remove random operators, and state that is kept between runs."
            raise RecordingRefused(what, where=str(source), hint=hint)
        yield probe, execution.samples[first.sample].outputs


def _write(
    folder: Path,
    subject: InspectedModel,
    probe: Probe,
    outputs: dict[str, np.ndarray],
    seed: int,
) -> TestVector:
    folder.mkdir()
    given = [tensor.name for tensor in subject.graph.inputs]
    for number, name in enumerate(given):
        _write_tensor(folder / f"input_{number}.pb", name, probe.inputs[name])
    for number, (name, value) in enumerate(outputs.items()):
        _write_tensor(folder / f"output_{number}.pb", name, value)
    declared = {name: outputs[name] for name in fetched_outputs(subject)}
    return TestVector(probe.label, digest_of(declared), seed)


def _write_tensor(path: Path, name: str, value: np.ndarray) -> None:
    tensor = numpy_helper.from_array(np.array(value, order="C"), name)
    path.write_bytes(tensor.SerializeToString())
