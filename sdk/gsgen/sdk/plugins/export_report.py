"""The JSON document that `gsgen export --report` writes."""

__all__ = ["Outcome", "write_report"]

import json
import math
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsgen.contract.commands.output import write_text
from gsgen.contract.errors import GsgenError
from gsgen.contract.reporters.json_report import to_dict
from gsgen.sdk.plugins.export_options import ExportRequest

if TYPE_CHECKING:
    from gsgen.contract.validation.report import Report
    from gsgen.sdk.parity import Parity
    from gsgen.sdk.rewriting.rewrite import Change

_SCHEMA = "gsgen-export/1"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of an export.

    Attributes:
        written: A model stands in its place.
        report: What the validator found, if it came so far.
        parity: How closely the model agrees with torch, if it was compared.
        changes: What rewrites did to the graph.
        error: Why there is no model.
    """

    written: bool
    report: "Report | None" = None
    parity: "Parity | None" = None
    changes: "tuple[Change, ...]" = ()
    error: GsgenError | None = None


def write_report(path: Path, request: ExportRequest, source: str, outcome: Outcome) -> None:
    """Write what was asked for and what came of it.

    Args:
        path: The file.
        request: What was asked for.
        source: What was exported: a plugin's name or ``module:factory``.
        outcome: What came of it.

    Raises:
        ConfigInvalid: The file cannot be written.
    """
    document = {
        "schema": _SCHEMA,
        "tool": f"gsgen {version('gsgen')}",
        "source": source,
        "options": {key: _plain(value) for key, value in asdict(request).items()},
        "written": outcome.written,
        "error": _error(outcome.error) if outcome.error else None,
        "rewrites": [
            {"name": one.rewrite, "nodes": list(one.nodes)} for one in outcome.changes
        ],
        "parity": _parity(outcome.parity) if outcome.parity else None,
        "validation": to_dict(outcome.report) if outcome.report else None,
    }
    write_text(path, json.dumps(document, indent=2, ensure_ascii=False) + "\n")


def _error(error: GsgenError) -> dict[str, Any]:
    return {
        "kind": type(error).__name__,
        "message": error.message,
        "where": error.where,
        "hint": error.hint,
    }


def _parity(parity: "Parity") -> dict[str, Any]:
    fields = [
        {
            "field": one.field,
            "error": _plain(one.error),
            "share_of_allowed": _plain(one.excess),
            "probe": one.probe,
            "row": one.row,
        }
        for one in parity.fields
    ]
    return {"probes": parity.probes, "rows_at_a_threshold": parity.jumped, "fields": fields}


def _plain(value: Any) -> Any:
    """Return a value as JSON has it: paths as text, and no number that is none."""
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
