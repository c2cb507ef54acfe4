"""Refuse a changed model that breaks a rule which the model kept."""

__all__ = ["refuse_worse"]

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.report import Report


def refuse_worse(before: Report, after: Report, how: str) -> None:
    """Refuse a result that breaks a rule the model kept.

    Args:
        before: The report of the model.
        after: The report of the result.
        how: What was done to it: ``repaired``.

    Raises:
        GsgenError: It does.
    """

    def errors(report: Report) -> set[str]:
        return {f.rule for f in report.findings if f.severity is Severity.ERROR}

    # A repair lets rules be judged that could not be before; what they find is no damage.
    judged = {o.rule.id for o in before.outcomes if o.status in ("pass", "fail")}
    fresh = (errors(after) - errors(before)) & judged
    if fresh:
        listed = ", ".join(sorted(fresh))
        raise GsgenError(
            f"the {how} model would break {listed}, which it kept", where=before.path
        )
