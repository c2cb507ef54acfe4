"""The last steps of every export: write a temporary file, verify, validate and rename it."""

__all__ = [
    "OPSET",
    "VECTORS",
    "Dtype",
    "ExportResult",
    "Progress",
    "check_contract",
    "silent",
    "write_export",
]

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeVar

from gsgen.contract.process.atomic_files import atomic_write
from gsgen.contract.spec.onnx_facts import SAFEST_OPSET

if TYPE_CHECKING:
    from gsgen.contract.validation.report import Report
    from gsgen.contract.validation.settings import Settings
    from gsgen.sdk.parity import Parity
    from gsgen.sdk.rewriting.rewrite import Change

Dtype = Literal["float32", "float16"]
Progress = Callable[[str], None]
_Verified = TypeVar("_Verified")

# The operator set of exported models unless another is requested: every runtime has its kernels.
OPSET = SAFEST_OPSET
# The number of test vectors with rows of the eager module, unless another is requested.
VECTORS = 2


def silent(_: str) -> None:
    """Ignore a progress message: the default progress callback of an export."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportResult(ABC):
    """Base class of an export's result: path, validation report and statistics."""

    path: Path
    report: "Report"  # the validator's report on it
    # how closely it agrees with eager torch; None if no torch module was exported
    parity: "Parity | None" = None
    changes: "tuple[Change, ...]" = ()  # the rewrites of the graph
    notes: tuple[str, ...] = ()  # further facts for the user, a sentence each

    @property
    @abstractmethod
    def dtype(self) -> Dtype:
        """The dtype of the exported model's outputs."""

    @property
    @abstractmethod
    def contents(self) -> str:
        """A short description of the exported model's outputs."""


def write_export(
    path: Path,
    save: Callable[[Path], None],
    verify: Callable[[Path], _Verified],
    *,
    target: str,
    settings: "Settings | None",
    progress: Progress,
    must_conform: bool = True,
) -> "tuple[_Verified, Report]":
    """Save a model to a temporary file, verify and validate it, and rename it on success.

    ``save`` writes the draft; ``verify`` raises if the draft differs from its reference.
    """
    with atomic_write(path) as draft:
        save(draft)
        verified = verify(draft)
        report = check_contract(draft, path, target, settings, progress, must_conform=must_conform)
    return verified, report


def check_contract(
    draft: Path,
    path: Path,
    target: str,
    settings: "Settings | None",
    progress: Progress,
    *,
    must_conform: bool = True,
) -> "Report":
    """Validate an exported model before it gets its final name; raise if it breaks a rule.

    Raises :class:`ExportRejected`, which carries the report, if the model breaks a rule.
    """
    from gsgen.contract.spec.severity import Level, Severity
    from gsgen.contract.spec.targets import load_target
    from gsgen.contract.validation.settings import Settings
    from gsgen.contract.validator import validate
    from gsgen.sdk.errors import ExportRejected

    base = settings or Settings(level=Level.BEHAVIOUR)
    settings = replace(base, target=load_target(target))
    report = replace(validate(draft, settings, progress=progress), path=str(path))
    if must_conform and report.verdict != "conforms":
        errors = [f for f in report.findings if f.severity >= Severity.ERROR]
        message = "; ".join(
            f"{finding.rule} {finding.where}: {finding.message}"
            for finding in errors or report.findings
        )
        hint = (errors or report.findings)[0].hint if report.findings else ""
        raise ExportRejected(message, report, where=path.name, hint=hint)
    return report
