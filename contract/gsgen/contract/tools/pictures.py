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

_PREREQUISITE_RULES = (*PACKED_ROWS, "GO005")
_ZERO_INPUTS_LABEL = "all inputs zero"

DrawPicture = Callable[[Path, str, Settings], bytes]
"""Draws a model at the probe of a label as a PNG, or raises a GsgenError."""


def with_picture(report: Report, settings: Settings, draw: DrawPicture) -> Report:
    """Add to a validation report a picture of the model at the inputs of its first finding."""
    return replace(report, picture=_picture(report, settings, draw))


def _picture(report: Report, settings: Settings, draw: DrawPicture) -> Picture:
    if problem := _find_obstacle(report):
        return Picture(problem=problem)
    probe = _choose_probe(report)
    try:
        return Picture(probe, draw(Path(report.path), probe, settings))
    except GsgenError as error:
        return Picture(probe, problem=str(error).replace("\n", " "))


def _find_obstacle(report: Report) -> str:
    """Return the reason why no picture of a model can be drawn; empty if one can."""
    if report.kind != GENERATOR:
        return "only generators are drawn"
    if not report.probes:
        return "the model did not run"
    statuses = {outcome.rule.id: outcome.status for outcome in report.outcomes}
    failed_rules = [rule for rule in _PREREQUISITE_RULES if statuses.get(rule) != "pass"]
    return f"rule {failed_rules[0]} does not hold, or was not checked" if failed_rules else ""


def _choose_probe(report: Report) -> str:
    """Return the label of the test inputs to draw: of a finding, else halfway down the list."""
    labels = [label for label in report.probes if label != _ZERO_INPUTS_LABEL] or list(
        report.probes
    )
    named_labels = (
        example.probe
        for finding in report.findings
        for example in finding.examples
        if example.probe in labels
    )
    return next(named_labels, labels[len(labels) // 2])
