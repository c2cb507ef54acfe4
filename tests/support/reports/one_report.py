"""A plugin for workers of pytest-xdist: a test that passes sends one report, and not three.

A report takes a millisecond to send and to read, and there are thirteen thousand tests.
"""

import pytest
from _pytest.runner import runtestprotocol


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool:
    """Run a test; report its call, with the time of its fixtures, and whatever did not pass."""
    reports = runtestprotocol(item, nextitem=nextitem, log=False)
    for report in reports:
        if report.when == "call":
            report.duration = sum(one.duration for one in reports)
        if report.when == "call" or not report.passed:
            item.ihook.pytest_runtest_logreport(report=report)
    return True
