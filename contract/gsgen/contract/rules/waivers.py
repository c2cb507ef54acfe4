"""Rules of waivers (GW): every waiver in the settings matches a finding of the model."""

from collections.abc import Iterator

from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.rule import rule
from gsgen.contract.validation.waivers import Review


@rule("GW001", Severity.WARNING, kinds=MANIFEST_KINDS)
def waiver_matches(review: Review) -> Iterator[Violation]:
    """Every waiver for the model is still valid and matches a finding.

    Why:
        A waiver that is no longer needed hides the same fault when it comes back, and an expired
        one looks as if it were still valid.

    Hint:
        Remove the waiver from `gsgen.toml`, or correct its `where`, which must be a location as the
        report writes it. If the waiver has expired, repair the model or move `until`.
    """
    for waiver in review.waivers:
        if waiver.rule == "GW001" or review.statuses.get(waiver.rule) not in ("pass", "fail"):
            continue  # without a check, the fault may still be there
        matches_finding = any(waiver.is_waiver_of(finding) for finding in review.findings)
        location = f"waiver of {waiver}"
        if not matches_finding:
            yield Violation.at(location, "no matching finding", "a finding that the waiver covers")
        elif not waiver.is_valid_on(review.today):
            yield Violation.at(location, f"expired on {waiver.until}", "a last day in the future")
