"""Conformance tests of ONNX generators of Gaussians, of validators and of viewers.

The names below need pytest (``pip install 'gsgen[conformance]'``) and are loaded when first used.
"""

from typing import TYPE_CHECKING

from gsgen.contract._lazy import lazy_dir, lazy_getattr

if TYPE_CHECKING:
    from gsgen.conformance.pytest.generator import GeneratorConformance
    from gsgen.conformance.pytest.testing import Check, RuleWarning, parametrize_with_rules

__all__ = ["Check", "GeneratorConformance", "RuleWarning", "parametrize_with_rules"]

__getattr__ = lazy_getattr(__name__)
__dir__ = lazy_dir(__name__)
