"""Tolerances for comparing outputs of an ONNX generator by field, and the origin of each."""

__all__ = ["effective_tolerances"]

import json
from dataclasses import fields
from typing import Any, Literal, get_type_hints

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.spec.fields.json_schema import Hint
from gsgen.contract.spec.manifest import Tolerances
from gsgen.contract.validation.report import Tolerance


def effective_tolerances(subject: InspectedModel) -> tuple[Tolerance, ...]:
    """Return the tolerances for comparing two runs of an ONNX generator; none for other models.

    The user's settings take precedence over the manifest, and the manifest over the contract.
    """
    if subject.generator is None:
        return ()
    declared = subject.generator.tolerances
    configured_values, sources = (
        subject.tolerances,
        _manifest_fields(subject) if declared is not None else {},
    )
    hints = get_type_hints(Tolerances, include_extras=True)
    return tuple(
        Tolerance(
            field=field.name,
            value=configured_values.get(field.name, getattr(declared or Tolerances(), field.name)),
            unit=_unit_of_field(hints[field.name]),
            source="config"
            if field.name in configured_values
            else sources.get(field.name, "default"),
        )
        for field in fields(Tolerances)
    )


def _manifest_fields(subject: InspectedModel) -> dict[str, Literal["manifest"]]:
    """Return the tolerances that the manifest itself declares, without defaults."""
    if subject.parsed is None:
        return {}
    document: Any = json.loads(subject.file.manifest_text or "{}")
    return dict.fromkeys(document.get("tolerances", ()), "manifest")


def _unit_of_field(hint: Any) -> str:
    texts = [
        annotation.text
        for annotation in hint.__metadata__
        if isinstance(annotation, Hint) and annotation.text
    ]
    return texts[-1][:1].lower() + texts[-1][1:].rstrip(".") if texts else ""
