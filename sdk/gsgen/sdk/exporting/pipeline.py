"""The beginning and the end of every export: its options, and a file that is verified and valid."""

__all__ = [
    "OPSET",
    "VECTOR_COUNT",
    "Dtype",
    "ExportOptions",
    "Exported",
    "GraphSource",
    "Progress",
    "Stage",
    "StageClock",
    "check_contract",
    "no_progress",
    "probes_of",
]

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from gsgen.contract.process.atomic_files import refuse_folder
from gsgen.contract.spec.onnx_facts import SAFEST_OPSET

if TYPE_CHECKING:
    from gsgen.contract.probing.probes import Probe
    from gsgen.contract.process.limits import Limits
    from gsgen.contract.spec.manifest import Manifest
    from gsgen.contract.validation.report import Report
    from gsgen.contract.validation.settings import Settings
    from gsgen.sdk.exporting.tracing.folded_constants import FoldedConstants
    from gsgen.sdk.float16.convert_image_model import Float16ImageResult
    from gsgen.sdk.float16.convert_model import Float16Result
    from gsgen.sdk.parity import Parity
    from gsgen.sdk.rewriting.rewrite import Change

Dtype = Literal["float32", "float16"]
Progress = Callable[[str], None]

# The operator set of exported models unless another is requested: every runtime has its kernels.
OPSET = SAFEST_OPSET
# The number of test vectors with rows of the eager module, unless another is requested.
VECTOR_COUNT = 2


def no_progress(_: str) -> None:
    """Ignore a progress message: the default progress callback of an export."""


@dataclass(frozen=True, slots=True)
class Stage:
    """A stage of an export, and the processor time that it took, child processes included."""

    name: str
    cpu_seconds: float


class StageClock:
    """Measures the processor time of the stages of an export.

    It is a progress callback, too: a caller that passes it to an export has the stages of one that
    fails.

    Args:
        progress: Called with a message when a stage begins.
    """

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._stages: list[Stage] = []
        self._name = ""
        self._start = self._first_start = _cpu_seconds()

    @classmethod
    def of(cls, progress: Progress) -> "StageClock":
        """Return the clock of an export: the caller's own, or a new one."""
        return progress if isinstance(progress, StageClock) else cls(progress)

    def __call__(self, message: str) -> None:
        """Pass a message on, within the stage that runs."""
        self._progress(message)

    def begin(self, name: str) -> None:
        """End the stage before, and begin the next one."""
        self._end()
        self._name = name
        total = self._start - self._first_start
        self._progress(f"{name} ({total:.0f} CPU-s so far)" if total >= 1 else name)

    def stages(self) -> tuple[Stage, ...]:
        """End the last stage, and return all of them."""
        self._end()
        self._name = ""
        return tuple(self._stages)

    def _end(self) -> None:
        now = _cpu_seconds()
        if self._name:
            self._stages.append(Stage(self._name, now - self._start))
        self._start = now


def _cpu_seconds() -> float:
    """Return the processor time of this process and of the children that have ended."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions:
    """The options that exports of every kind have."""

    path: Path  # the model file
    name: str  # the name in the manifest
    opset: int  # the ONNX operator set
    target: str  # the consumer to rewrite and validate for
    settings: "Settings | None"  # level, limits and severities of the validation
    progress: Progress  # called with a message when a step begins
    rewrite: bool = True  # whether to rewrite the graph so that it is captured
    skip: Sequence[str] = ()  # names of passes that are left out of the rewriting

    @property
    def limits(self) -> "Limits":
        """Time and memory for running the model."""
        from gsgen.contract.process.limits import Limits

        return self.settings.limits if self.settings is not None else Limits()

    def __post_init__(self) -> None:
        refuse_folder(self.path)


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """The result of exporting a generator, a post-process model or a scene that does not change.

    Attributes:
        path: The model file.
        manifest: The embedded manifest.
        report: The validator's report on the file.
        dtype: The dtype of the outputs.
        contents: A short description of the outputs.
        parity: How closely the model agrees with eager torch; None if no module was exported.
        changes: The rewrites of the graph.
        notes: Further facts for the user, a sentence each.
        float16_result: Which nodes and weights became float16; None if the outputs are float32.
        stages: The stages of the export, with their processor time.
        folded: The operations that were computed before the trace; None if torch traced all of the module.
        measured: Measurements by name, for the JSON report.
        lines: The same as text, a line each.
    """

    path: Path
    manifest: "Manifest"
    report: "Report"
    dtype: Dtype
    contents: str
    parity: "Parity | None" = None
    changes: "tuple[Change, ...]" = ()
    notes: tuple[str, ...] = ()
    float16_result: "Float16Result | Float16ImageResult | None" = None
    stages: tuple[Stage, ...] = ()
    folded: "FoldedConstants | None" = None
    measured: Mapping[str, Any] | None = None
    lines: tuple[str, ...] = ()


class GraphSource(ABC):
    """Base class of sources whose ONNX graph is written directly; torch is not needed."""

    @abstractmethod
    def export(
        self,
        path: str | os.PathLike[str],
        *,
        name: str | None = None,
        dtype: Dtype | None = None,
        capacity: int | None = None,
        opset: int = OPSET,
        target: str = "core",
        settings: "Settings | None" = None,
        progress: Progress = no_progress,
    ) -> Exported:
        """Write the generator; options are those of :func:`gsgen.sdk.export`."""


def probes_of(
    manifest: "Manifest",
    *,
    count: int,
    seed: int = 0,
    image: tuple[Dtype, tuple[int, ...]] | None = None,
) -> "tuple[Probe, ...]":
    """Return test inputs for a manifest.

    A post-process model takes ``image``: the dtype of images, and any shape that they leave open;
    its other inputs are float32.
    """
    from gsgen.contract.probing.probes import default_probes
    from gsgen.contract.spec.fields.roles import ROLES

    roles = {entry.name: entry.role for entry in manifest.inputs}
    if image is None:
        shape: tuple[int, ...] = ()
        dtypes = {name: ROLES[role].dtype[0] for name, role in roles.items()}
    else:
        dtype, shape = image
        dtypes = {name: dtype if role == "image" else "float32" for name, role in roles.items()}
    shapes = {entry.name: entry.shape or shape for entry in manifest.inputs}
    return default_probes(manifest, shapes, dtypes, seed, count)


def check_contract(draft: Path, options: ExportOptions, *, must_conform: bool = True) -> "Report":
    """Validate an exported model before it gets its final name.

    Raises:
        ExportRejected: The model breaks a rule; the error carries the report.
    """
    from gsgen.contract.process.interrupts import OutOfTime, require_time
    from gsgen.contract.spec.severity import Level, Severity
    from gsgen.contract.spec.targets import load_target
    from gsgen.contract.validation.report import LevelOutcome
    from gsgen.contract.validation.settings import Settings
    from gsgen.contract.validator import validate
    from gsgen.sdk.errors import ExportRejected

    base = options.settings or Settings(level=Level.BEHAVIOUR)
    settings = replace(base, target=load_target(options.target))
    try:
        require_time()
        report = validate(draft, settings, progress=options.progress)
    except OutOfTime as error:  # before its first run, which a validation goes on without
        error.guard.cancel()
        report = validate(draft, replace(settings, level=Level.STATIC))
        left_out = [level for level in Level if Level.STATIC < level <= settings.level]
        outcomes = [
            LevelOutcome(level=level, ran=False, reason=f"not checked: {error}")
            for level in left_out
        ]
        report = replace(report, levels=(*report.levels, *outcomes))
    report = replace(report, path=str(options.path))
    if must_conform and report.verdict != "conforms":
        errors = [f for f in report.findings if f.severity >= Severity.ERROR]
        message = "; ".join(
            f"{finding.rule} {finding.where}: {finding.message}"
            for finding in errors or report.findings
        )
        hint = (errors or report.findings)[0].hint if report.findings else ""
        raise ExportRejected(message, report, where=options.path.name, hint=hint)
    return report
