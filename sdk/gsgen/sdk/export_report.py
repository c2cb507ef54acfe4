"""The JSON document that `gsgen export --report` writes."""

__all__ = ["write_report"]

import json
import math
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from gsgen.contract.commands.output import write_text
from gsgen.contract.errors import GsgenError
from gsgen.contract.reporters.machine import to_dict
from gsgen.sdk.errors import ExportRejected, ParityFailed
from gsgen.sdk.export_request import ExportRequest
from gsgen.sdk.exporter import Exported
from gsgen.sdk.parity import Parity

_SCHEMA = "gsgen-export/1"


def write_report(
    path: Path, request: ExportRequest, source: str, outcome: Exported | GsgenError
) -> None:
    """Write what was asked for and what came of it.

    Args:
        path: The file.
        request: What was asked for.
        source: What was exported: a plugin's name or ``module:factory``.
        outcome: The finished export, or why there is none.

    Raises:
        ConfigInvalid: The file cannot be written.
    """
    options = {key: _plain(value) for key, value in asdict(request).items()}
    document = {
        "schema": _SCHEMA,
        "tool": f"gsgen {version('gsgen')}",
        "source": source,
        "options": options,
        **(_failure(outcome) if isinstance(outcome, GsgenError) else _success(outcome)),
    }
    write_text(path, json.dumps(document, indent=2, ensure_ascii=False) + "\n")


def _success(made: Exported) -> dict[str, Any]:
    return {
        "written": True,
        "error": None,
        "rewrites": [
            {"name": one.rewrite, "nodes": list(one.nodes)} for one in made.changes
        ],
        "parity": _parity(made.parity),
        "validation": to_dict(made.report),
    }


def _failure(error: GsgenError) -> dict[str, Any]:
    fault = {
        "kind": type(error).__name__,
        "what": error.what,
        "where": error.where,
        "mend": error.mend,
    }
    report = error.report if isinstance(error, ExportRejected) else None
    parity = error.parity if isinstance(error, ParityFailed) else None
    return {
        "written": False,
        "error": fault,
        "rewrites": None,
        "parity": _parity(parity) if parity else None,
        "validation": to_dict(report) if report else None,
    }


def _parity(parity: Parity) -> dict[str, Any]:
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
    return {"probes": parity.probes, "fields": fields}


def _plain(value: Any) -> Any:
    """Return a value as JSON has it: paths as text, and no number that is none."""
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
