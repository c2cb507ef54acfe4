"""Adds pictures of validated models to reports."""

__all__ = ["with_picture"]

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.fields.roles import GENERATOR
from gsgen.contract.validation.gates import PACKED_ROWS
from gsgen.contract.validation.report import Picture, Report
from gsgen.contract.validation.settings import Settings

_NEEDS = (*PACKED_ROWS, "GO005")
_ZEROS = "all inputs zero"

Draw = Callable[[Path, str, Settings], bytes]
"""Draws a model at the probe of a label as a PNG, or raises a GsgenError."""


def with_picture(report: Report, settings: Settings, draw: Draw) -> Report:
    """Add to a validation report a picture of the model at the inputs of its first finding."""
    return replace(report, picture=_picture(report, settings, draw))


def _picture(report: Report, settings: Settings, draw: Draw) -> Picture:
    if problem := _obstacle(report):
        return Picture(problem=problem)
    probe = _probe(report)
    try:
        return Picture(probe, draw(Path(report.path), probe, settings))
    except GsgenError as error:
        return Picture(probe, problem=str(error).replace("\n", " "))


def _obstacle(report: Report) -> str:
    """Return the reason why no picture of a model can be drawn; empty if one can."""
    if report.kind != GENERATOR:
        return "only generators are drawn"
    if not report.probes:
        return "the model did not run"
    statuses = {outcome.rule.id: outcome.status for outcome in report.outcomes}
    broken = [rule for rule in _NEEDS if statuses.get(rule) != "pass"]
    return f"rule {broken[0]} does not hold, or was not checked" if broken else ""


def _probe(report: Report) -> str:
    """Return the label of the test inputs to draw: of a finding, else halfway down the list."""
    labels = [label for label in report.probes if label != _ZEROS] or list(report.probes)
    named = (
        example.probe
        for finding in report.findings
        for example in finding.examples
        if example.probe in labels
    )
    return next(named, labels[len(labels) // 2])
