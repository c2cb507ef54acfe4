"""Adds pictures of validated models to reports, drawn by an installed renderer.

A renderer is registered under the entry point group ``gsgen.pictures``: a function that takes a
model, the label of a probe and settings, and returns a PNG or raises a GsgenError.
"""

__all__ = ["with_picture"]

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from gsgen.contract._entry_points import registered_entry_points
from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.fields.roles import GENERATOR
from gsgen.contract.validation.gates import PACKED_ROWS
from gsgen.contract.validation.report import Picture, Report
from gsgen.contract.validation.settings import Settings

_GROUP = "gsgen.pictures"
_NEEDS = (*PACKED_ROWS, "GO005")
_ZEROS = "all inputs zero"

Draw = Callable[[Path, str, Settings], bytes]


def with_picture(report: Report, settings: Settings) -> Report:
    """Add to a validation report a picture of the model at the inputs of its first finding."""
    return replace(report, picture=_picture(report, settings))


def _picture(report: Report, settings: Settings) -> Picture:
    points = registered_entry_points(_GROUP)
    problem = _obstacle(report)
    if problem or not points:
        return Picture(problem=problem or "no renderer is installed: pip install 'gsgen[runtime]'")
    probe = _probe(report)
    try:
        draw: Draw = points[0].load()
        return Picture(probe, draw(Path(report.path), probe, settings))
    except ImportError as error:
        return Picture(probe, problem=f"the renderer cannot be loaded: {error}")
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
