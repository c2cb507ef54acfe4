"""Exceptions raised when a model cannot be exported or rewritten."""

__all__ = ["ExportFailed", "ExportRejected", "GeneratorInvalid", "ParityFailed", "RewriteFailed"]

from typing import TYPE_CHECKING

from gsgen.contract.errors import GsgenError

if TYPE_CHECKING:
    from gsgen.contract.validation.report import Report
    from gsgen.sdk.parity import Parity


class GeneratorInvalid(GsgenError):
    """Raised if a torch generator declares or returns what the model contract does not allow."""


class ExportFailed(GsgenError):
    """Raised if torch cannot convert a module to an ONNX graph."""


class ParityFailed(GsgenError):
    """Raised if an exported model computes other outputs than the torch module.

    Attributes:
        parity: The differences; None if the model did not run.
    """

    def __init__(
        self, message: str, *, where: str = "", hint: str = "", parity: "Parity | None" = None
    ) -> None:
        super().__init__(message, where=where, hint=hint)
        self.parity = parity


class ExportRejected(GsgenError):
    """Raised if an exported model breaks a validation rule of the contract.

    Attributes:
        report: The validator's report.
    """

    def __init__(self, message: str, report: "Report", *, where: str = "", hint: str = "") -> None:
        super().__init__(message, where=where, hint=hint)
        self.report = report


class RewriteFailed(GsgenError):
    """Raised if a graph cannot be rewritten, or would compute other outputs."""
