"""Which tolerances hold for a model, field by field, and where each comes from."""

__all__ = ["effective_tolerances"]

import json
from dataclasses import fields
from typing import Any, get_type_hints

from gsgen.contract.manifest import Tolerances
from gsgen.contract.report import Tolerance
from gsgen.contract.schema_hints import Hint
from gsgen.contract.subject import Subject


def effective_tolerances(subject: Subject) -> tuple[Tolerance, ...]:
    """Return how closely executions of the model must agree; nothing for other kinds of model."""
    if subject.generator is None:
        return ()
    declared = subject.generator.tolerances
    said = _said(subject) if declared is not None and subject.parsed else frozenset()
    hints = get_type_hints(Tolerances, include_extras=True)
    return tuple(
        Tolerance(
            field=one.name,
            value=getattr(declared or Tolerances(), one.name),
            unit=_unit(hints[one.name]),
            source="manifest" if one.name in said else "default",
        )
        for one in fields(Tolerances)
    )


def _said(subject: Subject) -> frozenset[str]:
    """Return the fields that the manifest's text names: its dataclass has the defaults filled in."""
    document: Any = json.loads(subject.file.manifest_text or "{}")
    return frozenset(document.get("tolerances", ()))


def _unit(hint: Any) -> str:
    texts = [one.text for one in hint.__metadata__ if isinstance(one, Hint) and one.text]
    return texts[-1][:1].lower() + texts[-1][1:].rstrip(".") if texts else ""
