"""GW001 reviews the waivers of all rules that were checked, plugins' rules among them."""

from datetime import date

import pytest

from gsgen.contract.rules.waivers import waiver_matches
from gsgen.contract.validation.waivers import Review, Waiver


@pytest.mark.parametrize(
    ("rule", "status", "count"),
    [
        ("GV003", "pass", 1),
        ("acme/AC001", "pass", 1),
        ("acme/AC001", "fail", 1),
        ("acme/AC001", "skipped", 0),
        ("GW001", "pass", 0),  # it reviews no waiver of itself
    ],
)
def test_waivers_without_a_finding_are_reported(rule: str, status: str, count: int) -> None:
    waiver = Waiver(rule=rule, reason="a reason")
    review = Review(findings=(), statuses={rule: status}, waivers=(waiver,), today=date(2026, 1, 1))
    assert len(list(waiver_matches.check(review))) == count
