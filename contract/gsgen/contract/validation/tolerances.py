"""Which tolerances hold for a model, field by field, and where each comes from."""

__all__ = ["as_tolerances", "effective_tolerances"]

import json
from dataclasses import fields
from typing import Any, Literal, get_type_hints

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.spec.manifest import Tolerances
from gsgen.contract.spec.schema_text import Hint
from gsgen.contract.validation.report import Tolerance


def effective_tolerances(subject: InspectedModel) -> tuple[Tolerance, ...]:
    """Return how closely executions of the model must agree; nothing for other kinds of model.

    What the user's configuration says wins over the manifest, and that over the contract's own.
    """
    if subject.generator is None:
        return ()
    declared = subject.generator.tolerances
    own, said = subject.tolerances, _said(subject) if declared is not None else {}
    hints = get_type_hints(Tolerances, include_extras=True)
    return tuple(
        Tolerance(
            field=one.name,
            value=own.get(one.name, getattr(declared or Tolerances(), one.name)),
            unit=_unit(hints[one.name]),
            source="config" if one.name in own else said.get(one.name, "default"),
        )
        for one in fields(Tolerances)
    )


def as_tolerances(subject: InspectedModel) -> Tolerances:
    """Return the same as the manifest's dataclass, for whoever compares executions."""
    return Tolerances(**{one.field: one.value for one in effective_tolerances(subject)})


def _said(subject: InspectedModel) -> dict[str, Literal["manifest"]]:
    """Return the fields that the manifest's text names: its dataclass has the defaults filled in."""
    if subject.parsed is None:
        return {}
    document: Any = json.loads(subject.file.manifest_text or "{}")
    return dict.fromkeys(document.get("tolerances", ()), "manifest")


def _unit(hint: Any) -> str:
    texts = [one.text for one in hint.__metadata__ if isinstance(one, Hint) and one.text]
    return texts[-1][:1].lower() + texts[-1][1:].rstrip(".") if texts else ""
