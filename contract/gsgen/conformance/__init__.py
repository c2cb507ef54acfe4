"""Conformance tests of ONNX generators of Gaussians, of validators and of viewers.

The names below need pytest (``pip install 'gsgen[conformance]'``) and are loaded when first used.
"""

from typing import TYPE_CHECKING, Final

from gsgen import _lazy_names

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

__getattr__, __dir__ = _lazy_names(__name__, _MODULE_BY_NAME)
