"""The contract of Gaussian Generators (ONNX models): manifest, layout, rules, validator.

The names below are loaded on first use, so that ``import gsgen.contract`` is fast.
"""

from typing import TYPE_CHECKING, Final

from gsgen import _lazy_names

if TYPE_CHECKING:
    from gsgen.contract.errors import GsgenError
    from gsgen.contract.model.model_file import open_model, write_manifest
    from gsgen.contract.spec.layout import DecodedGaussians, decode, encode
    from gsgen.contract.spec.manifest import GeneratorManifest, Manifest
    from gsgen.contract.spec.severity import Level, Severity
    from gsgen.contract.spec.targets import Target, load_target
    from gsgen.contract.validation.baseline import Baseline, read_baseline
    from gsgen.contract.validation.finding import Finding, Violation
    from gsgen.contract.validation.report import Report
    from gsgen.contract.validation.settings import Settings
    from gsgen.contract.validation.waivers import Waiver
    from gsgen.contract.validator import validate

__all__ = [
    "Baseline",
    "DecodedGaussians",
    "Finding",
    "GeneratorManifest",
    "GsgenError",
    "Level",
    "Manifest",
    "Report",
    "Settings",
    "Severity",
    "Target",
    "Violation",
    "Waiver",
    "decode",
    "encode",
    "load_target",
    "open_model",
    "read_baseline",
    "validate",
    "write_manifest",
]

# Public name → the module that defines it, or that it is.
_MODULE_BY_NAME: Final = {
    "GsgenError": "gsgen.contract.errors",
    "open_model": "gsgen.contract.model.model_file",
    "write_manifest": "gsgen.contract.model.model_file",
    "DecodedGaussians": "gsgen.contract.spec.layout",
    "decode": "gsgen.contract.spec.layout",
    "encode": "gsgen.contract.spec.layout",
    "GeneratorManifest": "gsgen.contract.spec.manifest",
    "Manifest": "gsgen.contract.spec.manifest",
    "Level": "gsgen.contract.spec.severity",
    "Severity": "gsgen.contract.spec.severity",
    "Target": "gsgen.contract.spec.targets",
    "load_target": "gsgen.contract.spec.targets",
    "Baseline": "gsgen.contract.validation.baseline",
    "read_baseline": "gsgen.contract.validation.baseline",
    "Finding": "gsgen.contract.validation.finding",
    "Violation": "gsgen.contract.validation.finding",
    "Report": "gsgen.contract.validation.report",
    "Settings": "gsgen.contract.validation.settings",
    "Waiver": "gsgen.contract.validation.waivers",
    "validate": "gsgen.contract.validator",
}

__getattr__, __dir__ = _lazy_names(__name__, _MODULE_BY_NAME)
