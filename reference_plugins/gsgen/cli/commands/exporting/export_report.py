"""The JSON document that `gsgen export` writes with --report and prints with --json."""

__all__ = ["ExportOutcome", "emit_report"]

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsgen.cli.commands.exporting.export_options import ExportRequest
from gsgen.cli.output import echo_json, write_text
from gsgen.contract._safe_text import for_json
from gsgen.contract.errors import GsgenError
from gsgen.contract.reporters.json_report import to_dict

if TYPE_CHECKING:
    from gsgen.contract.validation.report import Report
    from gsgen.sdk.exporting.pipeline import Stage
    from gsgen.sdk.exporting.tracing.folded_constants import FoldedConstants
    from gsgen.sdk.parity import Parity
    from gsgen.sdk.rewriting.rewrite import Change

_REPORT_SCHEMA = "gsgen-export/1"


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOutcome:
    """The result of `gsgen export`, or the error that stopped it."""

    written: bool  # whether the model file was written
    report: "Report | None" = None  # the validator's report, if the model was validated
    # how closely the model agrees with torch, if the two were compared
    parity: "Parity | None" = None
    changes: "tuple[Change, ...]" = ()  # the rewrites of the graph
    notes: tuple[str, ...] = ()  # further facts for the user
    stages: "tuple[Stage, ...]" = ()  # the stages, with their processor time
    folded: "FoldedConstants | None" = None  # operations computed before the trace
    measured: Mapping[str, Any] | None = None  # measurements by name
    error: GsgenError | None = None  # the error that stopped the export


def emit_report(request: ExportRequest, source: str, outcome: ExportOutcome) -> None:
    """Write and print the options and the outcome of an export as JSON, where requested."""
    options = {key: _json_value(value) for key, value in asdict(request).items()}
    del options["as_json"]  # how the report is printed, not an option of the export
    document = {
        "schema": _REPORT_SCHEMA,
        "tool": f"gsgen {version('gsgen')}",
        "source": source,
        "options": options,
        "written": outcome.written,
        "error": _error(outcome.error) if outcome.error else None,
        "rewrites": [
            {"name": change.rewrite, "nodes": list(change.nodes)} for change in outcome.changes
        ],
        "notes": list(outcome.notes),
        "stages": [asdict(stage) for stage in outcome.stages],
        "constants": asdict(outcome.folded) if outcome.folded else None,
        "parity": _parity_as_dict(outcome.parity) if outcome.parity else None,
        "measured": dict(outcome.measured) if outcome.measured else None,
        "validation": to_dict(outcome.report) if outcome.report else None,
    }
    if request.report is not None:
        write_text(request.report, for_json(document) + "\n")
    if request.as_json:
        echo_json(document)


def _error(error: GsgenError) -> dict[str, Any]:
    return {
        "kind": type(error).__name__,
        "message": error.message,
        "where": error.where,
        "hint": error.hint,
    }


def _parity_as_dict(parity: "Parity") -> dict[str, Any]:
    fields = [
        {
            "field": field.field,
            "error": _json_value(field.error),
            "share_of_allowed": _json_value(field.excess),
            "probe": field.probe,
            "row": field.row,
        }
        for field in parity.fields
    ]
    return {
        "probes": parity.probes,
        "rows_at_a_threshold": parity.rows_at_threshold,
        "fields": fields,
    }


def _json_value(value: Any) -> Any:
    """Convert a value to JSON types: paths become strings, NaN and infinity become null."""
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
