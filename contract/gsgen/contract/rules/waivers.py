"""GW: what a configuration waives is really there."""

from collections.abc import Iterator

from gsgen.contract.spec.roles import KINDS
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.rule import rule
from gsgen.contract.validation.waivers import Review


@rule(
    "GW001",
    "waiver-matches",
    Severity.WARNING,
    over="report",
    fixture="waived_without_need",
    kinds=KINDS,
)
def waiver_matches(review: Review) -> Iterator[Violation]:
    """Every waiver that speaks of the model has not ended, and waives something.

    Why:
        A waiver that is no longer needed hides the same fault when it comes back, and one that has
        ended looks as if it still held.

    Hint:
        Remove the waiver from `gsgen.toml`; correct its `where`, which must be a place as the
        report writes it; or mend the model, or move `until`, if the waiver has ended.
    """
    for waiver in review.waivers:
        if waiver.rule == "GW001" or review.statuses.get(waiver.rule) not in (
            "pass",
            "fail",
        ):
            continue  # what was not judged may be there all the same
        found = any(waiver.covers(finding) for finding in review.findings)
        place = f"waiver of {waiver}"
        if not found:
            yield Violation.at(place, "nothing to waive", "a finding that it speaks of")
        elif not waiver.holds_on(review.today):
            yield Violation.at(place, f"ended on {waiver.until}", "a day that is not past")
