"""Hints for names that a user's code misspells: in modules, and fields of Gaussians and cells."""

__all__ = ["misspelling_hint"]

import re
from dataclasses import fields
from difflib import get_close_matches
from types import ModuleType

from gsgen.sdk.authoring.cells import Cells
from gsgen.sdk.authoring.generator import Gaussians

_UNKNOWN_FIELD = re.compile(r"(\w+)\.__init__\(\) got an unexpected keyword argument '(\w+)'")


def misspelling_hint(error: BaseException) -> str:
    """Return a hint with the known names, if an exception is about an unknown one; else nothing."""
    if isinstance(error, AttributeError) and isinstance(error.obj, ModuleType):
        return _closest_name(error.name or "", dir(error.obj))
    unknown_field = _UNKNOWN_FIELD.match(str(error))
    if not isinstance(error, TypeError) or unknown_field is None:
        return ""
    for kind in (Gaussians, Cells):
        if unknown_field[1] == kind.__name__:
            names = [field.name for field in fields(kind) if field.init]
            hint = f"{kind.__name__} takes {', '.join(names)}."
            return " ".join(filter(None, (_closest_name(unknown_field[2], names), hint)))
    return ""


def _closest_name(name: str, known: list[str]) -> str:
    matches = get_close_matches(name, known, n=1)
    return f"Did you mean {matches[0]!r}?" if matches else ""
