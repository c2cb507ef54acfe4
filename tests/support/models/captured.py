"""What the level live says of a model that a GPU runs, captures and replays rightly."""

__all__ = ["CAPTURED", "assert_captured"]

from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.report import Report

CAPTURED = ("GB011", "GB014", "GB015", "GB016", "GB017")


def assert_captured(report: Report) -> None:
    """Demand that the model conforms, and was run on an adapter, with no node on the CPU, and no stale replay.

    Without an adapter this fails: a test that is skipped for want of a driver is no test.
    """
    (live,) = (level for level in report.levels if level.level is Level.LIVE)
    assert report.verdict == "conforms", report.findings
    assert live.ran, f"{live.reason}; install a driver with `make drivers`"
    expected_message = {rule: report.outcome(rule).status for rule in CAPTURED}
    assert expected_message == dict.fromkeys(CAPTURED, "pass")
