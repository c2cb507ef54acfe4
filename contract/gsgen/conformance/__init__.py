"""Conformance tests of ONNX generators of Gaussians, of validators and of viewers.

The names below need pytest (``pip install 'gsgen[conformance]'``) and are loaded when first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from gsgen.conformance.pytest.generator import GeneratorConformance
    from gsgen.conformance.pytest.testing import Check, RuleWarning, parametrize_with_rules

__all__ = ["Check", "GeneratorConformance", "RuleWarning", "parametrize_with_rules"]

# Public name → the module that defines it, or that it is.
_MODULE_BY_NAME: Final = {
    "GeneratorConformance": "gsgen.conformance.pytest.generator",
    "Check": "gsgen.conformance.pytest.testing",
    "RuleWarning": "gsgen.conformance.pytest.testing",
    "parametrize_with_rules": "gsgen.conformance.pytest.testing",
}


def __getattr__(name: str) -> object:
    """Import a public name when it is first used (PEP 562)."""
    if name not in _MODULE_BY_NAME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = import_module(_MODULE_BY_NAME[name])
    globals()[name] = getattr(value, name, value)
    return globals()[name]


def __dir__() -> list[str]:
    return sorted(__all__)
