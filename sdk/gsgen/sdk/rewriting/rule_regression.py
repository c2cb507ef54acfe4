"""Raises if a changed model breaks a validation rule that the original model keeps."""

__all__ = ["refuse_new_violations"]

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.report import Report


def refuse_new_violations(before: Report, after: Report, operation: str) -> None:
    """Raise if a changed model breaks a contract rule that the original model keeps.

    ``operation`` is the participle for an error, such as ``repaired``.
    """

    def errors(report: Report) -> set[str]:
        return {f.rule for f in report.findings if f.severity is Severity.ERROR}

    # Rules that could not be evaluated on the source may find faults that it had before.
    evaluated_rules = {o.rule.id for o in before.outcomes if o.status in ("pass", "fail")}
    new_violations = (errors(after) - errors(before)) & evaluated_rules
    if new_violations:
        listed_violations = ", ".join(sorted(new_violations))
        message = f"the {operation} model would break {listed_violations}, which the source keeps"
        raise GsgenError(message, where=before.path)
