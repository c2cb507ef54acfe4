"""Conformance tests of ONNX generators of Gaussians, of validators and of viewers.

The names below are loaded when first used; those for pytest need ``pip install 'gsgen[conformance]'``.
"""

from typing import TYPE_CHECKING, Final

from gsgen import _lazy_names

if TYPE_CHECKING:
    from gsgen.conformance.pytest.generator import GeneratorConformance
    from gsgen.conformance.pytest.testing import Check, RuleWarning, parametrize_with_rules
    from gsgen.conformance.verdict_kit import write_verdicts

__all__ = [
    "Check",
    "GeneratorConformance",
    "RuleWarning",
    "parametrize_with_rules",
    "write_verdicts",
]

# Public name → the module that defines it, or that it is.
_MODULE_BY_NAME: Final = {
    "GeneratorConformance": "gsgen.conformance.pytest.generator",
    "Check": "gsgen.conformance.pytest.testing",
    "RuleWarning": "gsgen.conformance.pytest.testing",
    "parametrize_with_rules": "gsgen.conformance.pytest.testing",
    "write_verdicts": "gsgen.conformance.verdict_kit",
}

__getattr__, __dir__ = _lazy_names(__name__, _MODULE_BY_NAME)
